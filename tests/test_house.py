"""The floors of the house: imports point down, names say something."""

import ast
import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
GROUND = {"types", "background", "elements", "query_tree", "queries", "entries", "depth_pixels", "se3", "settings"}
GROUND |= {"protocols", "calibration", "cache", "compiled", "rvl", "image_files", "scratch", "open3d_loading"}
ROOF = {"api", "ask", "assessment", "compare", "compare_batches", "conversion", "diagnosis", "fleet", "rendering"}
ROOF |= {"survey", "viewing", "processed", "picturing", "datasets", "run_outputs"}
ROOMS = {  # folder or file -> what of the project it may import
    "vlmm_log/types.py": set(),
    "vlmm_log/version.py": set(),
    "vlmm_log/se3.py": {"types"},
    "vlmm_log/knobs.py": {"types"},
    "vlmm_log/settings.py": {"types", "knobs"},
    "vlmm_log/background.py": {"types"},
    "vlmm_log/elements.py": {"types", "background"},
    "vlmm_log/queries.py": {"types", "query_tree"},
    "vlmm_log/query_tree.py": {"types", "elements"},
    "vlmm_log/entries.py": {"types"},
    "vlmm_log/outputs.py": {"types"},
    "vlmm_log/ros": {"types", "ros"},
    "vlmm_log/maps": GROUND | {"maps", "outputs"},
    "vlmm_log/protocols.py": {"types", "elements", "queries", "settings", "calibration"},
    "readers": GROUND | {"readers"},
    "pipeline": GROUND | {"pipeline"},
    "vlmm_log/models": GROUND | {"models"},
    "vlmm_log/writers": GROUND | {"writers", "readers", "outputs", "ros"},
    "vlmm_log/simulation": GROUND | {"simulation"},
    "vlmm_log/checks": GROUND | {"checks", "readers", "pipeline", "models"},
    "vlmm_log/sinks": GROUND | {"sinks", "ros"},
    "vlmm_log/depth_pixels.py": {"types", "entries", "image_files"},
    "vlmm_log/image_files.py": set(),
    "vlmm_log/open3d_loading.py": {"types"},
    "vlmm_log/recording": GROUND | {"recording", "readers", "pipeline", "maps"},
    "vlmm_log/pages": {"pages", "types"},
    "vlmm_log/comparison": GROUND | {"comparison", "drawing", "pages", "recording", "sinks", "version"},
    "vlmm_log/drawing": GROUND | {"drawing", "sinks"},
    "vlmm_log/batches": {"batches", "types", "outputs", "locks"},
    "vlmm_log/calibration.py": {"types", "settings"},
    "vlmm_log/cache.py": set(),
    "vlmm_log/locks.py": set(),
    "vlmm_log/scratch.py": {"locks"},
    "vlmm_log/compiled.py": {"cache"},
    "vlmm_log/rvl.py": {"types", "compiled"},
    "vlmm_log/heap.py": set(),
    "vlmm_log/workers": GROUND | {"workers", "pipeline", "models", "sinks", "heap"},
    "vlmm_log/resuming": GROUND | {"resuming", "workers", "pipeline", "sinks"},
    "vlmm_log/evaluation": GROUND | {"drawing", "evaluation", "pages", "pipeline", "sinks", "version"},
    "vlmm_log/store": {"store", "types", "protocols", "locks"},
    "vlmm_log/commands": ROOF
    | {"commands", "progress", "settings", "heap", "outputs"}
    | {"batches", "comparison", "evaluation", "simulation"},  # what their options say
    "vlmm_log/progress.py": {"cache"},
    "vlmm_log/cli.py": {"commands", "types", "version"},
}
FOREIGN = {  # what only some rooms may know
    "rerun": {"vlmm_log/comparison", "vlmm_log/sinks", "vlmm_log/recording"},
    "mcap": {"vlmm_log/ros", "vlmm_log/recording", "readers"},
    "rosbags": {"vlmm_log/ros", "vlmm_log/writers", "readers"},
    "foxglove": {"vlmm_log/sinks"},
    "matplotlib": {"vlmm_log/pages"},
    "jinja2": {"vlmm_log/pages"},
    "rerun_cli": {"vlmm_log/viewing.py"},
    "xxhash": {"vlmm_log/sinks", "vlmm_log/recording"},
    "torch": {"vlmm_log/models"},
    "torchvision": {"vlmm_log/models"},
    "open3d": {"vlmm_log/open3d_loading.py"},
    "onnxruntime": {"vlmm_log/models"},
    "open_clip": {"vlmm_log/models"},
    "sklearn": {"vlmm_log/models", "vlmm_log/evaluation"},
    # a language model, where a URL is given; a file that was asked for by name
    "urllib3": {"vlmm_log/models/endpoint.py", "vlmm_log/store/download.py"},
    "pooch": {"vlmm_log/store"},
    "socket": {"vlmm_log/batches/cluster.py"},  # a Ray cluster, where one is named
    "pickle": {"vlmm_log/workers"},  # between processes of our own, never of a file
    "subprocess": {"vlmm_log/batches/local.py", "vlmm_log/viewing.py"},
    "ray": {"vlmm_log/batches/cluster.py"},
    "pyarrow": {"vlmm_log/batches", "vlmm_log/maps", "vlmm_log/recording", "vlmm_log/sinks"},
    "numba": {"vlmm_log/compiled.py"},
    "click": {"vlmm_log/cli.py", "vlmm_log/commands", "vlmm_log/progress.py"},
}
NOWHERE = {"requests", "http", "ftplib", "smtplib", "aiohttp", "httpx", "urllib.request", "marshal", "shelve", "joblib"}
ONLY = {  # call -> an argument that it is to have
    "torch.load": ("weights_only", True),
    "numpy.load": ("allow_pickle", False),
    "ruamel.yaml.YAML": ("typ", "safe"),
}
NEVER = {"eval", "exec", "compile", "__import__", "os.system", "os.popen", "subprocess.getoutput", "yaml.load"}
NEVER |= {"pickle.load", "torch.hub.load", "torch.hub.load_state_dict_from_url"}
SOURCES = sorted(p for d in ("vlmm_log", "readers", "pipeline") for p in (ROOT / d).rglob("*.py"))


