"""The persistent map: exact observation lists by element, so that updates commute and maps merge (paper, Eq. 12)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import chain
from typing import cast

import numpy as np

from vlmm_log.background import KEY_LIMIT, Background, empty_background, grown, summed
from vlmm_log.elements import OBSERVATION, Evidence, Observations, Tracked, WorldMap
from vlmm_log.settings import MapSettings
from vlmm_log.types import Float64, FramePair, Motion, Odometry, UInt8, freeze

CLOUD_STRIDE = 8  # every n-th row and column of a frame feeds the background


def empty_map(s: MapSettings) -> WorldMap:
    """Nothing seen yet."""
    return WorldMap({}, {}, (empty_background(s.voxel_m),))


def update(world: WorldMap, tracked: Tracked, background: Background) -> WorldMap:
    """The map with a pair's observations. ``touched`` names the elements that still need ``fuse``."""
    sightings = tracked.sightings
    evidence = dict(world.evidence)
    touched = []
    for k in np.flatnonzero(sightings.observed).tolist():
        element = int(tracked.ids[k])
        own = Evidence(
            element,
            {sightings.segments.names[k]: round(1000 * float(sightings.segments.scores[k]))},
            sightings.rows[k : k + 1].copy(),  # a view would keep all instances of the pair
            tracked.features[k].copy(),
            int(sightings.rows["pixels"][k]),
            int(sightings.rows["index"][k]),
        )
        evidence[element] = merge_evidence(evidence[element], own) if element in evidence else own
        touched.append(element)
    return WorldMap(evidence, world.elements, grown(world.clouds, background), tuple(sorted(touched)))


def merge(a: WorldMap, b: WorldMap) -> WorldMap:
    """The map of both's observations. Needs ``fuse`` for what both hold.

    Ids must mean the same in both: halves of one run, or identities of the source. Raises ValueError for different
    voxels.
    """
    evidence = dict(a.evidence)
    for element, theirs in b.evidence.items():
        evidence[element] = merge_evidence(evidence[element], theirs) if element in evidence else theirs
    both = tuple(sorted(a.evidence.keys() & b.evidence.keys()))
    elements = dict(a.elements) | {i: e for i, e in b.elements.items() if i not in a.evidence}
    return WorldMap(evidence, elements, grown(a.clouds, b.background), both)


def merge_evidence(a: Evidence, b: Evidence) -> Evidence:
    """All that was seen of one element, in time order."""
    largest = min(a, b, key=lambda e: (-e.feature_pixels, e.feature_index))
    return Evidence(
        a.id,
        _sum(a.votes, b.votes),
        _in_time_order(a.observations, b.observations),
        largest.feature,
        largest.feature_pixels,
        largest.feature_index,
    )


def _sum(a: Mapping[str, int], b: Mapping[str, int]) -> dict[str, int]:
    total: dict[str, int] = {}
    for name, votes in sorted(chain(a.items(), b.items())):
        total[name] = total.get(name, 0) + votes
    return total


def _in_time_order(a: Observations, b: Observations) -> Observations:
    """Both lists as one. One row after the last is written into room kept behind the list: no copy of all before."""
    if a.size and b.size == 1 and _key(b[0]) > _key(a[-1]):
        return _appended(a, b)
    joined = np.concatenate([a, b])
    order = np.lexsort((joined["second_ns"], joined["index"], joined["first_ns"]))
    return cast("Observations", joined[order])


def _key(row: np.void) -> tuple[int, int, int]:
    return int(row["first_ns"]), int(row["index"]), int(row["second_ns"])


def _appended(rows: Observations, row: Observations) -> Observations:
    room = _room_behind(rows)
    if room is None:
        room = np.zeros(max(2 * rows.size, 16), OBSERVATION)
        room["second_ns"] = FREE
        room[: rows.size] = rows
    room[rows.size] = row[0]
    return room[: rows.size + 1]


def _room_behind(rows: Observations) -> Observations | None:
    """The array that a list is the front of, if its next row is free: rows are taken from the front, so no other
    view of this size ends there."""
    room = rows.base
    if not isinstance(room, np.ndarray) or room.dtype != OBSERVATION or room.size <= rows.size:
        return None
    return room if room.flags.writeable and room["second_ns"][rows.size] == FREE else None


FREE = np.iinfo(np.int64).min  # second_ns of a row not taken: another map may have grown from the same list


@dataclass(frozen=True, eq=False)
class Still:
    """Points that are consistent with standing still."""

    points: Float64  # (3, N) m, in the first camera
    colors: UInt8  # (N, 3)

    def __post_init__(self) -> None:
        freeze(self)


def still_points(pair: FramePair, motion: Motion) -> Still:
    """The first frame's still points, of every CLOUD_STRIDE-th row and column."""
    first, step = pair.first, CLOUD_STRIDE
    still = motion.d_m[::step, ::step] <= motion.tau_px  # False where NaN
    v, u = np.nonzero(still)
    v, u = v * step, u * step
    z = first.depth[v, u].astype(np.float64)
    rays = np.linalg.solve(first.K, np.stack([u, v, np.ones_like(u)]).astype(np.float64))
    return Still(rays * z, first.rgb[v, u])


def background(still: Still, odometry: Odometry, voxel_m: float) -> Background:
    """Voxels of still points, in the world."""
    T = odometry.T_world_first
    cells = np.floor((T[:3, :3] @ still.points + T[:3, 3:]).T / voxel_m)
    inside = (np.abs(cells) < KEY_LIMIT).all(axis=1)
    colors = still.colors.astype(np.int64)
    sums = np.concatenate([np.ones((len(colors), 1), np.int64), colors], axis=1)
    return summed(cells[inside].astype(np.int64), sums[inside], voxel_m)
