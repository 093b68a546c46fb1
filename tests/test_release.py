"""What is handed out: the wheel, the source distribution, the types that a user's checker sees, the citation."""

import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path
from shutil import copytree, ignore_patterns

import pytest
from ruamel.yaml import YAML

import vlmm_log

ROOT = Path(__file__).parents[1]
UNUSED = (".git", ".venv", ".house", ".*_cache", "__pycache__", "build", "dist", "demo", "reproduce", "*.egg-info")
USER = """
from vlmm_log import {names}
from vlmm_log.types import Frame

{revealed}

def stamps(path: str) -> list[int]:
    return [item.stamp_ns for item in open_log(path).frames(0, 10**18) if isinstance(item, Frame)]

def movers(path: str) -> list[tuple[int, str]]:
    done = process(path, settings=Settings.load("paper"))
    answer = query(done.map, "what moved")
    return list(zip(answer.ids.tolist(), answer.reasons, strict=True))

def same(a: str, b: str) -> bool:
    return diff(a, b).same and len(load_map(a).world.elements) == len(load_map(b).world.elements)
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The wheel and the source distribution, the former built from the latter as for an index."""
    pytest.importorskip("setuptools", reason="setuptools is not installed: pip install 'vlmm-log[dev]'")
    pytest.importorskip("build", reason="build is not installed: pip install 'vlmm-log[dev]'")
    folder = tmp_path_factory.mktemp("release")
    copytree(ROOT, folder / "source", ignore=ignore_patterns(*UNUSED))
    command = [sys.executable, "-P", "-m", "build", "--no-isolation", "--skip-dependency-check", folder / "source"]
    done = subprocess.run([*command, "--outdir", folder], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "Warning" not in done.stdout + done.stderr
    return next(folder.glob("*.whl")), next(folder.glob("*.tar.gz"))


def files(*folders):
    found = (p.relative_to(ROOT).as_posix() for f in folders for p in (ROOT / f).rglob("*") if p.is_file())
    return {name for name in found if "__pycache__" not in name and not name.endswith(".pyc")}


def test_the_wheel_holds_the_package_and_nothing_else(made):
    names = set(zipfile.ZipFile(made[0]).namelist())
    moved = {f"vlmm_log/{name}" for name in files("readers", "pipeline")}
    assert {name for name in names if ".dist-info/" not in name} == files("vlmm_log") | moved
    assert {"vlmm_log/py.typed", "vlmm_log/data/movability.csv"} < names
    assert f"vlmm_log-{vlmm_log.__version__}.dist-info/licenses/LICENSE" in names


def test_the_source_distribution_holds_what_it_takes_to_change_the_project(made):
    top = f"vlmm_log-{vlmm_log.__version__}"
    with tarfile.open(made[1]) as archive:
        names = {name.removeprefix(f"{top}/") for name in archive.getnames()}
    texts = {"README.md", "CHANGELOG.md", "CONTRIBUTING.md", "LICENSE", "CITATION.cff", "Makefile", "pyproject.toml"}
    folders = ("vlmm_log", "readers", "pipeline", "tests", "examples", "benchmarks", "docs", ".ci", ".github")
    assert texts | files(*folders) <= names
    assert not [name for name in names if "__pycache__" in name]


def test_a_user_s_strict_checker_sees_every_type(made, tmp_path):
    site = tmp_path / "site"
    zipfile.ZipFile(made[0]).extractall(site)
    assert (site / "vlmm_log/py.typed").exists()
    names = sorted(vlmm_log.__all__)
    revealed = "\n".join(f"reveal_type({name})" for name in names)
    script = tmp_path / "user.py"
    script.write_text(USER.format(names=", ".join(names), revealed=revealed))
    done = checked(script, site)
    types = [line for line in done.stdout.splitlines() if "Revealed type" in line]
    assert (done.returncode, len(types)) == (0, len(names)), done.stdout
    assert not [line for line in types if '"Any"' in line or "-> Any" in line]
    script.write_text("from vlmm_log import process_log, query\n\nquery(3, 'what moved')\n")
    wrong = checked(script, site).stdout
    assert 'has no attribute "process_log"' in wrong
    assert 'Argument 1 to "query" has incompatible type "int"' in wrong


def checked(script, site):
    command = [sys.executable, "-P", "-m", "mypy", "--strict", "--follow-imports=silent", "--config-file="]
    command += ["--no-color-output", "--ignore-missing-imports", "--cache-dir", script.parent / "cache", script]
    environment = {"PATH": "", "MYPYPATH": str(site)}
    return subprocess.run(command, cwd=script.parent, env=environment, capture_output=True, text=True, check=False)


def test_the_citation_names_this_version_and_the_paper():
    text = (ROOT / "CITATION.cff").read_text("utf-8")
    cited = YAML(typ="safe").load(text)
    assert {"cff-version", "message", "title", "authors"} < set(cited)  # those that the format requires
    assert cited["cff-version"] == "1.2.0"
    assert cited["type"] == "software"
    assert (cited["title"], cited["version"]) == ("vlmm-log", vlmm_log.__version__)
    (paper,) = cited["references"]
    assert [f"{a['given-names']} {a['family-names']}" for a in paper["authors"]] == ["D. Ghosh", "A. Shakya"]
    readme = " ".join((ROOT / "README.md").read_text("utf-8").split())
    assert f"D. Ghosh, A. Shakya, *{paper['title']}*" in readme


@pytest.mark.parametrize("path", sorted((ROOT / ".github/ISSUE_TEMPLATE").glob("*.yml")), ids=lambda p: p.stem)
def test_issue_forms_are_whole(path):
    form = YAML(typ="safe").load(path.read_text("utf-8"))
    assert {"name", "description", "body"} < set(form)
    asked = [field["id"] for field in form["body"]]
    assert len(asked) == len(set(asked))
    for field in form["body"]:
        assert field["type"] in ("input", "textarea")
        assert field["attributes"]["label"]
    if path.stem == "bug":
        assert {"version", "info", "doctor", "settings"} <= set(asked)
