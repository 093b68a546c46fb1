"""The still background as coloured voxels: exact integer sums, so that maps merge exactly. numpy only."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vlmm_log.types import Float32, Int32, Int64, UInt8, freeze

KEY_LIMIT = 1 << 20  # voxels to either side of the origin whose three coordinates fit one integer


@dataclass(frozen=True, eq=False)
class Background:
    """Coloured voxels of what stood still."""

    voxel_m: float
    cells: Int32  # (n, 3) voxel coordinates, floor(world / voxel_m), in lexicographic order, each once
    sums: Int64  # (n, 4) number of points, and sums of red, green, blue

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def points(self) -> Float32:
        """(n, 3) m, voxel centres."""
        return np.asarray((self.cells + 0.5) * self.voxel_m, np.float32)

    @property
    def colors(self) -> UInt8:
        """(n, 3) mean colours."""
        return np.asarray(self.sums[:, 1:] // np.maximum(self.sums[:, :1], 1), np.uint8)


def empty_background(voxel_m: float) -> Background:
    """No voxel yet."""
    return Background(voxel_m, np.zeros((0, 3), np.int32), np.zeros((0, 4), np.int64))


def summed(cells: Int64, sums: Int64, voxel_m: float) -> Background:
    """Points or voxels (n, 3) with their sums (n, 4) as a background: each voxel once."""
    if (np.abs(cells) < KEY_LIMIT).all():
        shifted = cells + KEY_LIMIT
        keys = (shifted[:, 0] << 42) | (shifted[:, 1] << 21) | shifted[:, 2]
        order = np.argsort(keys, kind="stable")
        starts = np.flatnonzero(np.diff(keys[order], prepend=-1))
    else:
        order = np.lexsort(cells.T[::-1])
        starts = np.flatnonzero(np.concatenate([[True], (np.diff(cells[order], axis=0) != 0).any(axis=1)]))
    total = np.add.reduceat(sums[order], starts, axis=0) if starts.size else sums[:0]
    return Background(voxel_m, cells[order][starts].astype(np.int32), total)


def merged(clouds: Sequence[Background]) -> Background:
    """The sums of all, voxel by voxel. Raises ValueError for different voxels."""
    sizes = {cloud.voxel_m for cloud in clouds}
    if len(sizes) != 1:
        raise ValueError(f"voxels of {' m and '.join(str(size) for size in sorted(sizes))} m do not merge")
    if len(clouds) == 1:
        return clouds[0]
    cells = np.concatenate([cloud.cells for cloud in clouds]).astype(np.int64)
    return summed(cells, np.concatenate([cloud.sums for cloud in clouds]), clouds[0].voxel_m)


def grown(clouds: tuple[Background, ...], cloud: Background) -> tuple[Background, ...]:
    """The clouds and one more, each at least twice as large as the next: a point is moved but log n times."""
    levels = [*clouds, cloud]
    while len(levels) > 1 and len(levels[-2].cells) < 2 * len(levels[-1].cells):
        levels[-2:] = [merged(levels[-2:])]
    return tuple(levels)
