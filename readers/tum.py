"""TUM RGB-D folders: rgb.txt, depth.txt, groundtruth.txt beside the images. Sturm et al., IROS 2012."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from vlmm_log.protocols import Log
from vlmm_log.readers import conventions, intrinsics
from vlmm_log.readers.conventions import Convention
from vlmm_log.readers.folder import FolderLog, Row, associated
from vlmm_log.readers.intrinsics import Intrinsics
from vlmm_log.readers.poses import Link, Poses, Trajectory, trajectory, usable_pose
from vlmm_log.readers.stamps import LATEST_NS, seconds_to_ns
from vlmm_log.settings import ReadSettings
from vlmm_log.types import Float64, InputError, Skipped


class Tum:
    """The reader."""

    name = "tum"

    def recognises(self, path: Path) -> bool:
        """A folder with rgb.txt or depth.txt."""
        return is_tum_folder(path)

    def open(self, path: Path, s: ReadSettings) -> Log:
        """The log of a folder. Raises InputError where lists or intrinsics are missing."""
        found = re.search(r"freiburg[123]", path.resolve().name)
        return open_folder(path, s, intrinsics.FREIBURG[found[0]] if found else None, conventions.PLAIN)


def is_tum_folder(path: Path) -> bool:
    """Whether at least one of the two image lists is there."""
    return (path / "rgb.txt").is_file() or (path / "depth.txt").is_file()


def open_folder(path: Path, s: ReadSettings, known: Intrinsics | None, convention: Convention) -> FolderLog:
    """A folder in TUM layout as a log; its sensor's published intrinsics, if known, and its poses' convention."""
    left_out: list[Skipped] = []
    rgb, depth = _image_list(path / "rgb.txt", left_out), _image_list(path / "depth.txt", left_out)
    own = intrinsics.from_file(path / "camera.txt") if (path / "camera.txt").is_file() else known
    listed = listed_poses(path / "groundtruth.txt", left_out)
    poses = None
    if listed is not None:
        poses = Poses((Link(listed),), "groundtruth.txt", conventions.asked(s, convention))
    return associated(path, s, own, rgb, depth, poses, left_out)


def _rows(path: Path, left_out: list[Skipped]) -> list[Row]:
    """Rows of a TUM list in time order; what is unreadable, repeated or out of order is told in left_out."""
    try:
        lines = path.read_text("utf-8").splitlines()
    except FileNotFoundError as e:
        raise InputError(f"{path}: not found; a TUM folder has rgb.txt and depth.txt") from e
    except (OSError, UnicodeDecodeError) as e:
        raise InputError(f"{path}: cannot be read: {e}") from e
    rows: list[Row] = []
    latest = -LATEST_NS
    unreadable: list[tuple[int, str]] = []  # rows read before, where
    for number, line in enumerate(lines, 1):
        words = line.strip().split(maxsplit=1)
        if not words or words[0].startswith("#"):
            continue
        where = f"{path.name}:{number}"
        try:
            row = Row(seconds_to_ns(words[0]), words[1])
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


def _image_list(path: Path, left_out: list[Skipped]) -> list[Row]:
    rows = _rows(path, left_out)
    if not rows:
        raise InputError(f"{path}: lists no image; write a row 'seconds path' for each")
    return [replace(row, rest=row.rest.split()[0]) for row in rows]


def listed_poses(path: Path, left_out: list[Skipped]) -> Trajectory | None:
    """Rows 'seconds tx ty tz qx qy qz qw' of a file; None where there is no file or no pose."""
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
