"""Commands on a machine that refuses: how they are run, and what they may leave."""

from __future__ import annotations

import contextlib
import os
import resource
import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from killing import SERVER

from vlmm_log import cli

PATIENCE_S = 60


@dataclass(frozen=True)
class Said:
    """What came of a command."""

    code: int  # negative: the signal that ended it
    out: str
    err: str

    @property
    def line(self) -> str:
        """The one line of a refusal."""
        assert self.code == 2, self
        lines = [line for line in self.err.splitlines() if "s left" not in line]  # of progress
        assert len(lines) == 1, self
        assert "internal error" not in lines[0], self
        return lines[0]


@dataclass(frozen=True)
class Machine:
    """What it refuses."""

    largest_file: int | None = None  # bytes, as a full disk
    more_memory: int | None = None  # bytes beyond what the process has when it begins
    lost: tuple[str, str] | None = None  # (a path, what happens to it) after the first step of progress


def run(folder: Path, arguments: tuple[str, ...], machine: Machine) -> Said:
    """A command that ends, in a folder; what it says lies beside that."""
    child = SERVER.Process(target=_run, args=(folder, arguments, machine))
    child.start()
    child.join(PATIENCE_S)
    if child.is_alive():
        child.kill()
        raise AssertionError(f"{arguments} hangs")
    told = [folder.with_name(f"{folder.name}.{name}").read_text() for name in ("out", "err")]
    return Said(child.exitcode, *told)


def _run(folder: Path, arguments: tuple[str, ...], machine: Machine) -> None:
    os.chdir(folder)
    for number, name in ((1, "out"), (2, "err")):
        file = os.open(folder.with_name(f"{folder.name}.{name}"), os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(file, number)
    sys.argv = ["vlmm-log", *arguments]
    if machine.lost is not None:
        _watch(*machine.lost)
    if machine.largest_file is not None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (machine.largest_file, machine.largest_file))
    if machine.more_memory is not None:
        _limit(machine.more_memory)
    cli.main()


def _limit(more: int) -> None:
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + more,) * 2)


def _watch(path: str, how: str) -> None:
    """Lose an input in the middle: every command tells its progress."""
    import vlmm_log.commands.convert
    import vlmm_log.commands.process

    @contextlib.contextmanager
    def progress(*_what: object, **_more: object):
        def told(done: int, *_others: object, **_more: object) -> None:
            if done == 1:
                LOSSES[how](Path(path))

        yield told

    vlmm_log.commands.convert.progress = vlmm_log.commands.process.progress = progress


def _half(path: Path) -> None:
    os.truncate(path, path.stat().st_size // 2)


def _remove(path: Path) -> None:
    shutil.rmtree(path) if path.is_dir() else path.unlink()


LOSSES: dict[str, Callable[[Path], None]] = {
    "removed": _remove,
    "cut": _half,
    "no memory": lambda _: _limit(0),
}


def content(folder: Path) -> dict[str, bytes]:
    """Name -> bytes of all files below."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}
