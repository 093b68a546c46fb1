"""README and pages: what they name exists, what they show is so, and what they are built into fetches nothing."""

import ast
import json
import re
import shlex
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import click
import cv2
import numpy as np
import pytest
from small_room import write_masks

import own_models
import rooms
import settings_page
import vlmm_log
from tum_folder import ORIGIN_NS, rows, write_tum_folder
from vlmm_log.cli import cli
from vlmm_log.entries import Look, Table
from vlmm_log.knobs import is_table, leaves
from vlmm_log.recording import open_recording
from vlmm_log.settings import Settings
from vlmm_log.types import Validity

ROOT = Path(__file__).resolve().parents[1]
NAMES = ["README.md", "CONTRIBUTING.md", "CHANGELOG.md", *sorted(f"docs/{p.name}" for p in ROOT.glob("docs/*.md"))]
PAGES = {name: (ROOT / name).read_text("utf-8") for name in NAMES}
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
SETTINGS = dict(leaves(Settings()))
TABLES = {name for name in vars(Settings()) if is_table(Settings(), name)}


def lines(text):
    """What stands in blocks without a language: commands, and what they print."""
    return [line.removeprefix("$ ") for kind, block in FENCE.findall(text) if not kind for line in block.splitlines()]


def codes(text):
    """What stands in a line as code."""
    return [" ".join(code.split()) for code in re.findall(r"`([^`]+)`", FENCE.sub("", text))]


def command_of(name):
    found = cli.get_command(click.Context(cli), name)
    assert found is not None, f"no command {name}"
    return found


def options_of(command):
    return {option for parameter in command.params for option in parameter.opts} | {"--help"}


@pytest.mark.parametrize("name", NAMES)
def test_every_command_line_parses(name):
    for line in (line for line in lines(PAGES[name]) if line.startswith("vlmm-log ")):
        command, *arguments = shlex.split(line, comments=True)[1:]
        if command.startswith("-"):
            assert command in options_of(cli), line
            continue
        context = command_of(command).make_context(command, arguments)
        Settings().changed(context.params.get("sets", ()))


@pytest.mark.parametrize("name", NAMES)
def test_every_command_and_option_in_the_text_exists(name):
    every = {option for command in cli.commands.values() for option in options_of(command)} | options_of(cli)
    every |= {o for p in ROOT.glob("benchmarks/*.py") for o in re.findall(r'"(--[a-z-]+)"', p.read_text("utf-8"))}
    for code in codes(PAGES[name]):
        words = code.split()
        told = [word.partition("=")[0] for word in words if word.startswith("--")]
        if words[0] == "vlmm-log" and len(words) > 1 and not words[1].startswith("-"):
            assert set(told) <= options_of(command_of(words[1])), code
        elif words[0].startswith("--"):
            assert set(told) <= every, code
        Settings().changed(re.findall(r"--set ([a-z]+\.\w+=\S+)", code))


@pytest.mark.parametrize("name", NAMES)
def test_every_setting_in_the_text_exists(name):
    for code in codes(PAGES[name]):
        if re.fullmatch(rf"({'|'.join(TABLES)})\.(?!json$|parquet$|ply$)\w+", code):
            assert code in SETTINGS


@pytest.mark.parametrize("name", NAMES)
def test_every_file_module_and_target_exists(name):
    text = PAGES[name]
    inside = re.compile(r"(?:tests|examples|benchmarks|docs|vlmm_log|readers|pipeline|\.ci)/[\w./-]*")
    for path in (code for code in codes(text) if inside.fullmatch(code) and "..." not in code):
        assert (ROOT / path).exists(), path
    for path in re.findall(r"python (examples/\S+\.py)|TESTS=(\S+\.py)", text):
        assert (ROOT / "".join(path)).is_file(), path
    for module in re.findall(r"python -m (benchmarks(?:\.\w+)?)", text):
        path = ROOT / module.replace(".", "/")
        assert path.with_suffix(".py").is_file() or (path / "__main__.py").is_file(), module
    targets = set(re.findall(r"^(\w+):", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE))
    named = [line.split()[1] for line in [*lines(text), *codes(text)] if re.match(r"make \w", line)]
    assert set(named) <= targets


def anchors(text):
    """As Python-Markdown and GitHub make them of headings."""
    titles = re.findall(r"^#+ (.+)$", FENCE.sub("", text), re.MULTILINE)
    return {re.sub(r"[\s-]+", "-", re.sub(r"[^\w\s-]", "", title).strip().lower()) for title in titles}


