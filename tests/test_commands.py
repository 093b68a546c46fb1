"""What holds for every command: examples that parse, completion, JSON for scripts, terminals of any width, logs."""

import inspect
import json
import os
import re
import shlex
import signal
import subprocess
import sys
from importlib.util import find_spec
from itertools import takewhile

import click
import pytest
from click.testing import CliRunner
from rich.cells import cell_len
from small_room import write_small_room

from vlmm_log.cli import cli
from vlmm_log.commands.options import taken
from vlmm_log.progress import COMPILING
from vlmm_log.types import InputError


def commands(group=cli, names=()):
    """Every command by its words, groups too."""
    found = {" ".join(names): group} if names else {"": group}
    for name, command in group.commands.items():
        words = (*names, name)
        found |= commands(command, words) if isinstance(command, click.Group) else {" ".join(words): command}
    return found


COMMANDS = commands()
LEAVES = [name for name, command in COMMANDS.items() if not isinstance(command, click.Group)]


def examples(command):
    lines = [line.strip() for line in inspect.cleandoc(command.epilog or "").splitlines()]
    return [line for line in lines if line.startswith("vlmm-log ")]


def parsed(line):
    """What the options of a line give, the shell's part left out."""
    words = list(takewhile(lambda word: word not in (">", ">>", "|", "&&"), shlex.split(line)))[1:]
    name = next(name for name in LEAVES if name.split() == words[: len(name.split())])
    return COMMANDS[name].make_context(name, words[len(name.split()) :]).params


@pytest.mark.parametrize("name", COMMANDS)
def test_every_help_has_examples_that_parse(name):
    lines = examples(COMMANDS[name])
    assert len(lines) >= 2
    for line in lines:
        assert f"{line} ".startswith(f"vlmm-log {name}".strip() + " ")
        given = parsed(line)
        if "toml" in given:
            taken(given)


@pytest.mark.parametrize("line", ["vlmm-log info a b", "vlmm-log datasets list x", "vlmm-log info a --set no.such=1"])
def test_an_example_that_does_not_parse_is_seen(line):
    with pytest.raises((click.UsageError, InputError)):
        taken(parsed(line))


@pytest.mark.parametrize("name", COMMANDS)
@pytest.mark.parametrize("columns", [60, 80])
def test_a_help_shows_its_examples_whole_and_fits(name, columns):
    done = CliRunner().invoke(cli, [*name.split(), "--help"], terminal_width=columns)
    lines = done.stdout.splitlines()
    shown = {line.strip() for line in lines}
    assert set(examples(COMMANDS[name])) <= shown
    rest = [line for line in lines if line.strip() not in examples(COMMANDS[name])]
    assert max(map(len, rest)) <= columns
    assert max(map(len, lines)) <= 80


# ---- completion


def completed(tmp_path, line, *words):
    """What bash makes of the last of the words, by the script that is printed."""
    program = tmp_path / "bin/vlmm-log"
    program.parent.mkdir(exist_ok=True)
    program.write_text(f"#!/bin/sh\nexec '{sys.executable}' -c 'from vlmm_log.cli import main; main()' \"$@\"\n")
    program.chmod(0o755)
    script = (
        'eval "$(vlmm-log completion bash)" || exit 1\n'
        "complete -p vlmm-log > /dev/null || exit 2\n"
        f"COMP_WORDS=({line}); COMP_CWORD=$((${{#COMP_WORDS[@]}} - 1))\n"
        'name=$(complete -p vlmm-log | sed "s/.*-F \\([^ ]*\\) .*/\\1/")\n'
        '$name vlmm-log\nprintf "%s\\n" "${COMPREPLY[@]}"\n'
    )
    path = {"PATH": f"{program.parent}{os.pathsep}{os.environ['PATH']}"}
    command = ["bash", "--norc", "-c", script]
    done = subprocess.run(command, env=os.environ | path, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout.split()


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("vlmm-log pro", ["process"]),
        ("vlmm-log process --workers 2 --mcap-s", ["--mcap-schema"]),
        ("vlmm-log process room --flow r", ["raft"]),
        ("vlmm-log datasets g", ["get"]),
        ("vlmm-log nope", []),
    ],
)
def test_bash_completes_commands_options_and_values(tmp_path, line, found):
    assert completed(tmp_path, line) == found


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_other_shells_have_a_script(shell):
    done = CliRunner().invoke(cli, ["completion", shell], prog_name="vlmm-log")
    assert done.exit_code == 0
    assert f"_VLMM_LOG_COMPLETE={shell}_complete" in done.stdout


# ---- JSON


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """A folder with a log, two recordings of it and its map."""
    folder = tmp_path_factory.mktemp("logs")
    write_small_room(folder / "room")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for line in (
            "process room --segmenter masks:room/truth/instances --rrd a.rrd --map a.json",
            "process room --rrd b.rrd --set noise.scale=2",
        ):
            done = CliRunner().invoke(cli, line.split(), catch_exceptions=False)
            assert done.exit_code == 0, done.stderr
    return folder


