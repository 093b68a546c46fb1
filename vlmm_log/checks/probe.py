"""A few pairs of frames spread over a log: their matches, and how well colour and depth edges lie on each other.

Everything that the checks ask of the images is read off once, so that a candidate convention costs a re-evaluation
of some hundred matches and no image is decoded twice.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace

import numpy as np

from vlmm_log.checks.edges import Alignment, align
from vlmm_log.checks.timeline import Timeline
from vlmm_log.pipeline.flow import estimate_flow
from vlmm_log.pipeline.matches import WINDOW, local_depth_range, structure_tensor
from vlmm_log.protocols import FlowEstimator, Progress
from vlmm_log.readers.stored import StoredLog
from vlmm_log.types import Float64, Frame, FramePair, Int64, Skipped

PLACES = 14  # of a log that are looked at
AROUND_NS = 210_000_000  # time before and after a place whose depth images are tried on its colour image
AROUND = 7  # and at most so many frames
DISTANT_NS, DISTANT, DISTANT_PLACES = 1_020_000_000, 32, 4  # and where nothing correlates
STRIDE = 8  # px between matches
ROUND_TRIP_PX = 1.0  # a match that comes back farther away is none
TEXTURE = 4.0  # least squared gradient along the weaker direction, grey levels^2/px^2
EDGE = 0.03  # a match where the 3x3 depth range is a larger share of depth lies on an edge
MOVED_PX = (6.0, 60.0)  # median flow that a pair should have: below, noise decides; above, matches get lost
FIRST_GAP, LONGEST = 3, 24  # frames from one to the other: at first, and at most
FEWEST = 100  # matches of a pair that is relied on
COUNTED = 65536  # stored depth values that are counted


@dataclass(frozen=True, eq=False)
class Probe:
    """Matches of a pair of frames."""

    place: int  # which place of the log
    first_ns: int  # stamp of the colour image; flow is between colour images
    second_ns: int
    size: tuple[int, int]  # (H, W)
    x_a: Float64  # (N, 2) px
    x_b: Float64
    z_a: Float64  # (N,) m
    z_b: Float64

    @property
    def moved_px(self) -> float:
        """Median length of the flow; NaN without a match."""
        return float(np.median(np.linalg.norm(self.x_b - self.x_a, axis=1))) if len(self.x_a) else np.nan


@dataclass
class Samples:
    """What the images of a log showed."""

    probes: list[Probe] = field(default_factory=list)
    alignments: list[Alignment] = field(default_factory=list)
    stored: Int64 = field(default_factory=lambda: np.zeros(COUNTED, np.int64))  # how often each stored depth value came
    seen: list[float] = field(default_factory=list)  # share of pixels with any depth, by frame
    metres: list[float] = field(default_factory=list)  # median depth by frame, m
    left_out: Counter[str] = field(default_factory=Counter)  # reasons


def counted_per_meter(log: StoredLog) -> float:
    """Units in which depth values are counted: the stored ones, and fine ones of depth that is stored in metres."""
    return log.units_per_meter if log.units_per_meter != 1 else 5000.0


def places(timeline: Timeline) -> Int64:
    """Frame numbers, well spread, each with a later frame."""
    count = len(timeline.pairs)
    ends = max(count - FIRST_GAP - 1, 1)
    return np.unique(np.linspace(0, ends - 1, PLACES).round().astype(np.int64))


def sample(log: StoredLog, timeline: Timeline, flow: FlowEstimator, tell: Progress) -> Samples:
    """Look at every place once. Memory is bounded by the frames around one place."""
    samples = Samples()
    at = places(timeline)
    frames: dict[int, Frame] = {}
    for k, place in enumerate(at):
        frames = _around(log, timeline, int(place), samples.left_out, frames)
        if int(place) in frames:
            _look(log, timeline, flow, int(place), frames, samples)
        tell(k + 1, len(at))
    return samples


def distant_alignments(log: StoredLog, timeline: Timeline) -> list[Alignment]:
    """Alignments of a few places with depth from a second before to a second after; slow, so only asked for in need."""
    found = []
    at = places(timeline)
    for place in at[:: max(1, len(at) // DISTANT_PLACES)]:
        frames = _around(log, timeline, int(place), Counter(), {}, DISTANT_NS, DISTANT)
        if int(place) in frames:
            found.append(_aligned(timeline, int(place), frames))
    return found


def _aligned(timeline: Timeline, place: int, frames: dict[int, Frame]) -> Alignment:
    colour_ns = int(timeline.colour_ns[place])
    depths = {k - place: ((f.stamp_ns - colour_ns) / 1e9, f.depth) for k, f in frames.items()}
    return align(frames[place], depths)


def _around(
    log: StoredLog,
    timeline: Timeline,
    place: int,
    left_out: Counter[str],
    known: dict[int, Frame],
    ns: int = AROUND_NS,
    most: int = AROUND,
) -> dict[int, Frame]:
    """The frames near a place by their number; those that are known already are not decoded again."""
    stamps = timeline.frame_ns
    near = np.flatnonzero(np.abs(stamps - stamps[place]) <= ns)
    low = max(int(near[0]), place - most)
    high = min(max(min(int(near[-1]), place + most), place + FIRST_GAP), len(stamps) - 1)
    kept = {k: frame for k, frame in known.items() if low <= k <= high}
    start = max([low, *(k + 1 for k in kept)])  # places ascend, and so do what is known and what is not
    return kept if start > high else kept | _frames(log, timeline, start, high, left_out)


def _frames(log: StoredLog, timeline: Timeline, low: int, high: int, left_out: Counter[str]) -> dict[int, Frame]:
    stamps = timeline.frame_ns
    start, stop = (int(stamps[k]) - timeline.origin_ns for k in (low, high))
    found: dict[int, Frame] = {}
    for item in log.frames(start, stop + 1):
        if isinstance(item, Skipped):
            left_out[item.reason] += 1
        else:
            found[int(np.searchsorted(stamps, item.stamp_ns))] = item
    return found


def _look(
    log: StoredLog, timeline: Timeline, flow: FlowEstimator, place: int, frames: dict[int, Frame], samples: Samples
) -> None:
    a = frames[place]
    seen = a.depth[np.isfinite(a.depth)]
    samples.seen.append(seen.size / a.depth.size)
    samples.metres.append(float(np.median(seen)) if seen.size else np.nan)
    stored = np.rint(seen.astype(np.float64) * counted_per_meter(log))
    whole = stored[(stored > 0) & (stored < COUNTED)].astype(np.int64)
    samples.stored += np.bincount(whole, minlength=COUNTED)
    probe = _probe(log, timeline, flow, place, frames, samples.left_out)
    fast = np.inf if probe is None or not len(probe.z_a) else probe.moved_px / (probe.second_ns - probe.first_ns) * 1e9
    samples.alignments.append(replace(_aligned(timeline, place, frames), flow_px_s=float(fast)))
    if probe is not None:
        samples.probes.append(probe)


def _probe(
    log: StoredLog,
    timeline: Timeline,
    flow: FlowEstimator,
    place: int,
    frames: dict[int, Frame],
    left_out: Counter[str],
) -> Probe | None:
    """The matches of a place with a later frame, so far away that something has moved but not out of sight."""
    stamps = timeline.colour_ns
    gap = min(FIRST_GAP, len(stamps) - 1 - place)
    best, tried = None, set[int]()
    while 1 <= gap <= LONGEST and place + gap < len(stamps) and gap not in tried:
        tried.add(gap)
        second = place + gap
        b = frames.get(second) or _frames(log, timeline, second, second, left_out).get(second)
        if b is None or b.depth.shape != frames[place].depth.shape:
            break
        x_a, x_b, z_a, z_b = _matches(frames[place], b, flow)
        size = (b.depth.shape[0], b.depth.shape[1])
        found = Probe(place, int(stamps[place]), int(stamps[second]), size, x_a, x_b, z_a, z_b)
        if best is None or len(found.z_a) >= FEWEST:
            best = found
        lost = len(found.z_a) < FEWEST or found.moved_px > MOVED_PX[1]
        if not lost and found.moved_px >= MOVED_PX[0]:
            break
        gap = gap // 2 if lost else gap * 2
    return best


def _matches(a: Frame, b: Frame, flow: FlowEstimator) -> tuple[Float64, Float64, Float64, Float64]:
    """Places px and depths m of matches on a coarse grid that can be trusted: textured, consistent, off edges."""
    field_ab = estimate_flow(FramePair(a, b), flow)
    H, W = a.depth.shape
    v, u = (g.ravel() for g in np.mgrid[STRIDE // 2 : H : STRIDE, STRIDE // 2 : W : STRIDE])
    xx, xy, yy = structure_tensor(a.rgb)[:, v, u]
    texture = (xx + yy) / 2 - np.hypot((xx - yy) / 2, xy)
    x_a = np.column_stack([u, v]).astype(np.float64)
    x_b = x_a + field_ab.forward[v, u]
    nearest = np.rint(x_b).astype(np.int64)
    inside = ((nearest >= 0) & (nearest < [W, H])).all(axis=1)
    i, j = np.where(inside[:, None], nearest, 0).T
    z_a, z_b = a.depth[v, u], b.depth[j, i]
    flat_a = local_depth_range(a.depth)[v, u] < EDGE * z_a
    flat_b = local_depth_range(b.depth)[j, i] < EDGE * z_b
    kept = inside & flat_a & flat_b & (field_ab.fb_error[v, u] < ROUND_TRIP_PX) & (texture > TEXTURE * WINDOW**2)
    return x_a[kept], x_b[kept], z_a[kept].astype(np.float64), z_b[kept].astype(np.float64)
