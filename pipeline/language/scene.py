"""What a filter tree is asked of: the map's columns, the fields made of them, and from where and when."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from vlmm_log.elements import Elements, MotionClass
from vlmm_log.pipeline.language.space import UP
from vlmm_log.settings import MapSettings
from vlmm_log.types import Float32, Float64, Int64

Column = NDArray[np.float32] | NDArray[np.float64] | NDArray[np.int32]
ALWAYS = np.iinfo(np.int64)


@dataclass(frozen=True, eq=False)
class Scene:
    """What a tree is asked of."""

    elements: Elements
    similarity: Mapping[str, Float32]  # text -> (n,) cosine; NaN where there is no feature
    theta_s: float
    near_m: float
    fusion: MapSettings
    T_world_cam: Float64 | None
    up: str
    origin_ns: int

    @cached_property
    def end_ns(self) -> int:
        """The map's last stamp."""
        return int(self.elements.last_ns.max(initial=self.origin_ns))

    @cached_property
    def interval_order(self) -> tuple[Int64, Int64]:
        """Motion intervals sorted by the row they belong to, and those rows."""
        order = np.argsort(self.elements.interval_rows, kind="stable")
        return order, self.elements.interval_rows[order].astype(np.int64)

    @cached_property
    def has_moved(self) -> NDArray[np.bool_]:
        """(n,) whether an element ever moved: has a motion interval or the class MOVING."""
        found: NDArray[np.bool_] = self.elements.motion_class == MotionClass.MOVING
        found[self.elements.interval_rows] = True
        return found

    def name(self, row: int) -> str:
        """What to call an element in a reason."""
        return f"{self.elements.labels[row] or 'element'} {self.elements.ids[row]}"


def values(scene: Scene, field: str) -> Column:
    """A field of query_tree.FIELDS (n,); NaN where unknown."""
    e = scene.elements
    match field:
        case "speed":  # what stood still has none, whatever its noise
            return np.asarray(np.where(scene.has_moved, e.speed, 0 * e.speed), np.float32)
        case "motions":
            return np.bincount(e.interval_rows, minlength=len(e)).astype(np.int32)
        case "moved_s":
            return np.asarray(
                np.bincount(e.interval_rows, 1e-9 * np.diff(e.intervals, axis=1)[:, 0], len(e)), np.float64
            )
        case "first_s":
            return np.asarray(1e-9 * (e.first_ns - scene.origin_ns), np.float64)
        case "last_s":
            return np.asarray(1e-9 * (e.last_ns - scene.origin_ns), np.float64)
        case "size_m":
            return np.asarray(np.sqrt(np.maximum(12 * e.extents[:, [0, 3, 5]].sum(axis=1), 0)), np.float32)
        case "height_m":
            return np.asarray(e.positions @ np.array(UP[scene.up], np.float32))
        case "distance_m":
            if scene.T_world_cam is None:
                return np.full(len(e), np.nan, np.float32)
            return np.asarray(np.linalg.norm(e.positions - scene.T_world_cam[:3, 3].astype(np.float32), axis=1))
        case _:
            column: Column = getattr(e, field)
            return column


def window(scene: Scene, t0_s: float | None, t1_s: float | None) -> tuple[int, int]:
    """Stamps of a time span, both ends within it."""

    def stamp(t: float) -> int:
        return (scene.origin_ns if t >= 0 else scene.end_ns) + round(1e9 * max(min(t, 9e8), -9e8))

    return ALWAYS.min if t0_s is None else stamp(t0_s), ALWAYS.max if t1_s is None else stamp(t1_s)
