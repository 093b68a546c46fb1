"""Logs that are folders: lists of image files with stamps, and poses."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from vlmm_log.readers import intrinsics
from vlmm_log.readers.assembly import Assembly
from vlmm_log.readers.images import ImageError
from vlmm_log.readers.intrinsics import Intrinsics
from vlmm_log.readers.poses import Poses
from vlmm_log.readers.stamps import associate, limit_ns, until_ns
from vlmm_log.readers.stored import Kind, Shot, StoredImage, Stream, stream
from vlmm_log.settings import ReadSettings
from vlmm_log.types import Float64, Frame, InputError, Int64, Skipped

UNITS_PER_METER = 5000.0  # of TUM RGB-D


@dataclass(frozen=True)
class Row:
    """One line of a list: a stamp, and a file below the folder."""

    stamp_ns: int
    rest: str


@dataclass
class FolderLog:
    """An opened folder; images are read as frames are asked for."""

    name: str
    folder: Path
    camera: Intrinsics
    units_per_meter: float
    s: ReadSettings
    rgb: Sequence[Row]
    depth: Sequence[Row]
    pairs: Sequence[tuple[int, int]]  # rows of rgb and depth that belong together
    poses: Poses | None
    left_out: Sequence[Skipped]  # rows that never became an image or a pose
    notes: list[str] = field(default_factory=list)
    depth_camera: tuple[Intrinsics, Float64] | None = None

    @property
    def has_poses(self) -> bool:
        """Whether any pose was read."""
        return self.poses is not None

    @property
    def world_up(self) -> str:
        """That of the poses' world; the camera's -y where there are none."""
        return "-y" if self.poses is None else self.poses.world_up

    @property
    def streams(self) -> tuple[Stream, ...]:
        """See stored.StoredLog."""
        found = [stream("colour", "", "rgb", _stamps(self.rgb)), stream("depth", "", "depth", _stamps(self.depth))]
        if self.poses is not None:
            found.append(stream(self.poses.source, "", "pose", self.poses.stamps_ns))
        return tuple(found)

    @property
    def posed(self) -> str:
        """See stored.StoredLog."""
        if self.poses is None:
            return ""
        gap_ns = limit_ns(self.s.pose_gap_s)
        covered = sum(self.poses.at(self.depth[j].stamp_ns, gap_ns) is not None for _, j in self.pairs)
        return f"{self.poses.source}, {covered} of {len(self.pairs)} frames"

    @property
    def ranked(self) -> Mapping[str, tuple[str, ...]]:
        """See stored.StoredLog."""
        return {}

    @property
    def origin_ns(self) -> int:
        """Time of the first frame."""
        return self.depth[self.pairs[0][1]].stamp_ns

    def count(self, start_ns: int, stop_ns: int) -> int:
        """See protocols.Log."""
        since = (self.depth[j].stamp_ns - self.origin_ns for _, j in self.pairs)
        return sum(start_ns <= ns < until_ns(stop_ns) for ns in since)

    def frames(self, start_ns: int, stop_ns: int) -> Iterator[Frame | Skipped]:
        """See protocols.Log. ``Frame.index`` is the row of the colour images' list in time order."""
        events: list[tuple[int, tuple[int, int] | Skipped]] = [(x.stamp_ns, x) for x in self.left_out]
        events += [(x.stamp_ns, x) for x in self._alone()]
        events += [(self.depth[j].stamp_ns, (i, j)) for i, j in self.pairs]
        assembly = Assembly(self.camera, self.units_per_meter, self.poses, self.s, self.depth_camera)
        for stamp_ns, event in sorted(events, key=lambda e: e[0]):
            after_start = stamp_ns - self.origin_ns >= start_ns
            if stamp_ns - self.origin_ns >= until_ns(stop_ns):
                continue
            if isinstance(event, Skipped):
                if after_start or start_ns <= 0:  # rows before the first frame are told too
                    yield event
            elif after_start:
                yield from assembly.frames(self._shot("rgb", event[0]), self._shot("depth", event[1]))

    def shots(self, start_ns: int, stop_ns: int) -> Iterator[Shot | Skipped]:
        """See stored.StoredLog."""
        shots: list[Shot | Skipped] = [self._shot("rgb", i) for i in range(len(self.rgb))]
        shots += [self._shot("depth", j) for j in range(len(self.depth))]
        for shot in sorted([*shots, *self.left_out], key=lambda x: x.stamp_ns):
            since = shot.stamp_ns - self.origin_ns
            if since < until_ns(stop_ns) and (start_ns <= since or (start_ns <= 0 and isinstance(shot, Skipped))):
                yield shot

    def _alone(self) -> Iterator[Skipped]:
        """Images without a partner."""
        for rows, used, partner in (
            (self.rgb, {i for i, _ in self.pairs}, "depth"),
            (self.depth, {j for _, j in self.pairs}, "colour"),
        ):
            reason = f"no {partner} image within {self.s.association_s:g} s"
            for k, row in enumerate(rows):
                if k not in used:
                    yield Skipped(row.stamp_ns, row.rest, reason, k if rows is self.rgb else None)

    def _shot(self, kind: Kind, k: int) -> Shot:
        row = self.rgb[k] if kind == "rgb" else self.depth[k]
        return Shot(kind, row.stamp_ns, k, row.rest, partial(_read, self.folder, row.rest))


