"""SIGKILL at a random moment of a command, and what must hold afterwards: for test_kill and benchmarks.kill.

Half of the moments are of the clock. The others lie just before a file is opened to be written, renamed or removed, a
folder made or removed: each such step of a command is met as often as the next, however short it is.
"""

from __future__ import annotations

import os
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.context import ForkServerProcess
from pathlib import Path

import numpy as np
from command_line import SERVER

import vlmm_log
from vlmm_log import cli
from vlmm_log.batches.manifest import read_manifest
from vlmm_log.pipeline.run import Tally
from vlmm_log.recording import open_recording
from vlmm_log.settings import ReadSettings
from vlmm_log.types import InputError
from vlmm_log.workers import slot

FOUND = ("nothing", "begun", "readable", "done")  # how far a run had come when it was killed


@dataclass(frozen=True)
class Deed:
    """A command, its outputs, and what goes on after it was killed."""

    name: str
    run: tuple[str, ...]  # {room}: the log; paths are relative to the trial's folder
    again: tuple[str, ...]  # the options by which the rest is done
    outputs: tuple[str, ...]


PROCESS = ("process", "{room}", "--map", "a.json", "--query", "things that moved")
DEEDS = (
    Deed("process --resume", (*PROCESS, "--rrd", "a.rrd", "--resume"), (), ("a.rrd", "a.json")),
    Deed("process --resume, mcap", (*PROCESS, "--mcap", "a.mcap", "--resume"), (), ("a.mcap", "a.json")),
    Deed(
        "process --resume, 2 workers",
        (*PROCESS, "--rrd", "a.rrd", "--resume", "--workers", "2"),
        (),
        ("a.rrd", "a.json"),
    ),
    Deed("process", (*PROCESS, "--rrd", "a.rrd", "--mcap", "a.mcap"), ("--force",), ("a.rrd", "a.mcap", "a.json")),
    Deed("convert, mcap", ("convert", "{room}", "twin.mcap"), ("--force",), ("twin.mcap",)),
    Deed("convert, bag", ("convert", "{room}", "twin.bag"), ("--force",), ("twin.bag",)),
    Deed("convert, ros2", ("convert", "{room}", "twin_ros2", "--to", "ros2"), ("--force",), ("twin_ros2",)),
    Deed("convert, tum", ("convert", "{room}", "twin_tum", "--to", "tum"), ("--force",), ("twin_tum",)),
    Deed("batch", ("batch", "{room}", "--out", "out", "--mcap"), (), ("out",)),
)


STEPS = ("os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.truncate", "shutil.rmtree", "sqlite3.connect")
WRITES = os.O_WRONLY | os.O_RDWR
BESIDE = ("told.txt", "steps.txt", "tmp")  # of the trial, not of the command


class BrokenPromiseError(AssertionError):
    """What must never happen after a kill."""


@dataclass(frozen=True)
class Whole:
    """What runs leave that nobody killed."""

    folder: Path  # a folder a deed
    seconds: dict[str, float]
    steps: dict[str, int]  # that change files


def whole(room: Path, folder: Path, deeds: tuple[Deed, ...] = DEEDS) -> Whole:
    """Each deed done once."""
    seconds, steps = {}, {}
    for deed in deeds:
        there = folder / deed.name
        there.mkdir(parents=True)
        for _ in range(2):  # the first fills the caches
            for name in deed.outputs:
                _remove(there / name)
            begun = time.monotonic()
            _succeed(there, room, deed.run)
            seconds[deed.name] = time.monotonic() - begun
            steps[deed.name] = int((there / "steps.txt").read_text())
    return Whole(folder, seconds, steps)


def trial(deed: Deed, room: Path, folder: Path, good: Whole, rng: np.random.Generator) -> str:
    """Kill it somewhere, check, let it be finished, check again: what was found after the kill.

    Raises BrokenPromiseError.
    """
    folder.mkdir(parents=True)
    reference = good.folder / deed.name
    old = bool(rng.random() < 0.3) and deed.again == ("--force",)
    if old:
        for name in deed.outputs:
            _copy(reference / name, folder / name)
    arguments = (*deed.run, *(("--force",) if old else ()))
    if rng.random() < 0.5:
        child = started(folder, room, arguments, step=int(rng.integers(1, good.steps[deed.name] + 1)))
    else:
        child = started(folder, room, arguments)
        time.sleep(rng.uniform(0, 1.1) * good.seconds[deed.name])
        with suppress(ProcessLookupError):
            os.killpg(child.pid, signal.SIGKILL)
        child.kill()  # where it had no time to make its group
    child.join()
    if child.exitcode not in (0, -signal.SIGKILL):
        raise BrokenPromiseError(f"it failed by itself: {_told(folder)}")
    found = after_the_kill(deed, folder, reference, old=old)
    if found != "done":
        forced = deed.again if old or _anything(folder) else ()
        _succeed(folder, room, (*deed.run, *forced))
    for name in deed.outputs:
        _check_equal(reference / name, folder / name)
    left = _left(deed, folder) | {p.name for p in (folder / "tmp").glob("vlmm-log-*")}
    if left:
        raise BrokenPromiseError(f"left behind: {sorted(left)}")
    return found


