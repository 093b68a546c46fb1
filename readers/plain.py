"""Plain folders: rgb/ and depth/ with images, poses beside them in whichever text form; ICL-NUIM is one of them."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from vlmm_log import se3
from vlmm_log.protocols import Log
from vlmm_log.readers import conventions, intrinsics, tum
from vlmm_log.readers.conventions import Convention
from vlmm_log.readers.folder import FolderLog, associated
from vlmm_log.readers.intrinsics import Intrinsics
from vlmm_log.readers.numbered import COLOURS, DEPTHS, Counted, Stamped, Timed, named_in, row_of, timed, words_of
from vlmm_log.readers.poses import Link, Poses, Trajectory, trajectory
from vlmm_log.settings import ReadSettings
from vlmm_log.types import Float64, InputError, Skipped

UNITS_PER_METER = 1000.0  # of Record3D, ScanNet, 7-Scenes, Redwood
COLOUR_FOLDERS = ("rgb", "color", "colour", "image", "images")
POSE_FOLDERS = ("pose", "poses")
TRAJECTORIES = ("traj.txt", "traj_*.txt", "traj*.log", "trajectory.txt", "CameraTrajectory.txt", "*.freiburg")
POSE_FILES = ("groundtruth.txt", "poses.txt", *TRAJECTORIES)
POSE_FORMS = "write 8 numbers a row (TUM text), 12 (KITTI's 3x4), 16 (4x4), or four rows of 4 a frame"
ROTATION_TOLERANCE = 1e-2  # of R R^T from the identity: printed with few digits, yet a rotation
ICL_NAME = r"(living_room|office_room)_traj|traj\d_frei_png"
ICL_NOTE = "poses mirrored as ICL-NUIM's page describes its left-handed axes; not checked on its data"


class Plain:
    """The reader."""

    name = "folder"

    def recognises(self, path: Path) -> bool:
        """A folder with depth/ and one of rgb/, color/, colour/, image/, images/."""
        return (path / "depth").is_dir() and any((path / name).is_dir() for name in COLOUR_FOLDERS)

    def open(self, path: Path, s: ReadSettings) -> Log:
        """The log of a folder. Raises InputError where images, times, poses or intrinsics are missing or unclear."""
        found = re.search(r"freiburg[123]", path.resolve().name)
        return open_folder(path, s, intrinsics.FREIBURG[found[0]] if found else None, Convention())


class Icl:
    """The reader of ICL-NUIM's PNG sequences. Handa et al., ICRA 2014."""

    name = "icl"

    def recognises(self, path: Path) -> bool:
        """A folder of images called living_room_traj*, office_room_traj* or traj?_frei_png*."""
        named = re.match(ICL_NAME, path.resolve().name)
        return named is not None and (Plain().recognises(path) or tum.is_tum_folder(path))

    def open(self, path: Path, s: ReadSettings) -> Log:
        """The log of a folder, with rgb.txt and depth.txt or without. Raises InputError as Plain and Tum do."""
        known = (path, s, intrinsics.ICL, conventions.icl())
        log = tum.open_folder(*known) if tum.is_tum_folder(path) else open_folder(*known, up="+y")
        if log.poses is not None:
            log.poses = replace(log.poses, up="+y")  # as listed: before it is mirrored
            log.notes.append(ICL_NOTE)
        return log


def open_folder(
    path: Path, s: ReadSettings, known: Intrinsics | None, convention: Convention, up: str = ""
) -> FolderLog:
    """A plain folder as a log; its sensor's published intrinsics and its poses' convention and up, where known."""
    left_out: list[Skipped] = []
    own = intrinsics.from_file(path / "camera.txt") if (path / "camera.txt").is_file() else known
    names = [named_in(path, folder, kinds, left_out) for folder, kinds in ((_colour(path), COLOURS), ("depth", DEPTHS))]
    images = timed(path, names[0], names[1], left_out)
    poses = _poses(path, images, conventions.asked(s, convention), left_out)
    return log_of(path, s, own, images, poses and replace(poses, up=up), left_out)


def log_of(
    path: Path, s: ReadSettings, own: Intrinsics | None, images: Timed, poses: Poses | None, left_out: list[Skipped]
) -> FolderLog:
    """A folder's log, and notes of what was assumed. Raises InputError where no intrinsics are known.

    Where the up of the poses' world is not known (""), the axis nearest to the cameras' own is taken.
    """
    camera = intrinsics.asked(s, own, path)
    notes = [images.note]
    if not (s.depth_units_per_meter or camera.depth_scale):
        camera = replace(camera, depth_scale=UNITS_PER_METER)
        notes.append(f"depth {UNITS_PER_METER:g} per metre, assumed: run doctor")
    if poses is not None and not poses.up:
        poses = replace(poses, up=_mean_up(poses))
        notes.append(f"world's up {poses.world_up}: the axis nearest to the cameras' mean up")
    log = associated(path, s, camera, images.rgb, images.depth, poses, left_out)
    log.notes += notes
    return log


def placed(listed: Trajectory | None, source: str, convention: Convention) -> Poses | None:
    """Poses in a world whose up is not known."""
    return None if listed is None else Poses((Link(listed),), source, convention, up="")