def _stamps(rows: Sequence[Row]) -> Int64:
    return np.array([row.stamp_ns for row in rows], np.int64)


def associated(
    path: Path,
    s: ReadSettings,
    own: Intrinsics | None,
    rgb: Sequence[Row],
    depth: Sequence[Row],
    poses: Poses | None,
    left_out: list[Skipped],
) -> FolderLog:
    """The log of two lists of images in time order. Raises InputError where no two belong together.

    ``own`` is the camera as the folder or its sensor's publication has it; ``left_out`` what the lists lost already.
    """
    for name, value in (("topics", s.topics), ("depth_to_rgb", s.depth_to_rgb)):
        if value:
            raise InputError(f"{path}: read.{name} is for bags; a folder has no use for it")
    camera = intrinsics.asked(s, own, path)
    units = s.depth_units_per_meter or camera.depth_scale or UNITS_PER_METER
    offset_ns = round(s.depth_offset_s * 1e9)
    depth = [Row(r.stamp_ns + offset_ns, r.rest) for r in depth] if offset_ns else depth
    pairs = associate([r.stamp_ns for r in rgb], [r.stamp_ns for r in depth], limit_ns(s.association_s))
    if not pairs:
        raise InputError(
            f"{path}: no colour image within {s.association_s} s of a depth image; "
            "check the stamps or raise --set read.association_s"
        )
    poses = None if s.poses == "none" else poses
    origin_ns = depth[pairs[0][1]].stamp_ns
    told = [replace(x, stamp_ns=x.stamp_ns or origin_ns) for x in left_out]  # what has no time of its own
    notes = Assembly(camera, units, poses, s).notes()
    notes.append("no poses" if poses is None else f"{poses.stamps_ns.size} poses from {poses.source}")
    notes.append(f"{len(pairs)} of {len(rgb)} colour images have depth, the first at {origin_ns} ns")
    name = path.resolve().name.encode("utf-8", "backslashreplace").decode()
    return FolderLog(name, path, camera, units, s, rgb, depth, pairs, poses, told, notes)


def _read(folder: Path, name: str) -> StoredImage:
    try:
        path = (folder / name).resolve()
        if not path.is_relative_to(folder.resolve()):
            raise ImageError("listed file lies outside the folder")
        if path.is_fifo():  # it would be waited for
            raise ImageError("listed path is a pipe")
        return StoredImage(path.read_bytes())
    except FileNotFoundError as e:
        raise ImageError("listed file is missing") from e
    except OSError as e:
        raise ImageError(f"listed file cannot be read: {e.strerror}") from e
    except (ValueError, RuntimeError) as e:  # a NUL byte, a loop of links
        raise ImageError("listed path is no path") from e