@pytest.mark.parametrize("name", NAMES)
def test_every_link_leads_somewhere(name):
    text = FENCE.sub("", PAGES[name])
    assert not re.search(r"@[A-Z]+@|TODO|TBD", text)
    for target in re.findall(r"\]\((?!https?://)([^)]+)\)", text):
        path, _, anchor = target.partition("#")
        to = (ROOT / name).parent / path if path else ROOT / name
        assert to.is_file(), target
        assert not anchor or anchor in anchors(to.read_text("utf-8")), target


def test_the_readme_is_read_in_two_minutes():
    assert len(PAGES["README.md"].splitlines()) <= 130
    assert {"make demo", "make test"} <= {" ".join(line.split()[:2]) for line in lines(PAGES["README.md"])}


def test_pages_made_from_the_code_are_current():
    again = "make them again: make pages"
    assert PAGES["docs/settings.md"] == settings_page.text(), again
    assert PAGES["docs/architecture.md"] == rooms.page(PAGES["docs/architecture.md"]), again
    assert rooms.PICTURE.read_text("utf-8") == rooms.picture(), again


def test_the_picture_of_the_rooms_is_what_the_imports_say():
    graph, _ = rooms.house()
    drawn = set(re.findall(r">(\w+)</text>", rooms.picture()))
    assert drawn == graph.keys()
    floors = rooms.floors(graph)
    assert all(floors[name] > floors[other] for name, imported in graph.items() for other in imported)
    reached = {name: {name} for name in graph}
    for name, other in sorted(rooms.direct(graph), key=lambda line: floors[line[0]]):
        reached[name] |= reached[other]
    assert all(reached[name] >= imported for name, imported in graph.items())  # by the lines that are drawn


def table_rows(text, head):
    """The rows of all tables with this head, as lists of cells."""
    found = re.findall(rf"^\| {re.escape(head)} \|\n\|[-|]+\|\n((?:\|.*\n)+)", text, re.MULTILINE)
    assert found, head
    return [[c.strip() for c in row.strip("|").split("|")] for block in found for row in block.splitlines()]


def templates():
    """Every text of the sources, holes as NUL."""
    for top in ("vlmm_log", "readers", "pipeline"):
        for path in (ROOT / top).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text("utf-8"))):
                if isinstance(node, ast.JoinedStr):
                    parts = [p.value if isinstance(p, ast.Constant) else "\0" for p in node.values]
                    yield "".join(map(str, parts))
                elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                    yield node.value


def test_every_message_under_troubleshooting_is_printed():
    known = "\n".join(templates())
    page = PAGES["docs/troubleshooting.md"]
    told = table_rows(page, "message | what it means, and what to do") + table_rows(page, "note | what it means")
    assert len(told) > 30
    for message in (row[0].strip("`") for row in told):
        parts = [part for part in message.split("...") if re.search(r"[a-z]{2}", part)]
        assert parts, message
        assert [part for part in parts if part not in known] == [], message


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """A small log, and recordings of it: lean, calibrated and asked; dense and asked; judged."""
    folder = tmp_path_factory.mktemp("recordings")
    still = rows([ORIGIN_NS - 10**8 + k * 10**8 for k in range(9)], ["0 0 0 0 0 0 1"] * 9)
    log = write_tum_folder(folder / "log", size=(96, 72), frames=6, groundtruth=still)
    texture = cv2.imread(str(log / "rgb/0.png"))
    for k in range(6):  # what moves before a still wall
        image = texture.copy()
        image[20:50, 30:70] = np.roll(texture, 3 * k, axis=1)[20:50, 30:70]
        cv2.imwrite(str(log / f"rgb/{k}.png"), image)
    thing = np.zeros((72, 96), np.uint8)
    thing[20:50, 30:70] = 1
    write_masks(folder / "masks", dict.fromkeys(range(6), thing))
    write_masks(folder / "truth", dict.fromkeys(range(6), 255 * thing))
    masks, curves = f"masks:{folder / 'masks'}", folder / "curves.json"
    sets = [
        "keyframes.gap=1",
        "ego.model=off",
        "ego.pose_sigma_rad=0.002",
        "ego.pose_sigma_m=0.002",
        f"objects.segmenter={masks}",
    ]
    judging = {"truth": str(folder / "truth"), "segmenter": masks, "calibrate": curves, "recordings": folder / "judged"}
    vlmm_log.evaluate([log], settings=Settings.load(sets=sets), **judging)
    fitted = json.loads(curves.read_text())
    assert fitted["element"] is None  # masks of pixels know no things; a simulated truth would give a curve
    curves.write_text(json.dumps(fitted | {"element": fitted["pixel"]}))
    (judged,) = (folder / "judged").rglob("*.rrd")
    for name, own in (("lean", f"calibration.file={curves}"), ("dense", "log.dense=true")):
        s = Settings.load(sets=[*sets, own])
        vlmm_log.process(log, rrd=folder / f"{name}.rrd", settings=s, queries=["what moved"])
    return log, {"lean": folder / "lean.rrd", "dense": folder / "dense.rrd", "judged": judged}


