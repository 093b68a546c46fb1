"""The case that checks work on: an opened log, its timeline, and what its images showed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import cast

from vlmm_log.checks.edges import Alignment
from vlmm_log.checks.probe import Samples, distant_alignments, sample
from vlmm_log.checks.timeline import Timeline, read_timeline
from vlmm_log.models.dis import Dis
from vlmm_log.protocols import Progress
from vlmm_log.readers import open_log
from vlmm_log.readers.stored import StoredLog
from vlmm_log.settings import ReadSettings, Settings

OF_IMAGES = (  # what decides how images are read; all else only decides how they are understood
    "topics",
    "distortion",
    "depth_units_per_meter",
    "association_s",
    "depth_offset_s",
    "depth_shift_px",
    "depth_to_rgb",
)
OF_STAMPS = ("topics", "association_s", "depth_offset_s", "start_s", "stop_s")  # what decides which images meet


@dataclass(frozen=True, eq=False)
class Case:
    """A log under settings, with no limit to depth, so that wrong units are seen."""

    path: Path
    settings: Settings
    tell: Progress
    log: StoredLog

    @staticmethod
    def open(path: Path, settings: Settings, tell: Progress) -> Case:
        """Raises InputError where the log cannot be opened."""
        unlimited = replace(settings.read, depth_min_m=0.0, depth_max_m=float("inf"))
        return Case(path, settings, tell, cast(StoredLog, open_log(path, unlimited)))

    @cached_property
    def timeline(self) -> Timeline:
        """Stamps of its images."""
        return read_timeline(self.log, self.read)

    @cached_property
    def samples(self) -> Samples:
        """What its images show."""
        return sample(self.log, self.timeline, Dis(self.settings.flow), self.tell)

    @cached_property
    def distant(self) -> list[Alignment]:
        """Its colour against depth of quite other moments."""
        return distant_alignments(self.log, self.timeline)

    @property
    def read(self) -> ReadSettings:
        """How it is read."""
        return self.settings.read

    def under(self, sets: tuple[str, ...]) -> Case:
        """The case under changed settings; its images are looked at again only if that changes what they show."""
        case = Case.open(self.path, self.settings.changed(sets), self.tell)
        kept = ["timeline"] if _equal(case.read, self.read, OF_STAMPS) else []
        same = _equal(case.read, self.read, OF_IMAGES) and case.log.units_per_meter == self.log.units_per_meter
        made_with_K = self.log.depth_camera is not None or bool(self.log.camera.distortion)
        if kept and same and not (made_with_K and case.read.intrinsics != self.read.intrinsics):
            kept.append("samples")
        for name in kept:
            if name in self.__dict__:
                case.__dict__[name] = self.__dict__[name]
        return case


def _equal(a: ReadSettings, b: ReadSettings, names: tuple[str, ...]) -> bool:
    return all(getattr(a, name) == getattr(b, name) for name in names)
