"""Which element each instance is: masks carried by the flow, 3-D distance, label and feature; one assignment a pair.

The paper takes identities as given; where a source has them they bypass all this.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from vlmm_log.elements import Sightings, Tracked
from vlmm_log.pipeline import object_kernels as ok
from vlmm_log.settings import TrackSettings
from vlmm_log.types import Features, Float32, Float64, FlowField, FramePair, Int32, Int64, Segments

f32 = np.float32
FARTHEST = 2.0  # masks are carried by at most this multiple of the flow: beyond, its direction says little


@dataclass(frozen=True, eq=False)
class Track:
    """An element as it was last seen."""

    name: str
    feature: Float32  # (D,)
    position: Float32  # (3,) m, world; NaN where it had no depth
    spread: float  # m, root mean variance of its points
    last_ns: int


@dataclass(frozen=True, eq=False)
class Carried:
    """The last frame's masks with the flow that carries them on."""

    labels: Int32  # (H, W) 0: none; i + 1: instance i
    ids: Int64  # (n,) which element each instance is
    flow: Float32  # (H / THIN, W, 2) px, of every THIN-th row
    first_ns: int
    second_ns: int


@dataclass(frozen=True, eq=False)
class Tracks:
    """What association remembers."""

    next_id: int = 1
    live: Mapping[int, Track] = field(default_factory=dict)
    carried: Carried | None = None


def associate(sightings: Sightings, features: Features, tracks: Tracks, first_ns: int, s: TrackSettings) -> Tracked:
    """Element ids of a frame's instances: the source's identities, else known elements, else new ones."""
    segments, n = sightings.segments, len(sightings.segments)
    ids = segments.identities.copy()
    similarity = (ids >= 0).astype(np.float32)
    free = np.flatnonzero(ids < 0)
    given, oldest_ns = set(ids.tolist()), first_ns - s.forget_s * 1e9
    known = [i for i, track in tracks.live.items() if i not in given and track.last_ns >= oldest_ns]
    if free.size and known:
        score = _similarities(sightings, features, tracks, known, first_ns, s)[:, free]
        score[score < s.min_similarity] = 0.0  # else a sum of poor ones may outweigh a good one
        for row, column in zip(*linear_sum_assignment(-score), strict=True):
            if score[row, column] > 0:
                ids[free[column]], similarity[free[column]] = known[row], score[row, column]
    new = np.flatnonzero(ids < 0)
    fresh = max(tracks.next_id, int(ids.max(initial=0)) + 1)
    ids[new] = np.arange(fresh, fresh + new.size)
    assert np.unique(ids).size == n, "an identity stands twice in a frame"
    return Tracked(sightings, features.vectors, ids, similarity)


def carrying(flow: FlowField) -> Float32:
    """(H / THIN, W, 2) px, what of a flow carries masks on: every THIN-th row."""
    return flow.forward[:: ok.THIN].copy()


def remember(tracks: Tracks, tracked: Tracked, pair: FramePair, carrier: Float32, s: TrackSettings) -> Tracks:
    """The tracks after a pair, ``carrier`` of its flow. Elements unseen too long are forgotten; the map keeps them."""
    rows, segments = tracked.sightings.rows, tracked.sightings.segments
    now = pair.first.stamp_ns
    live = {i: t for i, t in tracks.live.items() if now - t.last_ns <= s.forget_s * 1e9}
    spread = np.sqrt(np.maximum(rows["extent"][:, [0, 3, 5]].mean(axis=1), 0.0))
    for k, element in enumerate(tracked.ids.tolist()):
        own = tracked.features[k].copy(), rows["position"][k].copy()  # views would keep all instances of the pair
        live[element] = Track(segments.names[k], *own, float(spread[k]), now)
    carried = Carried(segments.labels, tracked.ids, carrier, now, pair.second.stamp_ns)
    return Tracks(max(tracks.next_id, int(tracked.ids.max(initial=0)) + 1), live, carried)


