"""What holds for every command: its help has examples that parse, a shell completes it, and scripts get JSON."""

import inspect
import json
import os
import shlex
import subprocess
import sys
from importlib.util import find_spec
from itertools import takewhile

import click
import pytest
from click.testing import CliRunner
from small_room import write_small_room

from vlmm_log.cli import cli
from vlmm_log.commands.options import taken
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
ELSEWHERE = {"completion", "datasets get", "view"}  # a script is none; test_datasets.py, test_view.py


def test_every_command_is_asked_for_json():
    assert set(TOLD) | ELSEWHERE == set(LEAVES)


@pytest.mark.parametrize("name", TOLD)
def test_json_is_all_of_standard_output(logs, name, monkeypatch):
    if name == "simulate" and find_spec("open3d") is None:
        pytest.skip("needs Open3D")
    rest, code = TOLD[name]
    monkeypatch.chdir(logs)
    (option,) = (p for p in COMMANDS[name].params if "--json" in p.opts)
    asked = ["--json"] if option.is_flag else ["--json", "-"]
    done = CliRunner().invoke(cli, [*name.split(), *rest.split(), *asked], catch_exceptions=False)
    assert done.exit_code == code, done.stderr
    assert json.loads(done.stdout)
