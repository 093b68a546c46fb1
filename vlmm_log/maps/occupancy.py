"""Occupancy grids rasterised from a map on demand, for planners on wheels. numpy only.

The grid's frame is the world's turned so that z is up: x stays x; y is the world's z where "-y" is up, and
its -z where "+y" is; where "-z" is, y is its -y. Where an axis of x is up, x is its y, and y its z or -z.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vlmm_log.background import Background
from vlmm_log.elements import Element
from vlmm_log.maps.saved import SavedMap
from vlmm_log.settings import GridSettings
from vlmm_log.types import Float64, InputError, Int64, UInt8, freeze

UNKNOWN, FREE, OCCUPIED = -1, 0, 100  # nav_msgs/OccupancyGrid
NO_CLASS, NO_ELEMENT = 255, -1
R_GRID_WORLD: dict[str, Float64] = {  # by the world's axis that points up
    "+z": np.eye(3),
    "+y": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
    "-y": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
    "-z": np.diag([1.0, -1.0, -1.0]),
    "+x": np.array([[0, 1.0, 0], [0, 0, 1], [1, 0, 0]]),
    "-x": np.array([[0, 1.0, 0], [0, 0, -1], [-1, 0, 0]]),
}


@dataclass(frozen=True, eq=False)
class Grid:
    """An occupancy grid and its layers. Row 0 is the lowest y, column 0 the lowest x."""

    resolution_m: float
    origin: Float64  # (2,) m, x and y of the lower left corner of cell [0, 0]
    data: NDArray[np.int8]  # (H, W) -1 unknown, 0 free, 100 occupied
    motion_class: UInt8  # (H, W) MotionClass of the element there; 255: none
    element_id: Int64  # (H, W) -1: none
    floor_m: float  # height of the floor; NaN where there is no background to find it in
    R_grid_world: Float64  # (3, 3) turns the world into the grid's frame

    def __post_init__(self) -> None:
        freeze(self)


def occupancy(saved: SavedMap, s: GridSettings, ids: Iterable[int] | None = None) -> Grid:
    """The map from above, with the obstacles between ``low_m`` and ``high_m`` over the floor.

    Cells with background in that band and cells under an element that reaches into it are occupied, those with
    floor alone free, others unknown. ``ids`` keeps only those elements: a query's answer. Where elements overlap, the
    most mobile class is told, then the smaller id. Raises InputError where there is nothing to draw, or too much.
    """
    source, world, R = saved.run.source, saved.world, R_GRID_WORLD[saved.run.world_up]
    points = _points(world.background, R, s)
    floor = _floor(points[:, 2], world.background.voxel_m, s)
    height = points[:, 2] - floor
    points, height = (a[(height >= -s.low_m) & (height <= s.high_m)] for a in (points[:, :2], height))
    seen = (_footprint(e, R, s) for e in _chosen(saved, ids))
    footprints = [f for f in seen if not (f.top < floor + s.low_m or f.bottom > floor + s.high_m)]
    corner, shape = _frame(points, footprints, s, source)
    data = np.full(shape, UNKNOWN, np.int8)
    column, row = (np.floor(points / s.resolution_m).astype(np.int64) - corner).T
    obstacle = height >= s.low_m
    data[row[~obstacle], column[~obstacle]] = FREE
    data[row[obstacle], column[obstacle]] = OCCUPIED
    motion_class, element_id = np.full(shape, NO_CLASS, np.uint8), np.full(shape, NO_ELEMENT, np.int64)
    for f in sorted(footprints, key=lambda f: (f.element.motion_class, -f.element.id)):
        cells = _cells(f, corner, s)
        data[cells] = OCCUPIED
        motion_class[cells] = f.element.motion_class
        element_id[cells] = f.element.id
    return Grid(
        s.resolution_m, np.asarray(corner * s.resolution_m, np.float64), data, motion_class, element_id, floor, R
    )


@dataclass(frozen=True, eq=False)
class _Footprint:
    """An element from above, and how high it reaches."""

    element: Element
    center: Float64  # (2,) m
    precision: Float64  # (2, 2) 1/m^2
    reach: Float64  # (2,) m, half the sides of its bounding box
    bottom: float  # m
    top: float


def _chosen(saved: SavedMap, ids: Iterable[int] | None) -> list[Element]:
    elements = saved.world.elements
    wanted = sorted(elements if ids is None else {int(i) for i in ids})
    unknown = [i for i in wanted if i not in elements]
    if unknown:
        raise InputError(f"{saved.run.source}: its map has no element {unknown[0]}")
    return [elements[i] for i in wanted]


def _footprint(e: Element, R: Float64, s: GridSettings) -> _Footprint:
    """Its ellipse, by a cell's own variance wider: a thin thing must not slip between the cells' centres."""
    spread, axes = np.linalg.eigh(e.extent.astype(np.float64)[[[0, 1, 2], [1, 3, 4], [2, 4, 5]]])
    covariance = R @ (axes * np.maximum(spread, 0)) @ axes.T @ R.T  # a median of covariances may be none
    x, y, z = R @ e.position
    flat = covariance[:2, :2] + np.eye(2) * s.resolution_m**2 / 12
    reach = s.sigmas * np.sqrt(np.diag(flat))
    rise = s.sigmas * float(np.sqrt(max(covariance[2, 2], 0.0)))
    return _Footprint(e, np.array([x, y]), np.linalg.inv(flat), reach, float(z) - rise, float(z) + rise)


def _points(b: Background, R: Float64, s: GridSettings) -> Float64:
    """(n, 3) m, grid frame: voxel centres; where cells are finer than voxels, as many of each voxel as fill them."""
    if not s.resolution_m > 0:
        raise InputError(f"a grid of {s.resolution_m} m cells: give a positive size")
    cells = b.cells[b.sums[:, 0] >= s.min_points]
    centers = (cells + 0.5) * b.voxel_m @ R.T
    parts = int(min(np.ceil(b.voxel_m / s.resolution_m - 1e-9), s.max_cells))
    if len(cells) * parts**2 > s.max_cells:
        raise InputError(f"a grid of {s.resolution_m} m cells from voxels of {b.voxel_m} m; take larger cells")
    steps = ((np.arange(parts) + 0.5) / parts - 0.5) * b.voxel_m
    x, y = np.meshgrid(steps, steps)
    offsets = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    return np.asarray((centers[:, None] + offsets).reshape(-1, 3), np.float64)


def _floor(heights: Float64, voxel_m: float, s: GridSettings) -> float:
    """Height of the floor, m: the mean about the top of the lowest dense layer. NaN without a background."""
    if s.floor != "auto":
        try:
            height = float(s.floor)
        except ValueError:
            height = float("nan")
        if not np.isfinite(height):
            raise InputError(f"floor {s.floor[:60]!r}: give a height in m, or auto")
        return height
    if not heights.size:
        return float("nan")
    layers, row, counts = np.unique(np.floor(heights / voxel_m), return_inverse=True, return_counts=True)
    i = int(np.argmax(counts >= s.floor_share * counts.max()))
    while i + 1 < layers.size and layers[i + 1] == layers[i] + 1 and counts[i + 1] > counts[i]:
        i += 1
    return float(heights[np.abs(layers - layers[i])[row] <= 1].mean())


def _frame(points: Float64, footprints: Sequence[_Footprint], s: GridSettings, source: str) -> tuple[Int64, list[int]]:
    """Cell coordinates (x, y) of the lower left cell, and the shape (H, W) that holds everything."""
    centers = np.array([f.center for f in footprints]).reshape(-1, 2)
    reach = np.array([f.reach for f in footprints]).reshape(-1, 2)
    corners = np.concatenate([points, centers - reach, centers + reach])
    if not corners.size:
        raise InputError(f"{source}: its map holds neither background nor element to draw a grid of")
    low, high = (np.floor(limit / s.resolution_m) for limit in (corners.min(axis=0), corners.max(axis=0)))
    width, height = high - low + 1
    if width * height > s.max_cells or np.abs([low, high]).max() > 2**52:
        raise InputError(
            f"{source}: a grid of {width:.0f} x {height:.0f} cells of {s.resolution_m} m is too large; "
            "take larger cells, or leave out stray voxels with a higher min_points"
        )
    return low.astype(np.int64), [int(height), int(width)]


def _cells(f: _Footprint, corner: Int64, s: GridSettings) -> tuple[Int64, Int64]:
    """Rows and columns of the cells whose centres lie in the ellipse, and of the one it is centred in."""
    low, own, high = (np.floor(p / s.resolution_m) for p in (f.center - f.reach, f.center, f.center + f.reach))
    x, y = (np.arange(a, b + 1) for a, b in zip(low, high, strict=True))
    offset = np.stack(np.meshgrid(x, y), axis=-1)
    away = (offset + 0.5) * s.resolution_m - f.center
    inside = np.einsum("vui,ij,vuj->vu", away, f.precision, away) <= s.sigmas**2
    cells = np.concatenate([offset[inside], own[None]]).astype(np.int64) - corner
    return cells[:, 1], cells[:, 0]
