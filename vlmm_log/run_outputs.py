"""The files of a run: claimed before it begins, opened once it does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from vlmm_log.maps import MAP_SUFFIXES
from vlmm_log.outputs import check_free, claim
from vlmm_log.protocols import Sink
from vlmm_log.resuming.journal import journal_of, placed
from vlmm_log.sinks.recorder import Recording, abandon, open_recording
from vlmm_log.types import InputError, Run

MCAP_SCHEMAS = ("ros2", "foxglove")


@dataclass(frozen=True)
class RunOutputs:
    """What a run is to write; None: that kind not."""

    rrd: Path | None
    mcap: Path | None
    map: Path | None
    mcap_schema: str = "ros2"

    @property
    def paths(self) -> list[Path]:
        """All of them."""
        return [path for path in (self.rrd, self.mcap, self.map) if path is not None]

    @property
    def recorded(self) -> bool:
        """Whether there are recordings among them."""
        return self.rrd is not None or self.mcap is not None

    def claim(self, inputs: Sequence[Path], *, force: bool, journal: Path | None) -> None:
        """Refuse before a run what could not be written at its end. Raises InputError.

        ``journal``: what a run left that is to be gone on with may be replaced.
        """
        _check_schema(self.mcap_schema)
        if self.map is not None:
            _check_map_name(self.map)
        begun = journal is not None and journal.exists()
        ours = frozenset[Path]() if journal is None else placed(journal)
        claim(self.paths, force=force, inputs=inputs, unfinished=begun, ours=ours)
        for path, suffix in ((self.rrd, ".rrd"), (self.mcap, ".mcap")):
            if path is not None and path.suffix != suffix:  # what is called otherwise is read otherwise
                raise InputError(f"{path}: a recording of this kind is called NAME{suffix}; name it so")

    def journal(self, sinks: Sequence[Sink]) -> Path:
        """Where what the pairs show is kept until all is whole. Raises InputError where that cannot be."""
        if not self.paths:
            raise InputError("resume needs an output, beside which to keep what the pairs showed; name one")
        if sinks:
            raise InputError(
                "resume: sinks of your own would not see the pairs of an earlier run; leave one of them out"
            )
        journal = journal_of(self.paths[0])
        check_free(journal, force=True)
        return journal

    def recordings(self, run: Run) -> list[Recording]:
        """Opened, as NAME.partial. Raises InputError where one cannot be written."""
        opened: list[Recording] = []
        try:
            if self.rrd is not None:
                from vlmm_log.sinks.rerun import RerunFile

                opened.append(open_recording(self.rrd, lambda path: RerunFile(path, run)))
            if self.mcap is not None:
                from vlmm_log.sinks.mcap import McapFile, load_dialect

                dialect = load_dialect(self.mcap_schema)
                opened.append(open_recording(self.mcap, lambda path: McapFile(path, run, dialect)))
        except InputError:
            abandon(opened)
            raise
        return opened


def _check_schema(name: str) -> None:
    if name not in MCAP_SCHEMAS:
        raise InputError(f"mcap_schema {name!r}: no such schemas; there are {', '.join(MCAP_SCHEMAS)}")
    if name == "foxglove" and find_spec("foxglove") is None:
        raise InputError("mcap_schema 'foxglove' needs foxglove-sdk: pip install 'vlmm-log[foxglove]'; or take ros2")


def _check_map_name(path: Path) -> None:
    if path.suffix.lower() not in MAP_SUFFIXES:
        raise InputError(f"{path}: a map is written as {', '.join(MAP_SUFFIXES)}; name it so")
    if path.suffix.lower() == ".ply" and find_spec("open3d") is None:
        raise InputError(f"{path}: a PLY needs Open3D: pip install 'vlmm-log[sim]'; or name a .json or .parquet")