def imports(path):
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def breaches(tree):
    """Calls that run what a file or a shell says. Names are taken as they were imported."""
    known = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import | ast.ImportFrom):
            origin = f"{node.module}." if isinstance(node, ast.ImportFrom) else ""
            known |= {alias.asname or alias.name.split(".")[0]: f"{origin}{alias.name}" for alias in node.names}
    for call in (node for node in ast.walk(tree) if isinstance(node, ast.Call)):
        first, dot, rest = ast.unparse(call.func).partition(".")
        origin = known.get(first, first)
        name = f"{origin}{dot}{rest}" if not origin.startswith(f"{first}.") else f"{first}{dot}{rest}"
        given = {k.arg: getattr(k.value, "value", None) for k in call.keywords}
        if name in NEVER or given.get("shell", False) is not False:
            yield name
        if name in ONLY and given.get(ONLY[name][0]) != ONLY[name][1]:
            yield name


def room_of(path):
    name = path.relative_to(ROOT).as_posix()
    return next((room for room in ROOMS if name == room or name.startswith(room + "/")), None)


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_imports_point_down(path):
    room = room_of(path)
    for name in imports(path):
        top, *rest = name.split(".")
        assert top not in ("readers", "pipeline"), f"{path}: bare import of {top} makes a second copy of every class"
        if top == "vlmm_log" and room is not None and rest:
            assert rest[0] in ROOMS[room], f"{path}: {room} may not import {name}"
        if top in FOREIGN:
            known = any(path.relative_to(ROOT).as_posix().startswith(r) for r in FOREIGN[top])
            assert known, f"{path}: may not know {top}"


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_only_the_command_line_knows_its_commands(path):
    if room_of(path) not in ("vlmm_log/cli.py", "vlmm_log/commands"):
        assert not [name for name in imports(path) if name.startswith(("vlmm_log.cli", "vlmm_log.commands"))]


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_no_file_is_run_and_nothing_is_fetched(path):
    assert list(breaches(ast.parse(path.read_text("utf-8")))) == []
    assert not [name for name in imports(path) if any(f"{name}.".startswith(f"{n}.") for n in NOWHERE)]


@pytest.mark.parametrize(
    "text",
    [
        "eval('1')",
        "import os\nos.system('true')",
        "from os import system\nsystem('true')",
        "import subprocess as s\ns.run('true', shell=True)",
        "import torch\ntorch.load(f)",
        "import torch as t\nt.load(f, weights_only=False)",
        "from torch import load\nload(f)",
        "import numpy as np\nnp.load(f)",
        "from ruamel.yaml import YAML\nYAML().load(f)",
        "from pickle import load\nload(f)",
        "import os.path\nos.system('true')",
    ],
)
def test_a_breach_is_seen(text):
    assert len(list(breaches(ast.parse(text)))) == 1


@pytest.mark.parametrize("path", SOURCES, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_names_say_something(path):
    assert not re.search(r"util|helper|manager|common|base|misc", path.stem)


def test_every_room_is_packaged():
    packages = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"]
    moved = re.compile(r"^vlmm_log/(?=(readers|pipeline)(/|$))")  # they stand at the top
    listed = {moved.sub("", p.replace(".", "/")) for p in packages}
    assert listed == {p.parent.relative_to(ROOT).as_posix() for p in SOURCES} | {"vlmm_log/data"}


def test_public_face_is_what_the_pages_show():
    import vlmm_log

    shown = re.findall(r"^from vlmm_log import (.+)$", (ROOT / "docs/python.md").read_text("utf-8"), re.MULTILINE)
    names = {name.strip() for line in shown for name in line.split(",")}
    assert names == set(vlmm_log.__all__) - {"__version__"}
    assert all(getattr(vlmm_log, name) is not None for name in names)
