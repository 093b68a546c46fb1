"""How the cost of a pair grows: with the image's resolution, masks, elements of the map and how long they are seen.

    python -m benchmarks.growth

Each row says what ten or four times as much costs; 1 is "nothing more". One thread, medians of one run.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np

from benchmarks.rows import Row, milliseconds, shown
from benchmarks.stages import one_pair
from vlmm_log.elements import OBSERVATION, Evidence, WorldMap
from vlmm_log.models.load import load_models
from vlmm_log.models.prior import TablePrior, read_table
from vlmm_log.models.words import Words
from vlmm_log.pipeline.fusion import fuse
from vlmm_log.pipeline.objects import gather_instances
from vlmm_log.pipeline.run import look
from vlmm_log.pipeline.world_map import empty_map
from vlmm_log.protocols import R
from vlmm_log.settings import Settings
from vlmm_log.sinks.map_entries import MapEntries
from vlmm_log.types import Frame, FramePair, Motion, Segments

TOUCHED = 20  # elements that a pair sees


def scaled(frame: Frame, factor: float) -> Frame:
    """A frame of another resolution."""
    H, W = frame.depth.shape
    size = (round(W * factor), round(H * factor))
    rgb = cv2.resize(frame.rgb, size, interpolation=cv2.INTER_LINEAR)
    depth = cv2.resize(frame.depth, size, interpolation=cv2.INTER_NEAREST)
    K = frame.K * np.array([[factor], [factor], [1.0]])
    return replace(frame, rgb=rgb, depth=depth, K=K, encoded_rgb=None, encoded_depth=None)


def blocks(shape: tuple[int, int], side: int) -> Segments:
    """Masks, ``side`` by ``side``, over the whole image."""
    v, u = np.indices(shape)
    labels = (v * side // shape[0]) * side + u * side // shape[1] + 1
    n = side * side
    return Segments(labels.astype(np.int32), ("cup",) * n, np.ones(n, np.float32), np.full(n, -1, np.int64))


def some_map(elements: int, history: int, s: Settings, prior: TablePrior) -> WorldMap:
    """A map whose first TOUCHED elements were seen in the last pair."""
    rng = np.random.default_rng(0)
    rows = np.zeros(history, OBSERVATION)
    for name in ("o", "kappa", "position"):
        rows[name] = rng.random(rows[name].shape)
    rows["extent"] = (0.01, 0, 0, 0.01, 0, 0.01)
    rows["first_ns"] = np.arange(history) * 33_000_000
    rows["second_ns"], rows["pixels"] = rows["first_ns"] + 100_000_000, 500
    feature = np.ones(256, np.float32) / 16
    seen = {i: Evidence(i, {"cup": 1000}, rows, feature, 500, 0) for i in range(1, elements + 1)}
    whole = replace(empty_map(s.map), evidence=seen, touched=tuple(seen))
    return replace(fuse(whole, prior, s.map), touched=tuple(range(1, TOUCHED + 1)))


def of_resolution(s: Settings, pair: FramePair) -> Iterator[Row]:
    """A look at a pair with four times the pixels."""
    models, spent = load_models(s)[0], []
    for factor in (1.0, 2.0):
        large = FramePair(scaled(pair.first, factor), scaled(pair.second, factor))
        spent.append(milliseconds(lambda large=large: look(large, models, s), 5))  # type: ignore[misc]
    yield Row("look at a pair, 4 times the pixels", spent[1] / spent[0], "times", f"{spent[0]:.0f}, {spent[1]:.0f} ms")


def of_masks(s: Settings, pair: FramePair) -> Iterator[Row]:
    """The instances of a frame, 9 and 100 of them."""
    found: list[Motion] = []

    def observe(result: R, /) -> R:
        if isinstance(result, Motion):
            found.append(result)
        return result

    look(pair, load_models(s)[0], s, observe)
    spent = []
    for side in (3, 10):
        masks = blocks(pair.first.depth.shape, side)
        spent.append(milliseconds(lambda masks=masks: gather_instances(pair, masks, found[0], s.objects)))  # type: ignore[misc]
    few, many = spent
    yield Row("instances, 100 masks for 9", many / few, "times", f"{few:.1f}, {many:.1f} ms")


def of_maps(s: Settings, *, short: bool) -> Iterator[Row]:
    """Fusing and recording what a pair touched of a large map, and of one that was seen for long."""
    prior = TablePrior(Words(), read_table())

    def spent(elements: int, history: int) -> float:
        world = some_map(elements, history, s, prior)
        entries = MapEntries()

        def work() -> None:
            list(entries.of_world(fuse(world, prior, s.map), 0))

        return milliseconds(work, 9)

    base, large = spent(100, 100), spent(1000, 100)
    yield Row("map of a pair, 1000 elements for 100", large / base, "times", f"{base:.1f}, {large:.1f} ms")
    most = 1000 if short else 10_000
    long = spent(100, most)
    yield Row(f"map of a pair, {most} observations for 100", long / base, "times", f"{base:.1f}, {long:.1f} ms")


def measured(short: bool = False) -> Iterator[Row]:
    """All of it."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    s = Settings()
    _, pair = one_pair()
    yield from of_resolution(s, pair)
    yield from of_masks(s, pair)
    yield from of_maps(s, short=short)
    cv2.setNumThreads(threads)


if __name__ == "__main__":
    list(shown("growth of the cost", measured()))
