"""Poses written as matrices, in text."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from vlmm_log import se3
from vlmm_log.readers.numbered import words_of
from vlmm_log.readers.poses import FARTHEST_M, TOO_FAR, Trajectory, trajectory
from vlmm_log.types import Float64, InputError, Skipped

ROTATION_TOLERANCE = 1e-2  # of R R^T from the identity: printed with few digits, yet a rotation
POSE_FORMS = "write 8 numbers a row (TUM text), 12 (KITTI's 3x4), 16 (4x4), or four rows of 4 a frame"


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
    if np.abs(matrix).max() > FARTHEST_M:
        return TOO_FAR
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


def matrices_of_rows(path: Path, rows: list[tuple[int, list[str]]], widths: list[int]) -> list[Float64]:
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
