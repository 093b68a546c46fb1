"""Elements against true things: which is which, what each thing did, and how well identities were kept."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from vlmm_log.evaluation.metrics import idf1
from vlmm_log.evaluation.trial import Seen
from vlmm_log.evaluation.truth import IGNORE, MOVING, PairTruth, ThingTruth
from vlmm_log.types import Float64, Int32, Int64, freeze

MATCH_IOU = 0.5  # of an instance and a true thing, for identities
MOVED_SHARE = 0.5  # a pair shows a thing moving if this share of its judged pixels moved


@dataclass(frozen=True, eq=False)
class Judged:
    """Elements with what is true of them. Things without an element stand at the end, as row -1: they were missed."""

    rows: Int64  # (n,) row of the map's columns; -1 a missed thing
    things: Int64  # (n,) identity; 0 what is no thing of the truth
    moved: NDArray[np.bool_]  # (n,)
    movability: Float64  # (n,)

    def __post_init__(self) -> None:
        freeze(self)


@dataclass
class ThingCounts:
    """What pairs showed of the true things, and where the elements of one trial lay."""

    things: Mapping[int, ThingTruth]
    pairs_moving: Counter[int] = field(default_factory=Counter)  # thing -> pairs in which it moved
    most_pixels: Counter[int] = field(default_factory=Counter)
    overlap: Counter[tuple[int, int]] = field(default_factory=Counter)  # (element, thing) -> pixels
    matched: Counter[tuple[int, int]] = field(default_factory=Counter)  # (element, thing) -> frames
    true_seen: int = 0  # things in all frames
    found_seen: int = 0  # instances in all frames

    def add(self, truth: PairTruth, seen: Seen, min_pixels: int) -> None:
        """One pair. Things smaller than ``min_pixels`` in it are not asked for."""
        if truth.instances is None:
            return
        labels, n = seen.segments.labels, len(seen.segments)
        width = int(truth.instances.max()) + 1
        both = np.bincount(
            (labels.astype(np.int64) * width + truth.instances).ravel(), minlength=(n + 1) * width
        ).reshape(n + 1, width)
        self._things(truth.instances, truth, both.sum(axis=0))
        self._identities(both, seen.tracked.ids, min_pixels)

    def _things(self, instances: Int32, truth: PairTruth, pixels: Int64) -> None:
        moving = np.bincount(instances[truth.motion == MOVING], minlength=pixels.size)
        judged = np.bincount(instances[truth.motion != IGNORE], minlength=pixels.size)
        for thing in np.flatnonzero(pixels).tolist():
            if thing:
                self.most_pixels[thing] = max(self.most_pixels[thing], int(pixels[thing]))
                self.pairs_moving[thing] += bool(judged[thing] and moving[thing] >= MOVED_SHARE * judged[thing])

    def _identities(self, both: Int64, ids: Int64, min_pixels: int) -> None:
        areas, of_things = both.sum(axis=1), both.sum(axis=0)
        shown = np.flatnonzero(of_things >= min_pixels)
        self.true_seen += int(np.count_nonzero(shown))  # identity 0 is no thing
        for k, element in enumerate(ids.tolist(), 1):
            if areas[k] < min_pixels:
                continue
            self.found_seen += 1
            for thing in np.flatnonzero(both[k]).tolist():
                self.overlap[element, thing] += int(both[k, thing])
                union = areas[k] + of_things[thing] - both[k, thing]
                if thing and of_things[thing] >= min_pixels and both[k, thing] > MATCH_IOU * union:
                    self.matched[element, thing] += 1

    @property
    def idf1(self) -> float:
        """How well identities were kept: see metrics.idf1."""
        elements = {e: i for i, e in enumerate(sorted({e for e, _ in self.matched}))}
        things = {t: i for i, t in enumerate(sorted({t for _, t in self.matched}))}
        together = np.zeros((len(things), len(elements)), np.int64)
        for (e, t), frames in self.matched.items():
            together[things[t], elements[e]] = frames
        return idf1(together, self.true_seen, self.found_seen)

    def moved(self, thing: int) -> bool:
        """Whether any pair showed it moving."""
        return self.pairs_moving[thing] > 0

    def judged(self, ids: Int64, min_pixels: int) -> Judged:
        """Each element by the thing that most of its pixels are of; and the things that no element is of."""
        best: dict[int, tuple[int, int]] = {}
        for (element, thing), pixels in sorted(self.overlap.items()):
            best[element] = max(best.get(element, (0, 0)), (pixels, thing))
        owned = [best.get(int(i), (0, 0))[1] for i in ids.tolist()]
        missed = [t for t, px in sorted(self.most_pixels.items()) if px >= min_pixels and t not in owned]
        things = np.array([*owned, *missed], np.int64)
        rows = np.concatenate([np.arange(len(owned)), np.full(len(missed), -1)]).astype(np.int64)
        return Judged(
            rows,
            things,
            np.array([self.moved(t) for t in things.tolist()], np.bool_),
            np.array([self.things[t].movability if t in self.things else 0.0 for t in things.tolist()]),
        )
