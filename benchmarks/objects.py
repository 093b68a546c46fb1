"""The object stages on 30 masks that fill the image, and what the map keeps of an observation.

    python -m benchmarks.objects

Real images where they are at hand, else the rendered room. One thread; medians of one run.
"""

from __future__ import annotations

import time
import tracemalloc
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TypeVar

import cv2
import numpy as np

from benchmarks.data import textbook
from benchmarks.rows import Row, milliseconds, shown
from benchmarks.stages import one_pair
from vlmm_log.background import empty_background
from vlmm_log.elements import OBSERVATION, Sightings, Tracked
from vlmm_log.models.dis import Dis
from vlmm_log.models.prior import TablePrior, read_table
from vlmm_log.models.words import Words
from vlmm_log.pipeline.ego import refine_ego
from vlmm_log.pipeline.flow import estimate_flow
from vlmm_log.pipeline.fusion import fuse
from vlmm_log.pipeline.matches import match
from vlmm_log.pipeline.motion import measure_motion
from vlmm_log.pipeline.objects import aggregate
from vlmm_log.pipeline.odometry import locate
from vlmm_log.pipeline.run import World, empty_world
from vlmm_log.pipeline.tracks import associate, carrying, remember
from vlmm_log.pipeline.world_map import background, empty_map, still_points, update
from vlmm_log.settings import Settings
from vlmm_log.types import Features, FramePair, Segments

T = TypeVar("T")
NAMES = ("chair", "cup", "person", "tv", "keyboard", "book")
HISTORY = 300  # observations that each element has when the pair comes


def thirty_masks(shape: tuple[int, int]) -> Segments:
    """Blocks, six by five, over the whole image."""
    v, u = np.indices(shape)
    labels = (v * 5 // shape[0]) * 6 + u * 6 // shape[1] + 1
    names = tuple(NAMES[k % len(NAMES)] for k in range(30))
    return Segments(labels.astype(np.int32), names, np.full(30, 0.9, np.float32), np.full(30, -1, np.int64))


def measured(short: bool = False) -> Iterator[Row]:
    """All object stages, each element with a history of observations."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    history = 60 if short else HISTORY
    s = Settings()
    _, pair = one_pair()
    flow = estimate_flow(pair, Dis(s.flow))
    matches = match(pair, flow, s.gate, s.noise)
    segments = thirty_masks(pair.first.depth.shape)
    ego = refine_ego(matches, segments, s.ego, np.random.default_rng(0))
    motion = measure_motion(matches, ego)
    odometry = locate(pair, ego, None)
    embed = Words()
    prior = TablePrior(embed, read_table())

    spent: dict[str, list[float]] = defaultdict(list)

    def timed(name: str, work: Callable[[], T]) -> T:
        began = time.perf_counter()
        result = work()
        spent[name].append(1e3 * (time.perf_counter() - began))
        return result

    def objects(now: FramePair, world: World) -> World:
        seen = timed("aggregate", lambda: aggregate(now, segments, motion, ego, odometry, s.objects))
        features = timed("embed, words", lambda: Features(embed.regions(now.first, segments)))
        stamp_ns = now.first.stamp_ns
        tracked = timed("associate", lambda: associate(seen, features, world.tracks, stamp_ns, s.tracks))
        tracks = timed("remember", lambda: remember(world.tracks, tracked, now, carrying(flow), s.tracks))
        still = timed("background", lambda: background(still_points(now, motion), odometry, s.map.voxel_m))
        updated = timed("update of the map", lambda: update(world.map, tracked, still))
        return World(timed("fuse", lambda: fuse(updated, prior, s.map)), tracks, True, odometry)

    def later(k: int) -> FramePair:
        moved = (replace(f, stamp_ns=f.stamp_ns + k * 33_000_000, index=f.index + k) for f in (pair.first, pair.second))
        return FramePair(*moved)

    world = empty_world(s, has_poses=True)
    for k in range(history):
        world = timed("all object work of a pair", lambda k=k, world=world: objects(later(k), world))  # type: ignore[misc]
    naive = milliseconds(lambda: textbook.aggregate(pair, segments, motion, s.objects), repeats=3)
    medians = {name: float(np.median(ms[-100:])) for name, ms in spent.items()}
    notes = {
        "aggregate": f"mask by mask in numpy: {naive / medians['aggregate']:.0f} times it",
        "all object work of a pair": f"at most 6 asked; {history} observations of {len(world.map.elements)} elements",
    }
    for name, ms in medians.items():
        yield Row(name, ms, "ms", notes.get(name, ""))
    for pairs, size in growth(s).items():
        yield Row(f"memory an observation, after {pairs} pairs", size, "bytes")
    cv2.setNumThreads(threads)


def growth(s: Settings) -> dict[int, float]:
    """Bytes an observation of a map of 30 elements after so many pairs, its own reserve included."""
    rows = np.zeros(30, OBSERVATION)
    rows["pixels"] = 400
    segments = Segments(np.zeros((2, 2), np.int32), ("cup",) * 30, np.ones(30, np.float32), np.arange(30))
    features, none = np.ones((30, 256), np.float32), empty_background(s.map.voxel_m)
    tracemalloc.start()
    before, found = tracemalloc.get_traced_memory()[0], {}
    world = empty_map(s.map)
    for k in range(1600):
        rows = rows.copy()
        rows["first_ns"], rows["second_ns"], rows["index"] = k, k + 3, k
        seen = Sightings(segments, rows, np.zeros((30, 4), np.int32), np.ones(30, np.bool_))
        world = update(world, Tracked(seen, features, segments.identities, np.ones(30, np.float32)), none)
        if k + 1 in (100, 1600):
            found[k + 1] = (tracemalloc.get_traced_memory()[0] - before) / (30 * (k + 1))
    tracemalloc.stop()
    return found


if __name__ == "__main__":
    list(shown("objects of a pair, 30 masks", measured()))
