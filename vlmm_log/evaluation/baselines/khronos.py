"""What stands where it was seen to be free."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vlmm_log.elements import Elements
from vlmm_log.evaluation.baselines.means import ElementMeans
from vlmm_log.evaluation.scores import Scores
from vlmm_log.evaluation.trial import Seen
from vlmm_log.types import Float32, Float64, Int64

VOXEL_M = 0.08
CELLS = 160  # a side: 12.8 m about the first camera
MARGIN_M = 0.2  # before a surface nothing is called free: depth noise
BURN_IN = 3  # frames in which a voxel must have been seen free
REACH_M = 6.0


class KhronosStyle:
    """Free space is remembered; a surface point inside it moves."""

    name = "Khronos-style"
    reference = (
        "Schmid et al., RSS 2024 (motion detection by free space, as Dynablox, RA-L 2023): without clustering and the "
        "rest of the spatio-temporal map"
    )
    threshold = float(BURN_IN) - 0.5

    def __init__(self) -> None:
        self._free = np.zeros(CELLS**3, np.uint16)
        self._origin: Float64 | None = None
        self._means = ElementMeans()

    def see(self, seen: Seen) -> Float32:
        """In how many earlier frames a pixel's place was free; 0 for a place that was not."""
        T = seen.odometry.T_world_first
        if self._origin is None:
            self._origin = T[:3, 3] - VOXEL_M * CELLS / 2
        depth, K = seen.pair.first.depth, seen.pair.first.K
        at, inside = self._cells(_points(depth, K, T, 1))
        count = np.where(inside, self._free[at], 0)
        score = np.where(np.isfinite(depth), count, np.nan).astype(np.float32)
        self._carve(depth, K, T)
        self._means.add(seen, score)
        return score

    def answers(self, elements: Elements) -> tuple[Scores, ...]:
        """It knows what moved; what did not is still, and what could move it cannot tell from that."""
        moving = self._means.of(elements)
        return (Scores(moving, moving, -moving),)

    def _carve(self, depth: Float32, K: Float64, T: Float64) -> None:
        """Count every voxel that a ray of this frame passed through as free, once."""
        stride = max(int(VOXEL_M * K[0, 0] / REACH_M * 0.9), 1)  # px between rays: no voxel within reach is missed
        ends = _points(depth, K, T, stride).reshape(-1, 3)
        z = depth[::stride, ::stride].ravel()
        seen = np.isfinite(z)
        ends, z = ends[seen], np.minimum(z[seen], REACH_M)
        steps = np.arange(0.3, REACH_M, VOXEL_M, dtype=np.float32)
        along = steps[None, :] / depth[::stride, ::stride].ravel()[seen][:, None]
        free = steps[None, :] < (z - MARGIN_M)[:, None]
        row, column = np.nonzero(free)
        eye = T[:3, 3].astype(np.float32)
        at, inside = self._cells(eye + along[row, column][:, None] * (ends[row] - eye))
        passed = np.unique(at[inside])
        occupied, there = self._cells(ends)
        passed = np.setdiff1d(passed, occupied[there], assume_unique=False)
        self._free[passed] = np.minimum(self._free[passed], 65534) + 1

    def _cells(self, points: Float32) -> tuple[Int64, NDArray[np.bool_]]:
        """Voxels of points (..., 3), and whether they lie in the grid."""
        assert self._origin is not None
        with np.errstate(invalid="ignore"):
            scaled = np.floor((points - self._origin.astype(np.float32)) / VOXEL_M)
        cell = np.nan_to_num(scaled, nan=-1).astype(np.int64)
        inside = ((cell >= 0) & (cell < CELLS)).all(axis=-1)
        flat = (cell[..., 0] * CELLS + cell[..., 1]) * CELLS + cell[..., 2]
        return np.where(inside, flat, 0), inside


def _points(depth: Float32, K: Float64, T: Float64, stride: int) -> Float32:
    """World points (h, w, 3) m of every n-th pixel; NaN where unseen."""
    z = depth[::stride, ::stride]
    v, u = np.mgrid[0 : depth.shape[0] : stride, 0 : depth.shape[1] : stride].astype(np.float32)
    rays = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones_like(u)], axis=-1)
    return np.asarray((rays * z[..., None]) @ T[:3, :3].T + T[:3, 3], np.float32)
