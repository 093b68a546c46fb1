"""A full disk, no memory, a log that goes away, streams that close, no viewer: one line, and what was good stays."""

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from adverse import Machine, content, refusal, run
from small_room import write_small_room

import vlmm_log
from vlmm_log import viewing
from vlmm_log.recording import open_recording
from vlmm_log.types import InputError
from vlmm_log.writers.staging import replacing_folder

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="limits as Linux keeps them")
SMALL = 4096  # bytes
PROCESS = ("process", "room", "--force")
DIFF, QUERY = ("diff", "a.rrd", "b.rrd", "--force"), ("query", "a.rrd", "everything", "--force")
COMMANDS = {  # each replaces outputs that are there
    "process": (*PROCESS, "--rrd", "a.rrd"),
    "process, mcap": (*PROCESS, "--mcap", "a.mcap"),
    "process, resume": (*PROCESS, "--rrd", "a.rrd", "--resume"),
    "process, 2 workers": (*PROCESS, "--rrd", "a.rrd", "--workers", "2"),
    "convert, mcap": ("convert", "room", "twin.mcap", "--force"),
    "convert, bag": ("convert", "room", "twin.bag", "--force"),
    "convert, ros2": ("convert", "room", "twin", "--force"),
    "convert, tum": ("convert", "twin.bag", "again", "--force"),
    "query, rrd": (*QUERY, "--rrd", "hits.rrd"),
    "query, grid": (*QUERY, "--grid", "grid.yaml"),
    "diff, html": (*DIFF, "--html", "diff.html"),
    "diff, rrd": (*DIFF, "--rrd", "diff.rrd"),
    "diff, json": (*DIFF, "--json", "diff.json"),
    "eval, html": ("eval", "room", "--force", "--html", "eval.html"),
    "eval, json": ("eval", "room", "--force", "--json", "eval.json"),
}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A folder with a log and what every command makes of it."""
    folder = tmp_path_factory.mktemp("machine") / "made"
    write_small_room(folder / "room", 12)
    vlmm_log.process(folder / "room", rrd=folder / "b.rrd", settings=vlmm_log.Settings.load(sets=["noise.scale=2"]))
    for name, arguments in COMMANDS.items():
        if "resume" not in name and "workers" not in name:
            said = run(folder, arguments, Machine())
            assert said.returncode in (0, 1), said
    return folder


def unharmed(made, arguments, machine):
    """What is said, where all files stay what they were, and what else is there is told."""
    before = content(made)
    said = run(made, arguments, machine)
    after = content(made)
    more = sorted(after.keys() - before.keys())
    partials = [open_recording(made / name) for name in more if name.endswith(".rrd.partial")]
    for name in more:
        (made / name).unlink()
    assert not any(not partial.lost and partial.end and partial.end.complete for partial in partials)
    assert {name: data for name, data in after.items() if name in before} == before
    return said, more


@pytest.mark.parametrize("name", COMMANDS)
def test_a_full_disk(made, name):
    said, more = unharmed(made, COMMANDS[name], Machine(largest_file=SMALL))
    assert "cannot be" in refusal(said) or "no room" in refusal(said)
    assert not more


@pytest.mark.parametrize(
    ("name", "missing"), [*((name, 1 << 18) for name in COMMANDS if name.startswith("process")), ("process", 500)]
)
def test_a_disk_that_fills_while_pairs_are_recorded(made, name, missing):
    """In the middle, and in the footer."""
    size = (made / ("a.mcap" if "mcap" in name else "a.rrd")).stat().st_size
    said, more = unharmed(made, COMMANDS[name], Machine(largest_file=size - missing))
    assert "cannot be" in refusal(said) or "no room" in refusal(said)
    for partial in (p for p in more if p.endswith(".partial")):
        assert f"what was written until then is kept as {partial}" in refusal(said)
    assert all(p.endswith((".partial", ".journal")) for p in more)


@pytest.mark.parametrize("place", ["room/camera.txt/x", "/proc/x"])
@pytest.mark.parametrize(
    "arguments",
    [
        ("process", "room", "--rrd", "{}.rrd"),
        ("process", "room", "--map", "{}.json", "--rrd", "new.rrd"),
        ("convert", "room", "{}.mcap"),
        ("convert", "room", "{}"),
        ("query", "a.rrd", "everything", "--rrd", "{}.rrd"),
        ("query", "a.rrd", "everything", "--masks", "{}"),
        ("diff", "a.rrd", "b.rrd", "--html", "{}.html"),
        ("diff", "a.rrd", "b.rrd", "--rrd", "{}.rrd"),
        ("eval", "room", "--json", "{}.json"),
        ("simulate", "kitchen", "{}", "--frames", "1"),
        ("batch", "room", "--out", "{}"),
    ],
    ids=" ".join,
)
def test_a_place_that_takes_no_file(made, arguments, place):
    said, more = unharmed(made, tuple(a.format(place) for a in arguments), Machine())
    assert place in refusal(said)
    assert not more


def test_a_batch_on_a_full_disk_tells_which_log_failed(made):
    said = run(made, ("batch", "room", "--out", "out", "--workers", "1"), Machine(largest_file=1 << 15))
    assert said.returncode == 1, said
    assert "is the disk full?" in said.stdout or "cannot be" in said.stdout
    assert sorted(p.name for p in (made / "out").iterdir()) == [".lock", "manifest.json", "summary.parquet"]
    shutil.rmtree(made / "out")


# ---- a log that goes away


@pytest.mark.parametrize(
    ("log", "lost", "how"),
    [("room", "log", "removed"), ("twin.bag", "log.bag", "cut"), ("twin.mcap", "log.mcap", "cut")],
)
@pytest.mark.parametrize("command", [("process", "--rrd", "a.rrd", "--force"), ("convert", "twin", "--force")])
def test_a_log_that_goes_away_meanwhile(made, log, lost, how, command):
    copy = made / lost
    shutil.copytree(made / log, copy) if (made / log).is_dir() else shutil.copyfile(made / log, copy)
    try:
        kept = {name: data for name, data in content(made).items() if not name.startswith("log")}
        said = run(made, (command[0], lost, *command[1:]), Machine(lost=(lost, how)))
        assert f"{lost}: " in refusal(said)
        assert "were lost or cut while it was read" in refusal(said)
        after = {name: data for name, data in content(made).items() if not name.startswith("log")}
        partial = after.pop("a.rrd.partial", None)
        assert after == kept
        if command[0] == "process":
            assert "what was written until then is kept as a.rrd.partial" in refusal(said)
            assert partial
            (made / "a.rrd.partial").unlink()
    finally:
        if copy.exists():
            shutil.rmtree(copy) if copy.is_dir() else copy.unlink()


# ---- memory


@pytest.mark.parametrize("name", ["process", "process, mcap", "process, resume", "process, 2 workers"])
def test_memory_that_ends_in_the_middle(made, name):
    said, left = unharmed(made, COMMANDS[name], Machine(lost=("", "no memory")))
    assert "out of memory" in refusal(said)
    (partial,) = (name for name in left if name.endswith(".partial"))
    assert f"what was written until then is kept as {partial}" in refusal(said)


# ---- streams


def shell(command, folder):
    python = f"{sys.executable} -c 'from vlmm_log.cli import main; main()'"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    return subprocess.run(
        ["bash", "-c", command.replace("VLMM", python)],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=60,
    )


@pytest.mark.parametrize("megabytes", [400, 700, 1300, 2000])
def test_without_memory_what_is_good_stays(made, megabytes):
    """Some library may end the process itself; else it is one line."""
    good = content(made)
    done = shell(f"ulimit -v {megabytes}000; VLMM process room --rrd a.rrd --force", made)
    (made / "a.rrd.partial").unlink(missing_ok=True)
    assert content(made) == good
    assert done.returncode
    assert "Traceback" not in done.stderr
    assert done.returncode != 2 or "out of memory" in done.stderr.splitlines()[-1]


@pytest.mark.parametrize("what", ["info room --json", "query a.rrd everything"])
def test_nobody_reads_to_the_end(made, what):
    done = shell(f"VLMM {what} | true; echo ${{PIPESTATUS[0]}}", made)
    assert (done.stdout, done.stderr) == ("141\n", "")


def test_stdout_that_takes_no_more(made):
    done = shell("VLMM info room --json >/dev/full", made)
    assert (done.returncode, done.stderr) == (2, "vlmm-log: cannot be written: No space left on device\n")


@pytest.mark.parametrize("stream", ["2>/dev/full", "2>&-", ">&- 2>&-", "<&- >&- 2>&-"])
def test_a_refusal_that_nobody_can_hear(made, stream):
    assert shell(f"VLMM info nowhere {stream}", made).returncode == 2


@pytest.mark.parametrize("stream", ["2>&-", "<&- >&- 2>&-"])
def test_a_run_without_streams_writes_what_it_writes_with_them(made, tmp_path, stream):
    done = shell(f"VLMM process {made}/room --rrd a.rrd {stream}", tmp_path)
    assert done.returncode == 0
    assert vlmm_log.diff(made / "a.rrd", tmp_path / "a.rrd").same


# ---- the viewer


def viewer(path, code):
    path.write_text(f"#!/bin/sh\n{code}\n")
    path.chmod(0o755)
    return path


@pytest.mark.parametrize(
    ("code", "told"),
    [
        ("exit 3", "the viewer ended with exit code 3; the recordings are as they were"),
        ("kill -9 $$", "the viewer was ended by SIGKILL; the recordings are as they were"),
    ],
)
def test_a_viewer_that_goes_away(made, tmp_path, monkeypatch, code, told):
    monkeypatch.setattr(viewing, "_viewer", lambda: viewer(tmp_path / "rerun", code))
    with pytest.raises(InputError) as e:
        viewing.view([made / "a.rrd"])
    assert str(e.value) == told


def test_a_viewer_that_is_missing(made, tmp_path, monkeypatch):
    monkeypatch.setattr(viewing, "_viewer", lambda: tmp_path / "rerun")
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(InputError, match="the viewer cannot be started: No such file"):
        viewing.view([made / "a.rrd"])
    assert signal.getsignal(signal.SIGTERM) is before


def test_a_viewer_that_is_closed(made, tmp_path, monkeypatch):
    monkeypatch.setattr(viewing, "_viewer", lambda: viewer(tmp_path / "rerun", "exit 0"))
    viewing.view([made / "a.rrd"])


@pytest.mark.parametrize("stderr", ["2>/dev/full", "2> >(head -n 0)"])
def test_progress_that_nobody_takes_stops_no_run(made, stderr):
    often = (
        "import functools, vlmm_log.progress as p; p._plain_lines = functools.partial(p._plain_lines, every_s=0.0); "
    )
    main = f"{often}from vlmm_log.cli import main; main()"
    done = shell(f"{sys.executable} -c '{main}' process room --rrd heard.rrd --force {stderr}", made)
    assert done.returncode == 0, done
    assert open_recording(made / "heard.rrd").end.complete
    (made / "heard.rrd").unlink()


# ---- folders that take another's place


def test_a_folder_that_was_put_aside_comes_back(tmp_path):
    """What a kill between two renames leaves, where no system call exchanges them."""
    aside = tmp_path / "out.partial/replaced"
    aside.mkdir(parents=True)
    (aside / "rgb.txt").write_text("good")
    with pytest.raises(InputError, match="no more"), replacing_folder(tmp_path / "out"):
        raise OSError("no more")
    assert content(tmp_path) == {"out/rgb.txt": b"good"}


@pytest.mark.parametrize("can", [True, False])
def test_a_folder_takes_the_place_of_another(tmp_path, monkeypatch, can):
    if not can:
        monkeypatch.setattr("vlmm_log.writers.staging._exchanged", lambda *_: False)
    (tmp_path / "out").mkdir()
    (tmp_path / "out/rgb.txt").write_text("old")
    with replacing_folder(tmp_path / "out") as staged:
        staged.mkdir()
        (staged / "rgb.txt").write_text("new")
    assert content(tmp_path) == {"out/rgb.txt": b"new"}
    assert [p.name for p in Path(tmp_path).iterdir()] == ["out"]
