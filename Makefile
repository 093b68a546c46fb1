# One target for each thing a person does. `make demo` and `make test` set up what they need.
VENV ?= .venv
PYTHON ?= python3
PY := $(VENV)/bin/python
PIP := PYTHONWARNINGS=ignore:Editable $(PY) -m pip install -q

.PHONY: demo test check bench twins doctor reproduce router fuzz picture house pages docs clean

$(VENV)/.ready: pyproject.toml
	@$(PYTHON) -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { echo \
		"needs Python 3.11 or later with venv: apt-get install python3-venv, or make PYTHON=/path/to/python3.11"; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(PIP) --upgrade pip
	$(PIP) -e .
	touch $@

$(VENV)/.ready-dev: $(VENV)/.ready
	$(PIP) -e '.[dev]'
	touch $@

# Open3D needs libraries of the system: installed where we may, else `simulate` prints the line that installs them.
$(VENV)/.ready-sim: $(VENV)/.ready
	$(PIP) -e '.[sim]'
	@$(PY) -c 'import open3d' 2>/dev/null || [ "$$(id -u)" != 0 ] || { apt-get update -qq && \
		$$($(PY) -c 'from vlmm_log.open3d_loading import LIBRARIES as line; print(line)') -qq >/dev/null; } || true
	touch $@

demo: $(VENV)/.ready-sim  ## render a kitchen, process it, ask which door opens, say how to look at it
	$(VENV)/bin/vlmm-log simulate kitchen demo/kitchen --frames 60 --noise kinect_quadratic --force
	$(VENV)/bin/vlmm-log process demo/kitchen --segmenter masks:demo/kitchen/truth/instances \
		--rrd demo/kitchen.rrd --map demo/kitchen.json --force
	$(VENV)/bin/vlmm-log query demo/kitchen.json "the door that opens"
	@echo "look at it: $(VENV)/bin/vlmm-log view demo/kitchen.rrd"

TESTS ?= tests
test: $(VENV)/.ready-dev  ## all tests, or TESTS=tests/test_x.py
	$(PY) -m pytest -q -n auto --dist loadscope --max-worker-restart=0 $(TESTS)

house:  ## the import tree as the installed package has it, of links, for tools that read files
	rm -rf .house && mkdir -p .house/vlmm_log
	ln -s $(CURDIR)/vlmm_log/* .house/vlmm_log/
	ln -s $(CURDIR)/readers $(CURDIR)/pipeline .house/vlmm_log/

check: $(VENV)/.ready-dev house  ## lint, format, spelling, dead code, types
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/codespell
	$(VENV)/bin/vulture
	cd .house && $(abspath $(VENV))/bin/mypy --config-file ../pyproject.toml vlmm_log

twins: $(VENV)/.ready-dev  ## the same frames from every container, and what reading costs (needs the real slice)
	$(PY) -m benchmarks.twins
	$(PY) -m benchmarks.long_bags

doctor: $(VENV)/.ready-dev  ## precision and recall of the doctor on injected faults (needs the real slice)
	$(PY) -m benchmarks.doctor

bench: $(VENV)/.ready-dev  ## speed as ratios, from one run
	$(PY) -m benchmarks
	$(PY) -m benchmarks.query
	$(PY) -m benchmarks.segmenters
	$(PY) -m benchmarks.diff

reproduce: $(VENV)/.ready-dev $(VENV)/.ready-sim  ## every table: the paper's figures and ours, in reproduce/report.html (about half an hour)
	$(PY) -m benchmarks.reproduce reproduce

router: $(VENV)/.ready-dev  ## routing accuracy of both query parsers
	$(PY) -m benchmarks.router

fuzz: $(VENV)/.ready-dev  ## broken files of every format, for eight minutes
	$(PY) -m benchmarks.fuzz

picture: demo  ## the pictures of README and pages, by the headless viewer (needs Vulkan)
	$(PY) examples/viewer_picture.py demo/kitchen.rrd docs/viewer.png 30
	$(VENV)/bin/vlmm-log simulate living_room demo/living --frames 60 --noise kinect_quadratic --force
	$(VENV)/bin/vlmm-log process demo/living --segmenter masks:demo/living/truth/instances --rrd demo/a.rrd --force
	$(VENV)/bin/vlmm-log process demo/living --segmenter masks:demo/living/truth/instances --rrd demo/b.rrd --force \
		--set noise.scale=0.6
	$(VENV)/bin/vlmm-log render demo/a.rrd --frame 30 -o docs/simulated.jpg --panels rgb,d_m,norm,elements --force
	$(VENV)/bin/vlmm-log diff demo/a.rrd demo/b.rrd --rrd demo/both.rrd --force >/dev/null || [ $$? = 1 ]
	$(PY) examples/viewer_picture.py demo/both.rrd docs/merged.png 30

pages: $(VENV)/.ready  ## the pages that are made from the code: settings, and the rooms of the house
	$(PY) docs/make/settings_page.py
	$(PY) docs/make/rooms.py

docs: pages  ## the documentation, in site/: open site/index.html
	$(PIP) -e '.[docs]'
	NO_MKDOCS_2_WARNING=1 $(PY) -m mkdocs build --strict

clean:
	rm -rf .house build dist demo site *.egg-info
