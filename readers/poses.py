"""Trajectories: poses over time, interpolated and never extrapolated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vlmm_log import se3
from vlmm_log.types import Float64

NORM_TOLERANCE = 0.01  # a quaternion printed with four decimals is within 1e-4 of unit length


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Camera-to-world poses in time order."""

    stamps_ns: NDArray[np.int64]  # (N,) ascending
    positions: Float64  # (N, 3) m
    quaternions: Float64  # (N, 4) unit, x y z w

    def at(self, stamp_ns: int, gap_ns: int) -> Float64 | None:
        """``T_world_cam`` (4, 4) at a time: linear in position, slerp in rotation.

        None outside the trajectory, and between two poses that are more than gap_ns apart.
        """
        after = int(np.searchsorted(self.stamps_ns, stamp_ns))
        if after < self.stamps_ns.size and self.stamps_ns[after] == stamp_ns:
            return se3.from_quaternion(self.positions[after], self.quaternions[after])
        if after == 0 or after == self.stamps_ns.size:
            return None
        t0, t1 = int(self.stamps_ns[after - 1]), int(self.stamps_ns[after])
        if t1 - t0 > gap_ns:
            return None
        s = (stamp_ns - t0) / (t1 - t0)
        position = (1 - s) * self.positions[after - 1] + s * self.positions[after]
        return se3.from_quaternion(position, se3.slerp(self.quaternions[after - 1], self.quaternions[after], s))


def usable_pose(values: Float64) -> str | None:
    """Why a row of position and quaternion (7,) cannot be used; None if it can."""
    if not np.isfinite(values).all():
        return "pose is not finite"
    if abs(float(np.linalg.norm(values[3:])) - 1.0) > NORM_TOLERANCE:
        return "pose's quaternion is not of unit length"
    return None


def trajectory(stamps_ns: list[int], values: list[Float64]) -> Trajectory | None:
    """Poses (x y z qx qy qz qw) in ascending time as a trajectory; None of none."""
    if not stamps_ns:
        return None
    table = np.array(values)
    quaternions = table[:, 3:] / np.linalg.norm(table[:, 3:], axis=1, keepdims=True)
    return Trajectory(np.array(stamps_ns, np.int64), table[:, :3], quaternions)
