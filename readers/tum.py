"""TUM RGB-D folders: rgb.txt, depth.txt, groundtruth.txt beside the images. Sturm et al., IROS 2012."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from vlmm_log.protocols import Log
from vlmm_log.readers import intrinsics
from vlmm_log.readers.images import ImageError, decode_depth, decode_rgb, media_type
from vlmm_log.readers.intrinsics import Intrinsics
from vlmm_log.readers.poses import Trajectory, trajectory, usable_pose
from vlmm_log.readers.stamps import LATEST_NS, associate, limit_ns, seconds_to_ns
from vlmm_log.settings import ReadSettings
from vlmm_log.types import EncodedImage, Float64, Frame, InputError, Skipped

UNITS_PER_METER = 5000.0


class Tum:
    """The reader."""

    name = "tum"

    def recognises(self, path: Path) -> bool:
        """A folder with rgb.txt or depth.txt."""
        return is_tum_folder(path)

    def open(self, path: Path, s: ReadSettings) -> Log:
        """The log of a folder. Raises InputError where lists or intrinsics are missing."""
        found = re.search(r"freiburg[123]", path.resolve().name)
        return open_folder(path, s, intrinsics.FREIBURG[found[0]] if found else None)


def is_tum_folder(path: Path) -> bool:
    """Whether at least one of the two image lists is there."""
    return (path / "rgb.txt").is_file() or (path / "depth.txt").is_file()


@dataclass(frozen=True)
class _Row:
    stamp_ns: int
    rest: str  # of the line, after the stamp


@dataclass
class TumLog:
    """An opened folder; images are read as frames are asked for."""

    name: str
    folder: Path
    camera: Intrinsics
    units_per_meter: float
    s: ReadSettings
    rgb: list[_Row]
    depth: list[_Row]
    pairs: list[tuple[int, int]]  # rows of rgb and depth that belong together
    poses: Trajectory | None
    world: Float64  # (4, 4), with ``marker``: camera-to-world = world @ listed pose @ marker
    marker: Float64
    left_out: list[Skipped]  # rows that never became a frame
    notes: list[str] = field(default_factory=list)

    @property
    def has_poses(self) -> bool:
        """Whether any pose was read."""
        return self.poses is not None

    @property
    def world_up(self) -> str:
        """The motion capture's z axis, turned by ``world``; the camera's -y where there are no poses."""
        if self.poses is None:
            return "-y"
        return "+z" if self.world[2, 2] == 1 else "+y"

    @property
    def origin_ns(self) -> int:
        """Time of the first frame."""
        return self.depth[self.pairs[0][1]].stamp_ns

    def count(self, start_ns: int, stop_ns: int) -> int:
        """See protocols.Log."""
        return sum(start_ns <= self.depth[j].stamp_ns - self.origin_ns < stop_ns for _, j in self.pairs)

    def frames(self, start_ns: int, stop_ns: int) -> Iterator[Frame | Skipped]:
        """See protocols.Log. ``Frame.index`` is the row of rgb.txt in time order."""
        events: list[tuple[int, tuple[int, int] | Skipped]] = [(x.stamp_ns, x) for x in self.left_out]
        events += [(self.depth[j].stamp_ns, (i, j)) for i, j in self.pairs]
        size: tuple[int, ...] | None = None
        for stamp_ns, event in sorted(events, key=lambda e: e[0]):
            after_start = stamp_ns - self.origin_ns >= start_ns
            if stamp_ns - self.origin_ns >= stop_ns:
                continue
            if isinstance(event, Skipped):
                if after_start or start_ns <= 0:  # rows before the first frame are told too
                    yield event
                continue
            if not after_start:
                continue
            frame = self._frame(*event)
            if isinstance(frame, Frame):
                size = size or frame.depth.shape
                if frame.depth.shape != size:
                    reason = "image size differs from the first frame's"
                    yield Skipped(stamp_ns, self.rgb[event[0]].rest, reason, frame.index)
                    continue
                if self.poses is not None and frame.T_world_cam is None:
                    yield Skipped(stamp_ns, f"pose of frame {frame.index}", _no_pose(self.s), frame.index)
            yield frame

    def _frame(self, i: int, j: int) -> Frame | Skipped:
        rgb_row, depth_row = self.rgb[i], self.depth[j]
        try:
            rgb_data, depth_data = self._read(rgb_row), self._read(depth_row)
            rgb = decode_rgb(rgb_data)
            depth = decode_depth(depth_data, self.units_per_meter, self.s.depth_min_m, self.s.depth_max_m)
            self._check_size(rgb.shape, depth.shape)
        except ImageError as e:
            return Skipped(depth_row.stamp_ns, f"{rgb_row.rest}, {depth_row.rest}", str(e), i)
        T = None if self.poses is None else self.poses.at(depth_row.stamp_ns, limit_ns(self.s.pose_gap_s))
        T = None if T is None else self.world @ T @ self.marker
        rgb_media, depth_media = media_type(rgb_data), media_type(depth_data)
        return Frame(
            depth_row.stamp_ns,
            i,
            rgb,
            depth,
            self.camera.K,
            T,
            EncodedImage(rgb_data, rgb_media) if rgb_media else None,
            EncodedImage(depth_data, depth_media, self.units_per_meter) if depth_media else None,
        )

    def _read(self, row: _Row) -> bytes:
        try:
            path = (self.folder / row.rest).resolve()
            if not path.is_relative_to(self.folder.resolve()):
                raise ImageError("listed file lies outside the folder")
            return path.read_bytes()
        except FileNotFoundError as e:
            raise ImageError("listed file is missing") from e
        except OSError as e:
            raise ImageError(f"listed file cannot be read: {e.strerror}") from e
        except (ValueError, RuntimeError) as e:  # a NUL byte, a loop of links
            raise ImageError("listed path is no path") from e

    def _check_size(self, rgb: tuple[int, ...], depth: tuple[int, ...]) -> None:
        if rgb[:2] != depth[:2]:
            raise ImageError(
                f"colour is {rgb[1]}x{rgb[0]}, depth is {depth[1]}x{depth[0]}; register depth to colour first"
            )
        c = self.camera
        if c.width and (c.height, c.width) != rgb[:2]:
            raise ImageError(
                f"image is {rgb[1]}x{rgb[0]}, intrinsics ({c.source}) are for {c.width}x{c.height}; "
                "give --intrinsics fx,fy,cx,cy"
            )


IDENTITY: Float64 = np.eye(4)


def open_folder(
    path: Path, s: ReadSettings, known: Intrinsics | None, world: Float64 = IDENTITY, marker: Float64 = IDENTITY
) -> TumLog:
    """A folder in TUM layout, its sensor's published intrinsics if known, as a log.

    ``world`` and ``marker`` (4, 4) turn a listed pose into camera-to-world: ``world @ pose @ marker``.
    """
    left_out: list[Skipped] = []
    rgb, depth = _image_list(path / "rgb.txt", left_out), _image_list(path / "depth.txt", left_out)
    camera = _camera(path, s, known)
    units = s.depth_units_per_meter or camera.depth_scale or UNITS_PER_METER
    tolerance_ns = limit_ns(s.association_s)
    pairs = associate([r.stamp_ns for r in rgb], [r.stamp_ns for r in depth], tolerance_ns)
    if not pairs:
        raise InputError(
            f"{path}: no colour image within {s.association_s} s of a depth image; "
            "check the stamps or raise --set read.association_s"
        )
    for rows, used, partner in ((rgb, {i for i, _ in pairs}, "depth"), (depth, {j for _, j in pairs}, "colour")):
        reason = f"no {partner} image within {s.association_s:g} s"
        for k, row in enumerate(rows):
            if k not in used:
                left_out.append(Skipped(row.stamp_ns, row.rest, reason, k if rows is rgb else None))
    poses = _poses(path / "groundtruth.txt", left_out)
    notes = [f"intrinsics {camera.fx:g}, {camera.fy:g}, {camera.cx:g}, {camera.cy:g} px from {camera.source}"]
    notes.append(f"depth {units:g} per metre")
    notes.append("no poses" if poses is None else f"{poses.stamps_ns.size} poses from groundtruth.txt")
    notes.append(f"{len(pairs)} of {len(rgb)} colour images have depth, the first at {depth[pairs[0][1]].stamp_ns} ns")
    name = path.resolve().name.encode("utf-8", "backslashreplace").decode()
    return TumLog(name, path, camera, units, s, rgb, depth, pairs, poses, world, marker, left_out, notes)


def _no_pose(s: ReadSettings) -> str:
    return f"no two poses around it within {s.pose_gap_s:g} s"


def _camera(path: Path, s: ReadSettings, known: Intrinsics | None) -> Intrinsics:
    own = intrinsics.from_file(path / "camera.txt") if (path / "camera.txt").is_file() else known
    if s.intrinsics:
        given = intrinsics.from_text(s.intrinsics)
        scale = given.depth_scale or (own.depth_scale if own else 0.0)  # what is not given stays as it was
        return replace(given, depth_scale=scale)
    if own is None:
        raise InputError(
            f"{path}: no intrinsics: no camera.txt in it and no freiburg1-3 in its name; give --intrinsics fx,fy,cx,cy"
        )
    return own


def _rows(path: Path, left_out: list[Skipped]) -> list[_Row]:
    """Rows of a TUM list in time order; what is unreadable, repeated or out of order is told in left_out."""
    try:
        lines = path.read_text("utf-8").splitlines()
    except FileNotFoundError as e:
        raise InputError(f"{path}: not found; a TUM folder has rgb.txt and depth.txt") from e
    except (OSError, UnicodeDecodeError) as e:
        raise InputError(f"{path}: cannot be read: {e}") from e
    rows: list[_Row] = []
    latest = -LATEST_NS
    unreadable: list[tuple[int, str]] = []  # rows read before, where
    for number, line in enumerate(lines, 1):
        words = line.strip().split(maxsplit=1)
        if not words or words[0].startswith("#"):
            continue
        where = f"{path.name}:{number}"
        try:
            row = _Row(seconds_to_ns(words[0]), words[1])
        except (ValueError, IndexError):
            unreadable.append((len(rows), where))
            continue
        if row.stamp_ns < latest:
            left_out.append(Skipped(row.stamp_ns, where, "stamp out of order; the row was sorted in"))
        latest = max(latest, row.stamp_ns)
        rows.append(row)
    for k, where in unreadable:  # told at the time of the row before, or of the first
        stamp_ns = rows[max(k - 1, 0)].stamp_ns if rows else 0
        left_out.append(Skipped(stamp_ns, where, "row is not 'seconds value ...'"))
    rows.sort(key=lambda r: r.stamp_ns)
    unique = [row for k, row in enumerate(rows) if k == 0 or row.stamp_ns != rows[k - 1].stamp_ns]
    repeated = [row for k, row in enumerate(rows) if k and row.stamp_ns == rows[k - 1].stamp_ns]
    left_out += [Skipped(row.stamp_ns, f"{path.name}: {row.rest}", "stamp repeated") for row in repeated]
    return unique


def _image_list(path: Path, left_out: list[Skipped]) -> list[_Row]:
    rows = _rows(path, left_out)
    if not rows:
        raise InputError(f"{path}: lists no image; write a row 'seconds path' for each")
    return [replace(row, rest=row.rest.split()[0]) for row in rows]


def _poses(path: Path, left_out: list[Skipped]) -> Trajectory | None:
    if not path.is_file():
        return None
    stamps: list[int] = []
    values: list[Float64] = []
    for row in _rows(path, left_out):
        try:
            pose = np.array([float(word) for word in row.rest.split()])
            reason = usable_pose(pose) if pose.size == 7 else "pose is not 'tx ty tz qx qy qz qw'"
        except ValueError:
            reason = "pose is not 'tx ty tz qx qy qz qw'"
        if reason:
            left_out.append(Skipped(row.stamp_ns, f"{path.name}: {row.rest[:60]}", reason))
            continue
        stamps.append(row.stamp_ns)
        values.append(pose)
    return trajectory(stamps, values)
