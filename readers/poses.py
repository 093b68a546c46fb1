"""Where the camera stood: listed poses, chains of transforms, and the conventions they are listed in.

Poses are interpolated and never extrapolated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vlmm_log import se3
from vlmm_log.readers.conventions import PLAIN, Convention
from vlmm_log.types import Float64

FARTHEST_M = 1e9  # from the world's origin: single precision still squares it
NORM_TOLERANCE = 0.01  # a quaternion printed with four decimals is within 1e-4 of unit length
ELSEWHERE = "not of the camera's frames"  # how reasons begin that cost the camera no pose
TOO_FAR = f"pose holds more than {FARTHEST_M:g} m"


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses in time order, as they are listed."""

    stamps_ns: NDArray[np.int64]  # (N,) ascending
    positions: Float64  # (N, 3) m
    quaternions: Float64  # (N, 4) unit, x y z w

    def at(self, stamp_ns: int, gap_ns: int, convention: Convention = PLAIN) -> Float64 | None:
        """The pose (4, 4) at a time: linear in position, slerp in rotation.

        None outside the trajectory, and between two poses that are more than gap_ns apart.
        """
        after = int(np.searchsorted(self.stamps_ns, stamp_ns))
        if after < self.stamps_ns.size and self.stamps_ns[after] == stamp_ns:
            return convention.listed(self.positions[after], self.quaternions[after])
        if after == 0 or after == self.stamps_ns.size:
            return None
        t0, t1 = int(self.stamps_ns[after - 1]), int(self.stamps_ns[after])
        if t1 - t0 > gap_ns:
            return None
        s = (stamp_ns - t0) / (t1 - t0)
        position = (1 - s) * self.positions[after - 1] + s * self.positions[after]
        return convention.listed(position, se3.slerp(self.quaternions[after - 1], self.quaternions[after], s))


@dataclass(frozen=True, eq=False)
class Link:
    """One transform of a chain: still, or moving along a trajectory."""

    motion: Trajectory | Float64  # (4, 4) where it is still
    inverse: bool = False  # the chain is walked against it

    def at(self, stamp_ns: int, gap_ns: int, convention: Convention) -> Float64 | None:
        """The transform (4, 4) at a time; None where it is not known."""
        T = self.motion
        if isinstance(T, Trajectory):
            T = T.at(stamp_ns, gap_ns, convention)  # type: ignore[assignment]
        return se3.inverse(T) if self.inverse and T is not None else T  # type: ignore[arg-type,return-value]


@dataclass(frozen=True, eq=False)
class Poses:
    """``T_world_cam`` over time: a chain of transforms, read by a convention."""

    links: tuple[Link, ...]
    source: str  # "groundtruth.txt", "/tf: map -> odom -> camera_link -> camera_rgb_optical_frame"
    convention: Convention = PLAIN
    up: str = "+z"  # axis of the world that points up

    def at(self, stamp_ns: int, gap_ns: int) -> Float64 | None:
        """``T_world_cam`` (4, 4) at a time; None where a link is not known."""
        listed: Float64 | None = None
        for link in self.links:
            T = link.at(stamp_ns - self.convention.offset_ns, gap_ns, self.convention)
            if T is None:
                return None
            listed = T if listed is None else listed @ T
        return None if listed is None else self.convention.camera(listed)

    @property
    def moving(self) -> tuple[Trajectory, ...]:
        """The chain's trajectories."""
        return tuple(link.motion for link in self.links if isinstance(link.motion, Trajectory))

    @property
    def stamps_ns(self) -> NDArray[np.int64]:
        """(N,) of its most finely sampled trajectory, read by the convention; empty if it never moves."""
        longest = max((t.stamps_ns for t in self.moving), key=lambda s: s.size, default=np.empty(0, np.int64))
        return longest + self.convention.offset_ns

    @property
    def world_up(self) -> str:
        """Axis of the world that points up, the convention's turn of the world included."""
        return self.convention.turned(self.up)


def usable_pose(values: Float64) -> str | None:
    """Why a row of position and quaternion (7,) cannot be used; None if it can."""
    if not np.isfinite(values).all():
        return "pose is not finite"
    if np.abs(values).max() > FARTHEST_M:
        return TOO_FAR
    if abs(float(np.linalg.norm(values[3:])) - 1.0) > NORM_TOLERANCE:
        return "pose's quaternion is not of unit length"
    return None


def trajectory(stamps_ns: Sequence[int], values: Sequence[Float64]) -> Trajectory | None:
    """Poses (x y z qx qy qz qw) in ascending time as a trajectory; None of none."""
    if not len(stamps_ns):
        return None
    table = np.array(values)
    return Trajectory(np.array(stamps_ns, np.int64), table[:, :3], unit(table[:, 3:]))


def unit(quaternions: Float64) -> Float64:
    """Quaternions (N, 4) scaled to unit length. Those that are so to the last bits stay: read once, they read back."""
    norms = np.linalg.norm(quaternions, axis=1, keepdims=True)
    return np.asarray(np.where(np.abs(norms - 1) < 1e-15, quaternions, quaternions / norms))
