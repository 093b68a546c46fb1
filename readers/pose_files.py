"""Which file of a plain folder holds its poses, and in which of the usual forms."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from vlmm_log.readers import tum
from vlmm_log.readers.conventions import Convention
from vlmm_log.readers.matrices import matrices_of_rows, matrix_in, matrix_trajectory
from vlmm_log.readers.numbered import Counted, Stamped, Timed, named_in, row_of, words_of
from vlmm_log.readers.poses import Link, Poses, Trajectory
from vlmm_log.types import Float64, InputError, Skipped

POSE_FOLDERS = ("pose", "poses")
TRAJECTORIES = ("traj.txt", "traj_*.txt", "traj*.log", "trajectory.txt", "CameraTrajectory.txt", "*.freiburg")
POSE_FILES = ("groundtruth.txt", "poses.txt", *TRAJECTORIES)


def found_poses(path: Path, images: Timed, convention: Convention, left_out: list[Skipped]) -> Poses | None:
    """The poses beside a folder's images; None where there are none. Raises InputError where it is not clear which."""
    found = sorted({p for pattern in POSE_FILES for p in path.glob(pattern) if p.is_file()})
    found += [path / name for name in POSE_FOLDERS if (path / name).is_dir()]
    if len(found) > 1:
        names = " and ".join(p.name for p in found[:3])
        raise InputError(f"{path}: {names} could each hold the poses; remove all but one")
    if not found:
        return None
    if found[0].is_dir():
        listed = matrix_trajectory(_one_each(path, found[0].name, images, left_out), left_out)
        return placed(listed, f"{found[0].name}/, 4x4 each", of_matrices(convention))
    rows = words_of(found[0])
    widths = [len(words) for _, words in rows]
    if set(widths) == {8}:
        listed = _tum_text(found[0], [words[0] for _, words in rows], images, left_out)
        return placed(listed, f"{found[0].name}, TUM text", convention)
    matrices = matrices_of_rows(found[0], rows, widths)
    of = row_of(images.numbers, len(matrices), found[0])
    each = ((images.taken[n], f"{found[0].name}: pose {k}", matrices[k]) for n, k in of.items())
    listed = matrix_trajectory(each, left_out)
    return placed(listed, f"{found[0].name}, matrices", of_matrices(convention))


def _one_each(path: Path, folder: str, images: Timed, left_out: list[Skipped]) -> list[tuple[int, str, Float64 | None]]:
    """Stamp, name and matrix of the files of a pose folder."""
    match named_in(path, folder, (".txt",), left_out):
        case Stamped(rows) if images.clock == "name":
            return [(row.stamp_ns, row.rest, matrix_in(path / row.rest)) for row in rows]
        case Counted(files) if images.clock != "name":
            left_out += [Skipped(0, f, "no image has its number") for n, f in files.items() if n not in images.taken]
            return [(images.taken[n], f, matrix_in(path / f)) for n, f in files.items() if n in images.taken]
    raise InputError(f"{path / folder}: poses are named by time where images are named by number, or the reverse")


def _tum_text(path: Path, stamps: list[str], images: Timed, left_out: list[Skipped]) -> Trajectory | None:
    """Rows 'seconds tx ty tz qx qy qz qw', or with frame numbers where images are numbered."""
    whole = all(re.fullmatch(r"[0-9]{1,12}(\.0*)?", text) for text in stamps)
    if all(re.fullmatch("[0-9]{13,}", text) for text in stamps):
        raise InputError(f"{path}: stamps of {len(stamps[0])} digits; write seconds")
    if images.clock == "none" and not whole:
        raise InputError(f"{path}: has times, but images are numbered; list the images' times in times.txt")
    listed = tum.listed_poses(path, left_out)
    if listed is None or images.clock == "name" or not whole:
        return listed
    numbers = [int(t) // 1_000_000_000 for t in listed.stamps_ns]
    of_image = np.array([n in images.taken for n in numbers])
    left_out += [
        Skipped(0, f"{path.name}: pose {n}", "no image has its number")
        for n, known in zip(numbers, of_image, strict=True)
        if not known
    ]
    taken = np.array([images.taken[n] for n in numbers if n in images.taken], np.int64)
    return Trajectory(taken, listed.positions[of_image], listed.quaternions[of_image]) if taken.size else None


def of_matrices(convention: Convention) -> Convention:
    """The convention of poses that were matrices: no order of quaternions was listed."""
    return replace(convention, quaternion="xyzw")


def placed(listed: Trajectory | None, source: str, convention: Convention) -> Poses | None:
    """Poses in a world whose up is not known."""
    return None if listed is None else Poses((Link(listed),), source, convention, up="")