def _similarities(
    sightings: Sightings, features: Features, tracks: Tracks, known: list[int], first_ns: int, s: TrackSettings
) -> Float64:
    """(m, n) in [0, 1]: weighted mean of what is known of a pair of element and instance."""
    overlap, has_overlap = _overlaps(sightings, tracks.carried, known, first_ns)
    position, has_position = _nearness(sightings, tracks, known, first_ns, s)
    feature, has_feature = _likeness(sightings.segments, features, tracks, known)
    total = np.zeros_like(overlap)
    weight = np.zeros_like(overlap)
    for value, there, w in (
        (overlap, has_overlap, s.overlap_weight),
        (position, has_position, s.position_weight),
        (feature, has_feature, s.feature_weight),
    ):
        total += np.where(there, w * value, 0.0)
        weight += np.where(there, w, 0.0)
    return np.divide(total, weight, out=np.zeros_like(total), where=weight > 0)


def _overlaps(
    sightings: Sightings, carried: Carried | None, known: list[int], first_ns: int
) -> tuple[Float64, NDArray[np.bool_]]:
    """Intersection over union of carried masks and instances (m, n); known where the last frame can be carried here.

    0 for an element that was not in it: what is found again must not outrank what was never lost.
    """
    segments = sightings.segments
    shape = (len(known), len(segments))
    iou, there = np.zeros(shape), np.zeros(shape, np.bool_)
    if carried is None or carried.labels.shape != segments.labels.shape or not carried.ids.size:
        return iou, there
    share = (first_ns - carried.first_ns) / max(carried.second_ns - carried.first_ns, 1)
    if not 0.0 <= share <= FARTHEST:
        return iou, there
    areas = np.empty(carried.ids.size, np.int32)
    both = np.empty((carried.ids.size, len(segments)), np.int32)
    ok.carried_overlap(carried.labels, carried.flow, f32(share), segments.labels, areas, both)
    own = sightings.rows["pixels"][None, :]
    shared = np.minimum(both, own)  # a mask that shrinks lands several times on a pixel
    ratio = shared / np.maximum(areas[:, None] + own - shared, 1)
    place = {element: row for row, element in enumerate(known)}
    for i, element in enumerate(carried.ids.tolist()):
        if element in place:
            iou[place[element]] = ratio[i]
    return iou, np.ones(shape, np.bool_)


def _nearness(
    sightings: Sightings, tracks: Tracks, known: list[int], first_ns: int, s: TrackSettings
) -> tuple[Float64, NDArray[np.bool_]]:
    """exp(-d^2 / 2) of the centroids' distance in sigmas: of the element's own size, and of time unseen.

    What has no label is found again where it was, or not at all: anything could have come to where it went.
    """
    live = [tracks.live[i] for i in known]
    at = np.array([t.position for t in live], np.float64)
    unseen_s = np.array([first_ns - t.last_ns for t in live]) / 1e9
    spread = np.array([t.spread for t in live])
    drift = np.minimum(s.drift_m_s * unseen_s, s.drift_most_m) * [bool(t.name) for t in live]
    variance = s.position_sigma_m**2 + (0.5 * spread) ** 2 + drift**2
    d2 = ((at[:, None] - sightings.rows["position"][None].astype(np.float64)) ** 2).sum(axis=2)
    near = np.exp(-0.5 * d2 / variance[:, None])
    there = np.isfinite(near)
    return np.where(there, near, 0.0), there


def _likeness(
    segments: Segments, features: Features, tracks: Tracks, known: list[int]
) -> tuple[Float64, NDArray[np.bool_]]:
    """Cosine of the features, 1 for equal labels; known where both have either."""
    live = [tracks.live[i] for i in known]
    theirs = np.array([t.feature for t in live], np.float64).reshape(len(live), -1)
    cosine = np.maximum(theirs @ features.vectors.T.astype(np.float64), 0.0)
    there = np.linalg.norm(theirs, axis=1)[:, None] * np.linalg.norm(features.vectors, axis=1)[None] > 0
    names = np.array([t.name for t in live], dtype=object)[:, None]
    own = np.array(segments.names, dtype=object)[None, :]
    same = (names == own) & (own != "")
    return np.where(same, 1.0, cosine), there | same
