"""A Rerun recording of each trial and baseline of a log, on the log's own timeline: what ``diff`` compares."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from vlmm_log.protocols import Log
from vlmm_log.settings import Settings
from vlmm_log.sinks.recorder import Recorder, open_recording
from vlmm_log.types import InputError, Run


@dataclass(frozen=True)
class Shelf:
    """Where a log's recordings go."""

    folder: Path
    log: Log
    reader: str
    versions: Mapping[str, str]

    def recorder(self, name: str, s: Settings, *, force: bool) -> Recorder:
        """A sink for one of them. Raises InputError where its file is there already, without ``force``."""
        from vlmm_log.sinks.blueprint import JUDGED
        from vlmm_log.sinks.rerun import RerunFile

        path = self.folder / f"{slug(name)}.rrd"
        if path.exists() and not force:
            raise InputError(f"{path}: exists; give --force to replace it")
        notes = (*self.log.notes, f"eval: {name}")
        log = self.log
        run = Run(log.name, self.reader, s.to_toml(), dict(self.versions), log.has_poses, log.world_up, notes)
        return Recorder([open_recording(path, lambda p: RerunFile(p, run, JUDGED))], dense=s.log.dense)


def slug(name: str) -> str:
    """A file's name of a trial's."""
    return re.sub(r"[^a-z0-9.=]+", "_", name.lower()).strip("_")
