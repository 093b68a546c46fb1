"""Recordings read back, also of killed writers: entities, and their typed values in time. The only reader of them."""

from __future__ import annotations

from collections.abc import Collection, Container, Iterator
from pathlib import Path
from typing import Protocol

from vlmm_log.entries import Entry
from vlmm_log.types import InputError, Run, RunEnd

SUFFIXES = (".rrd", ".mcap")


class Recording(Protocol):
    """An opened recording."""

    @property
    def path(self) -> Path:
        """Where it lies."""
        ...

    @property
    def file(self) -> Path:
        """What is read of it: the same, or a copy without its torn end, as long as the recording is in use."""
        ...

    @property
    def run(self) -> Run:
        """What was asked for."""
        ...

    @property
    def end(self) -> RunEnd | None:
        """What came of it; None where the writer did not finish."""
        ...

    @property
    def entities(self) -> frozenset[str]:
        """What it holds values of."""
        ...

    @property
    def by_entity(self) -> bool:
        """Whether reading one entity is cheaper than reading all."""
        ...

    @property
    def looks(self) -> bool:
        """Whether it holds what only decides how a viewer draws."""
        ...

    @property
    def losses(self) -> tuple[str, ...]:
        """What could not be read so far, and why."""
        ...

    def entries(self, entities: Collection[str], frames: Container[int] | None = None) -> Iterator[Entry]:
        """The entries of some entities, as they stand in the file; of some frames, and what is of none.

        Raises InputError where it cannot be read.
        """
        ...


def is_recording(path: Path) -> bool:
    """Whether a file is called like a recording, or like one whose run was interrupted."""
    return path.name.removesuffix(".partial").endswith(SUFFIXES)


def is_mcap(path: Path) -> bool:
    """Whether a recording is called like one in MCAP."""
    return path.name.removesuffix(".partial").endswith(".mcap")


def open_recording(path: Path) -> Recording:
    """A recording of ``process``. Raises InputError where the file is none."""
    if not path.is_file():
        raise InputError(f"{path}: no such file; give a recording (.rrd or .mcap)")
    if is_mcap(path):
        from vlmm_log.recording.mcap import open_mcap

        return open_mcap(path)
    from vlmm_log.recording.rrd import open_rrd

    return open_rrd(path)