def after_the_kill(deed: Deed, folder: Path, reference: Path, *, old: bool) -> str:
    """One of FOUND; an output under its own name is whole."""
    there = [name for name in deed.outputs if (folder / name).exists()]
    if deed.name != "batch":
        for name in there:
            _check_equal(reference / name, folder / name)
    if old and len(there) != len(deed.outputs):
        raise BrokenPromiseError(f"an output that was to be replaced is gone: only {there} are left")
    partials = list(folder.rglob("*.rrd.partial")) + list(folder.rglob("*.mcap.partial"))
    if not partials:
        done = not old and all(_files(folder / name) == _files(reference / name) for name in deed.outputs)
        return "done" if done and not _left(deed, folder) else "begun" if _anything(folder) else "nothing"
    if not deed.name.startswith(("process", "batch")):
        return "begun"
    found = "begun"
    for partial in partials:
        try:
            recording = open_recording(partial)
        except InputError:  # too young to hold settings
            continue
        if recording.end is None and not recording.lost:
            raise BrokenPromiseError(f"{partial.name} does not say that it is not whole")
        if sum(1 for _ in recording.entries(recording.entities)) > 0:
            found = "readable"
    return found


def started(folder: Path, room: Path, arguments: tuple[str, ...], step: int = 0) -> ForkServerProcess:
    """The command in a process that leads a group; what it imports is there: the kill falls into the work.

    With ``step`` it kills its group itself, before it changes files for the so-manieth time.
    """
    child = SERVER.Process(target=_run, args=(folder, room, arguments, step))
    child.start()
    return child


def _run(folder: Path, room: Path, arguments: tuple[str, ...], step: int) -> None:
    os.setpgid(0, 0)
    os.chdir(folder)
    Path("tmp").mkdir(exist_ok=True)
    os.environ["TMPDIR"] = tempfile.tempdir = str(folder / "tmp")
    slot.SHARED = folder / "tmp"
    told = os.open("told.txt", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(told, 1)
    os.dup2(told, 2)
    sys.argv = ["vlmm-log", *(a.replace("{room}", str(room)) for a in arguments)]
    done = 0

    def count(event: str, values: tuple[object, ...]) -> None:
        nonlocal done
        if event in STEPS or (event == "open" and isinstance(values[2], int) and values[2] & WRITES):
            done += 1
            if done == step:
                os.killpg(0, signal.SIGKILL)

    sys.addaudithook(count)
    try:
        cli.main()
    finally:
        Path("steps.txt").write_text(str(done))


def _succeed(folder: Path, room: Path, arguments: tuple[str, ...]) -> None:
    child = started(folder, room, arguments)
    child.join()
    if child.exitcode != 0:
        raise BrokenPromiseError(f"{' '.join(arguments)}: exit {child.exitcode}: {_told(folder)}")


def _told(folder: Path) -> str:
    return (folder / "told.txt").read_text().strip()[-300:]


def _left(deed: Deed, folder: Path) -> set[str]:
    return {p.name for p in folder.iterdir()} - {*deed.outputs, *BESIDE}


def _anything(folder: Path) -> bool:
    return any(p.name not in BESIDE for p in folder.iterdir())


def _check_equal(a: Path, b: Path) -> None:
    if not b.exists():
        raise BrokenPromiseError(f"{b.name} is missing")
    if not _held(a)(a, b):
        raise BrokenPromiseError(f"{b.name} is not what an uninterrupted run writes")


def _held(path: Path) -> Callable[[Path, Path], bool]:
    if path.suffix in (".rrd", ".mcap") and not path.name.startswith("twin"):
        return lambda a, b: a.read_bytes() == b.read_bytes() or vlmm_log.diff(a, b).same
    if path.name.startswith("twin"):
        return lambda a, b: frames_hash(a) == frames_hash(b)
    if path.name == "out":
        return _same_batches
    return lambda a, b: a.read_bytes() == b.read_bytes()


def frames_hash(path: Path) -> str:
    """Of all frames of a log."""
    tally = Tally()
    log = vlmm_log.open_log(path, ReadSettings())
    for _ in tally.counted(log.frames(0, 10**18)):
        pass
    return tally.input_hash()


def _same_batches(a: Path, b: Path) -> bool:
    """Raises BrokenPromiseError, which says what differs."""
    one, other = ([(t.folder, t.state, t.row) for t in read_manifest(out)] for out in (a, b))
    if one != other:
        raise BrokenPromiseError(f"the manifest says {other} instead of {one}")
    if _files(a) != _files(b):
        raise BrokenPromiseError(f"files: {sorted(_files(a) ^ _files(b))} are in one of them")
    return all(vlmm_log.diff(a / f / "run.rrd", b / f / "run.rrd").same for f, _, _ in one)


def _files(path: Path) -> set[str]:
    """All there is at an output's place; a batch's folder is there before its manifest and its summary are."""
    return {str(p.relative_to(path)) for p in (path, *path.rglob("*")) if p.exists()}


def _copy(source: Path, target: Path) -> None:
    if source.is_dir():
        shutil.copytree(source, target)
    else:
        shutil.copyfile(source, target)


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