TOLD = {  # what follows the command's name -> exit code
    "batch": ("room --out maps --workers 1", 0),
    "convert": ("room twin.mcap", 0),
    "datasets list": ("", 0),
    "diff": ("a.rrd b.rrd", 1),
    "doctor": ("room", 0),
    "eval": ("room", 0),
    "info": ("room", 0),
    "process": ("room --rrd c.rrd", 0),
    "query": ("a.json everything", 0),
    "render": ("a.rrd --frame 0 -o frame.png", 0),
    "simulate": ("bedroom bedroom --frames 2 --gap 1", 0),
}
FORCE = {name: ["--force"] for name in ("convert", "process", "render", "simulate")}
ELSEWHERE = {"completion", "datasets get", "view"}  # a script is none; test_datasets.py, test_view.py


def asked_of(name):
    if name == "simulate" and find_spec("open3d") is None:
        pytest.skip("needs Open3D")
    return TOLD[name]


def test_every_command_is_asked_for_json():
    assert set(TOLD) | ELSEWHERE == set(LEAVES)


@pytest.mark.parametrize("name", TOLD)
def test_json_is_all_of_standard_output(logs, name, monkeypatch):
    rest, code = asked_of(name)
    monkeypatch.chdir(logs)
    (option,) = (p for p in COMMANDS[name].params if "--json" in p.opts)
    asked = ["--json"] if option.is_flag else ["--json", "-"]
    done = CliRunner().invoke(cli, [*name.split(), *rest.split(), *FORCE.get(name, []), *asked], catch_exceptions=False)
    assert done.exit_code == code, done.stderr
    assert json.loads(done.stdout)


# ---- terminals and logs

BAR, LINES = "━╸╺", "│┃┏┡└"
QUICK = ("diff", "info", "process", "query")  # a table, rows, a bar, answers; the others are told by the same functions
ESCAPE = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")
COLOUR = re.compile(r"\x1b\[[0-9;]*\b(3[0-7]|38|4[0-7]|48|9[0-7]|10[0-7])[;m]")


@pytest.mark.parametrize(("name", "columns"), [*((name, 40) for name in QUICK), ("process", 80)])
def test_a_narrow_terminal_shows_all_of_it(logs, name, columns):
    """No frame of the bar and no row of a table is wider; without colours at 40, with them at 80."""
    pytest.importorskip("pty")
    from terminal import in_terminal

    rest, expected = asked_of(name)
    plain = {"NO_COLOR": "1"} if columns == 40 else {}
    words = [*name.split(), *rest.split(), *FORCE.get(name, [])]
    code, shown = in_terminal(*words, cwd=logs, columns=columns, **plain)
    assert code == expected, shown
    lines = re.split(r"[\r\n]+", ESCAPE.sub("", shown))
    drawn = [line for line in lines if set(line) & set(BAR + LINES)]
    assert max(map(cell_len, drawn), default=0) <= columns
    assert "…" not in shown
    assert bool(COLOUR.search(shown)) == (name == "process" and columns == 80)
    assert drawn or name in ("info", "query")  # no bar, and rows as lines


@pytest.mark.parametrize("name", QUICK)
def test_what_is_no_terminal_gets_whole_lines_and_no_control_characters(logs, name, monkeypatch):
    rest, code = asked_of(name)
    monkeypatch.chdir(logs)
    told = {}
    for columns in ("40", "200"):
        monkeypatch.setenv("COLUMNS", columns)
        done = CliRunner().invoke(cli, [*name.split(), *rest.split(), *FORCE.get(name, [])], catch_exceptions=False)
        assert done.exit_code == code, done.stderr
        assert all(c.isprintable() or c == "\n" for c in done.stdout + done.stderr)
        told[columns] = re.sub(r"[\d.]+( ms| MB)?|[─━]|  +", "", done.stdout)
    assert told["40"] == told["200"]


def test_only_a_first_run_tells_that_kernels_are_compiled(logs, tmp_path):
    """The doctor, which people run before, compiles a few; what is refused is refused alone."""
    pytest.importorskip("pty")
    from terminal import in_terminal

    def shown(*words, **how):
        code, text = in_terminal(*words, cwd=logs, columns=80, **how)
        return code, text.count(COMPILING)

    new = {"XDG_CACHE_HOME": str(tmp_path)}
    assert shown("doctor", "room", **new) == (0, 0)
    assert shown("process", "nowhere", **new) == (2, 0)
    assert shown("process", "room", "--rrd", "first.rrd", until=COMPILING, **new) == (-signal.SIGKILL, 1)
    assert shown("process", "room", "--rrd", "second.rrd") == (0, 0)
