"""Commands on a machine that refuses: how they are run, and what they may leave."""

from __future__ import annotations

import contextlib
import os
import resource
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from command_line import Done, command


@dataclass(frozen=True)
class Machine:
    """What it refuses."""

    largest_file: int | None = None  # bytes, as a full disk
    lost: tuple[str, str] | None = None  # (a path, what happens to it) after the first step of progress


def run(folder: Path, arguments: tuple[str, ...], machine: Machine) -> Done:
    """A command that ends, in a folder."""
    return command(*arguments, cwd=folder, before=partial(_refuse, machine), timeout=60)


def refusal(done: Done) -> str:
    """Its one line."""
    assert done.returncode == 2, done
    lines = [line for line in done.stderr.splitlines() if "s left" not in line]  # of progress
    assert len(lines) == 1, done
    assert "internal error" not in lines[0], done
    return lines[0]


def _refuse(machine: Machine) -> None:
    if machine.lost is not None:
        _watch(*machine.lost)
    if machine.largest_file is not None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (machine.largest_file, machine.largest_file))


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


def _no_memory(_: Path) -> None:
    raise MemoryError


LOSSES: dict[str, Callable[[Path], None]] = {
    "removed": _remove,
    "cut": _half,
    "no memory": _no_memory,
}


def content(folder: Path) -> dict[str, bytes]:
    """Name -> bytes of all files below."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}
