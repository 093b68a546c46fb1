"""Where elements lie to each other: nearest targets, and sides as a camera sees them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vlmm_log.types import Float32, Float64, Int64

FEW = 32  # targets up to which a pass over all points each beats a tree

UP = {
    "+x": (1.0, 0.0, 0.0),
    "+y": (0.0, 1.0, 0.0),
    "+z": (0.0, 0.0, 1.0),
    "-x": (-1.0, 0.0, 0.0),
    "-y": (0.0, -1.0, 0.0),
    "-z": (0.0, 0.0, -1.0),
}


def placed(points: Float32) -> NDArray[np.bool_]:
    """(n,) whether a point's coordinates are finite."""
    return np.asarray(np.isfinite(points).all(axis=1), np.bool_)


def nearest(points: Float32, targets: Int64, rows: Int64, reach: float) -> tuple[Float32, Int64]:
    """Distance (n,) m from points to the nearest other one of the target rows, and that row; inf and -1: none.

    Only the given rows are asked, and only targets within reach (m) are found. Points and targets that are not finite
    have none and are none.
    """
    finite = placed(points)
    targets, rows = targets[finite[targets]], rows[finite[rows]]
    best, which = np.full(len(points), np.inf, np.float32), np.full(len(points), -1, np.int64)
    if targets.size and rows.size:
        search = _by_passes if targets.size <= FEW or rows.size <= FEW else _by_tree
        best[rows], which[rows] = search(points, targets, rows, reach)
    return best, which


def _by_passes(points: Float32, targets: Int64, rows: Int64, reach: float) -> tuple[Float32, Int64]:
    x, y, z = (np.ascontiguousarray(points[rows, k]) for k in range(3))
    best, which = np.full(rows.size, np.inf, np.float32), np.full(rows.size, -1, np.int64)
    for row in targets:
        squared = (x - points[row, 0]) ** 2 + (y - points[row, 1]) ** 2 + (z - points[row, 2]) ** 2
        squared[rows == row] = np.inf  # nothing is near itself
        closer = squared < best
        best[closer], which[closer] = squared[closer], row
    distance = np.sqrt(best)
    return np.where(distance <= reach, distance, np.float32(np.inf)), np.where(distance <= reach, which, -1)


def _by_tree(points: Float32, targets: Int64, rows: Int64, reach: float) -> tuple[Float32, Int64]:
    from scipy.spatial import cKDTree

    tree = cKDTree(points[targets])
    bound = np.nextafter(np.float64(reach), np.inf)  # the tree leaves the bound itself out
    distance, place = tree.query(points[rows], k=1, distance_upper_bound=bound)
    is_target = np.zeros(len(points), bool)
    is_target[targets] = True
    own = np.flatnonzero(is_target[rows])  # a target finds itself first
    if own.size:
        pairs, places = tree.query(points[rows[own]], k=2, distance_upper_bound=bound)
        second = (np.append(targets, -1)[places[:, 0]] == rows[own]).astype(int)
        distance[own], place[own] = (np.take_along_axis(a, second[:, None], 1)[:, 0] for a in (pairs, places))
    return distance.astype(np.float32), np.append(targets, -1)[place]


def direction(relation: str, T_world_cam: Float64 | None, up: str, of_camera: bool) -> Float64 | None:
    """(3,) unit vector of a side in the world; None where it needs a camera that is not known.

    In front of a thing is towards the camera; in front of the camera is where it looks.
    """
    if relation in ("above", "below"):
        return np.array(UP[up]) * (1.0 if relation == "above" else -1.0)
    if T_world_cam is None:
        return None
    right, forward = T_world_cam[:3, 0], T_world_cam[:3, 2]
    ahead = forward if of_camera else -forward
    return np.asarray({"left": -right, "right": right, "front": ahead, "behind": -ahead}[relation], np.float64)


def half_width(extents: Float32, way: Float64) -> Float32:
    """(n,) m, from the middle to the edge along a direction of boxes with these covariances; 0 where unknown.

    A thing is on my right when all of it is.
    """
    x, y, z = way
    weights = np.array([x * x, 2 * x * y, 2 * x * z, y * y, 2 * y * z, z * z], np.float32)
    return np.asarray(np.sqrt(np.maximum(np.nan_to_num(3 * extents @ weights), 0)), np.float32)


def on_side(points: Float32, sizes: Float32, targets: Int64, rows: Int64, way: Float64) -> Int64:
    """(n,) row of a target on whose side each of the given rows lies, -1: of none.

    A point is on the side of a target when it lies that way by more than it lies across, half the target's size off.
    """
    along = points @ way.astype(np.float32)
    across = points - along[:, None] * way.astype(np.float32)
    which = np.full(len(points), -1, np.int64)
    usable, reach = targets[np.isfinite(along[targets])], np.nan_to_num(sizes) / 2
    open_rows = rows[np.isfinite(along[rows])]
    for row in usable[np.argsort(along[usable], kind="stable")]:  # those that decide most rows come first
        if not open_rows.size or along[open_rows].max() <= along[row]:
            break
        ahead = along[open_rows] - along[row]
        aside = np.linalg.norm(across[open_rows] - across[row], axis=1) - reach[row]
        holds = (ahead > 0) & (ahead >= aside)
        which[open_rows[holds]] = row
        open_rows = open_rows[~holds]
    return which