PLACES = {r"(map/elements)/\d+": r"\1/ID", r"(query)/\w+": r"\1/TEXT", r"(stage_ms)/\w+": r"\1/STAGE"}
PLACES |= {r"(metrics)/\w+": r"\1/NAME"}


def held(path):
    """{(entity, type)}, and {entity: columns} of tables; looks where they are all that an entity holds."""
    recording = open_recording(path)
    found, columns = set(), {}
    for entry in recording.entries(recording.entities):
        entity = entry.entity
        for pattern, name in PLACES.items():
            entity = re.sub(pattern, name, entity)
        found.add((entity, type(entry.value).__name__))
        if isinstance(entry.value, Table):
            columns.setdefault(entity, set()).update(entry.value.columns)
    values = {entity for entity, kind in found if kind != Look.__name__}
    return {(entity, kind) for entity, kind in found if kind != Look.__name__ or entity not in values}, columns


@pytest.mark.parametrize(
    ("name", "when"),
    [("lean", {"", "calibrated", "asked"}), ("dense", {"", "dense", "asked"}), ("judged", {"", "judged"})],
)
def test_a_recording_holds_what_its_page_says(runs, name, when):
    page = PAGES["docs/recording.md"]
    told = table_rows(page, "entity | type | when | what, and its unit")
    cells = [(row[0].strip("`"), row[1], row[2]) for row in told]
    found, columns = held(runs[1][name])
    assert found == {(entity, kind) for entity, kind, at in cells if at in when}
    names = {c for row in table_rows(page, "column | what, and its unit") for c in re.findall(r"`(\w+)`", row[0])}
    written = set().union(*columns.values())
    assert written <= names
    if name == "lean":
        assert names == written
        assert ", ".join(f"{v.value} {v.name.lower()}" for v in Validity) in page


def test_models_of_ones_own_make_a_map(runs):
    world = own_models.mapped(str(runs[0]), ("keyframes.gap=1", "gate.fb_px=9"))
    assert len(world.background.cells)


def fetched(page):
    """What a page brings in from elsewhere."""

    class Page(HTMLParser):
        def __init__(self):
            super().__init__()
            self.found = []

        def handle_starttag(self, tag, attributes):
            if tag in ("script", "link", "img", "iframe", "object", "embed", "source", "video", "audio"):
                brings = {"src", "href", "data", "srcset"}
                self.found += [v for k, v in attributes if k in brings and re.match(r"(\w+:)?//", v or "")]

    parser = Page()
    parser.feed(page)
    return parser.found


def test_what_is_fetched_is_seen():
    page = '<script src="https://e.example/x.js"></script><link href="//e.example/y.css"><img src="z.png"><a href="http://a">'
    assert fetched(page) == ["https://e.example/x.js", "//e.example/y.css"]


def test_the_site_is_built_and_fetches_nothing(tmp_path):
    pytest.importorskip("material", reason="pip install '.[docs]'")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "-q", "-f", ROOT / "mkdocs.yml", "-d", tmp_path]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    pages = {p.name: p.read_text("utf-8") for p in tmp_path.rglob("*.html")}
    assert {Path(name).stem for name in NAMES if name.startswith("docs/")} <= {Path(name).stem for name in pages}
    assert {name: fetched(page) for name, page in pages.items() if fetched(page)} == {}
    for sheet in tmp_path.rglob("*.css"):
        assert not re.search(r"url\(['\"]?(https?:)?//|@import", sheet.read_text("utf-8")), sheet
    assert not [name for name, page in pages.items() if 'class="arithmatex"' in page]  # all became MathML
    assert pages["method.html"].count('display="block"') > 10
