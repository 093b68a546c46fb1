"""What a map file holds. numpy only."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vlmm_log.background import Background
from vlmm_log.elements import Element, Evidence, WorldMap
from vlmm_log.types import Float64, InputError, Run, RunEnd, freeze

FORMAT = "vlmm-log map"
VERSION = 1
INT32_END, INT64_END = 2**31, 2**63
LARGEST = float(np.finfo(np.float32).max)  # of a figure: columns hold them as float32
MOST_POINTS = 2**48  # in a voxel; its sums of colours stay far inside int64
WORLD_UP = ("+z", "-z", "+y", "-y", "+x", "-x")
FUSED = ("position", "extent", "o", "kappa", "rho", "confidence", "p_stat", "score", "speed")


@dataclass(frozen=True, eq=False)
class SavedMap:
    """A map, and where it came from."""

    world: WorldMap  # all but ``touched`` is kept in a file
    run: Run
    end: RunEnd
    origin_ns: int  # stamp of the first keyframe: what "between 10 s and 12 s" counts from
    T_world_cam: Float64 | None  # (4, 4) of the last keyframe; None where the log has no pose for it

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def pending(self) -> list[Evidence]:
        """What is too small to be an element yet, by id."""
        return [self.world.evidence[i] for i in sorted(self.world.evidence) if i not in self.world.elements]

    @property
    def feature_width(self) -> int:
        """D of the semantic features; 0 where there is none."""
        return next((e.feature.size for e in self.world.evidence.values()), 0)


def checked(saved: SavedMap, path: Path) -> SavedMap:
    """The same map. Raises InputError that names the first field no map may hold."""
    fault = next(_faults(saved), None)
    if fault is not None:
        raise InputError(f"{path}: {fault}")
    return saved


def _faults(saved: SavedMap) -> Iterator[str]:
    world, T = saved.world, saved.T_world_cam
    if saved.run.world_up not in WORLD_UP:
        yield f"run.world_up: is none of {', '.join(WORLD_UP)}"
    if min(saved.end.frames, saved.end.pairs) < 0:
        yield "end: frames or pairs is negative"
    if T is not None and (T.shape != (4, 4) or not np.isfinite(T).all()):
        yield "T_world_cam: is not 4 x 4 finite numbers"
    for key, evidence in world.evidence.items():
        yield from (f"element {key}: {fault}" for fault in _evidence_faults(key, evidence, saved.feature_width))
    for key, element in world.elements.items():
        if world.evidence.get(key) is not element.evidence:
            yield f"element {key}: its evidence is not the map's"
        yield from (f"element {key}: {fault}" for fault in _element_faults(element))
    yield from (f"background.{fault}" for fault in _background_faults(world.background))


def _evidence_faults(key: int, e: Evidence, feature_width: int) -> Iterator[str]:
    if key != e.id or not 0 <= e.id < INT64_END:
        yield "id: is negative, too large, or not the map's key"
    if not e.votes or not all(0 <= n < INT64_END for n in e.votes.values()):
        yield "votes: there is none, or one is negative or too large"
    if not all(0 <= n < INT32_END for n in (e.feature_pixels, e.feature_index)):
        yield "feature_pixels, feature_index: one is negative or too large"
    if e.feature.shape != (feature_width,):
        yield f"semantic_feat: has {e.feature.size} numbers, another element's {feature_width}"
    if not np.isfinite(e.feature).all():
        yield "semantic_feat: not all numbers are finite"
    for name in e.observations.dtype.names or ():
        if not _finite(e.observations[name]):
            yield f"observations.{name}: not all numbers are finite"
    first_ns = e.observations["first_ns"]
    if (first_ns[1:] < first_ns[:-1]).any():
        yield "observations.first_ns: is not in time order"


def _element_faults(e: Element) -> Iterator[str]:
    if not e.evidence.observations.size:
        yield "observations: there is none"
    for name in FUSED:
        if not np.all(np.abs(getattr(e, name)) <= LARGEST):
            yield f"{name}: is not finite, or too large"
    if e.p_moving == e.p_moving and not 0 <= e.p_moving <= 1:
        yield "p_moving: is no probability"


def _background_faults(b: Background) -> Iterator[str]:
    if not 0 < b.voxel_m <= 1e12:
        yield "voxel_m: is not a positive number"
    if len(b.cells) != len(b.sums):
        yield "cells and sums: differ in length"
        return
    steps = np.diff(b.cells.astype(np.int64), axis=0)
    x, y, z = steps.T
    if not ((x > 0) | (x == 0) & ((y > 0) | (y == 0) & (z > 0))).all():
        yield "cells: are not in lexicographic order, each once"
    count, colors = b.sums[:, :1], b.sums[:, 1:]
    if ((count < 1) | (count > MOST_POINTS)).any() or ((colors < 0) | (colors > 255 * count)).any():
        yield "sums: no colour has these sums"


def _finite(values: NDArray[np.generic]) -> bool:
    return values.dtype.kind != "f" or bool(np.isfinite(values).all())