def matrix_trajectory(listed: Iterable[tuple[int, str, Float64 | None]], left_out: list[Skipped]) -> Trajectory | None:
    """Poses of (stamp ns, what it is called, matrix (4, 4) or None where unreadable); unusable ones are told."""
    stamps: list[int] = []
    poses: list[Float64] = []
    for stamp_ns, what, matrix in sorted(listed, key=lambda item: item[0]):
        pose = "pose is not four rows of four numbers" if matrix is None else pose_of_matrix(matrix)
        if isinstance(pose, str):
            left_out.append(Skipped(stamp_ns, what, pose))
        else:
            stamps.append(stamp_ns)
            poses.append(pose)
    return trajectory(stamps, poses)


def pose_of_matrix(matrix: Float64) -> Float64 | str:
    """Position and quaternion x y z w (7,) of a pose (4, 4), its rotation the nearest one; or why it is none."""
    if not np.isfinite(matrix).all():
        return "pose is not finite"
    if not np.allclose(matrix[3], [0, 0, 0, 1], atol=1e-4):
        return "pose's last row is not 0 0 0 1"
    R = matrix[:3, :3]
    if np.abs(R @ R.T - np.eye(3)).max() > ROTATION_TOLERANCE:
        return "pose's rotation is not orthonormal"
    if np.linalg.det(R) < 0:
        return "pose's rotation is a reflection: its camera or world is left-handed"
    T = np.eye(4)
    U, _, Vt = np.linalg.svd(R)
    T[:3, :3] = U @ Vt
    return np.concatenate([matrix[:3, 3], se3.quaternion(T)])


def matrix_in(path: Path) -> Float64 | None:
    """The matrix (4, 4) of a text file; None where it is something else."""
    try:
        rows = [[float(word) for word in words] for _, words in words_of(path)]
        matrix = np.array(rows)
    except (InputError, ValueError):  # no text, no numbers, rows of several lengths
        return None
    return matrix if matrix.shape == (4, 4) else None


def _mean_up(poses: Poses) -> str:
    """Axis of the world, as it is listed, nearest to the mean up of some hundred cameras."""
    listed = replace(poses, convention=replace(poses.convention, world=None))
    stamps = listed.stamps_ns[:: 1 + listed.stamps_ns.size // 100]
    mean = np.mean([-T[:3, 1] for t in stamps if (T := listed.at(int(t), 0)) is not None], axis=0)
    k = int(np.argmax(np.abs(mean)))
    return ("+" if mean[k] > 0 else "-") + "xyz"[k]


def _colour(path: Path) -> str:
    found = [name for name in COLOUR_FOLDERS if (path / name).is_dir()]
    if len(found) > 1:
        raise InputError(f"{path}: both {found[0]}/ and {found[1]}/ could be the colour images; keep one")
    return found[0]


def _poses(path: Path, images: Timed, convention: Convention, left_out: list[Skipped]) -> Poses | None:
    found = sorted({p for pattern in POSE_FILES for p in path.glob(pattern) if p.is_file()})
    found += [path / name for name in POSE_FOLDERS if (path / name).is_dir()]
    if len(found) > 1:
        names = " and ".join(p.name for p in found[:3])
        raise InputError(f"{path}: {names} could each hold the poses; remove all but one")
    if not found:
        return None
    if found[0].is_dir():
        listed = matrix_trajectory(_one_each(path, found[0].name, images, left_out), left_out)
        return placed(listed, f"{found[0].name}/, 4x4 each", convention)
    rows = words_of(found[0])
    widths = [len(words) for _, words in rows]
    if set(widths) == {8}:
        listed = _tum_text(found[0], [words[0] for _, words in rows], images, left_out)
        return placed(listed, f"{found[0].name}, TUM text", convention)
    matrices = _matrices(found[0], rows, widths)
    of = row_of(images.numbers, len(matrices), found[0])
    each = ((images.taken[n], f"{found[0].name}: pose {k}", matrices[k]) for n, k in of.items())
    listed = matrix_trajectory(each, left_out)
    return placed(listed, f"{found[0].name}, matrices", convention)


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


def _matrices(path: Path, rows: list[tuple[int, list[str]]], widths: list[int]) -> list[Float64]:
    """Matrices (4, 4) of rows of 12 or 16 numbers, or of four rows of 4, with or without a row of 3 before each."""
    try:
        numbers = [[float(word) for word in words] for _, words in rows]
    except ValueError as e:
        raise InputError(f"{path}: {e}; {POSE_FORMS}") from e
    if set(widths) == {12}:
        return [np.array([*row, 0, 0, 0, 1]).reshape(4, 4) for row in numbers]
    if set(widths) == {16}:
        return [np.array(row).reshape(4, 4) for row in numbers]
    if widths and widths == [3, 4, 4, 4, 4] * (len(widths) // 5):  # Redwood's .log
        return [np.array(row[1:]) for row in (numbers[k : k + 5] for k in range(0, len(numbers), 5))]
    if widths and widths == [4] * len(widths) and len(widths) % 4 == 0:
        return [np.array(numbers[k : k + 4]) for k in range(0, len(numbers), 4)]
    odd = next((n for (n, _), w in zip(rows, widths, strict=True) if w not in (3, 4, 8, 12, 16)), 1)
    raise InputError(f"{path}:{odd}: poses in no known form; {POSE_FORMS}")
