"""Scores of millions of pixels as counts: what average precision, flags and calibration are computed from.

A score falls into a bin by the upper bits of its float32 pattern: bins are at most 0.8 % wide. So a frame's score takes
20 kB, not megabytes, and frames can be drawn again for confidence intervals.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from vlmm_log.evaluation.truth import MOVING, STATIC, PairTruth
from vlmm_log.types import Float32, Float64, Int64

SHIFT = 16  # bits of the pattern that are dropped: 7 of the mantissa's stay
BINS = 1 << (31 - SHIFT)  # of scores that are not negative


def bins(scores: Float32) -> NDArray[np.uint32]:
    """Bin of each score, rising with it. Scores are finite and not negative; 0 is bin 0."""
    positive = np.ascontiguousarray(scores, np.float32) + np.float32(0)  # -0 as +0
    return np.asarray(positive.view(np.uint32) >> SHIFT, np.uint32)


def bin_floor(at: Int64 | int) -> Float32:
    """Smallest score of a bin."""
    return (np.asarray(at, np.uint32) << SHIFT).view(np.float32)


@dataclass(frozen=True, eq=False)
class FrameCounts:
    """One frame's scores, as counts of the bins that hold any."""

    at: NDArray[np.uint16]  # (m,) bins, ascending; small types, for thousands of frames are kept
    moving: NDArray[np.uint32]  # (m,) scored pixels that move
    static: NDArray[np.uint32]  # (m,)
    far: NDArray[np.uint32]  # (m,) of the static ones, those beyond far_m
    moving_lost: int  # pixels that were not scored
    static_lost: int
    ignored: int
    moving_flagged: int  # scored and above the threshold, exactly
    static_flagged: int
    far_flagged: int


def count(score: Float32, threshold: float, truth: PairTruth, far: NDArray[np.bool_]) -> FrameCounts:
    """Counts of a frame. ``score`` (H, W) is NaN where a pixel was not scored; ``far`` marks what is beyond far_m."""
    scored = np.isfinite(score)
    moving, static = truth.motion == MOVING, truth.motion == STATIC
    of = {name: scored & m for name, m in (("moving", moving), ("static", static), ("far", static & far))}
    tables = {name: np.bincount(bins(score[m]), minlength=BINS) for name, m in of.items()}
    at = np.flatnonzero(tables["moving"] + tables["static"])
    above = np.nan_to_num(score, nan=0.0) > threshold
    flagged = {name: int(np.count_nonzero(above & m)) for name, m in of.items()}
    return FrameCounts(
        at.astype(np.uint16),
        moving=tables["moving"][at].astype(np.uint32),
        static=tables["static"][at].astype(np.uint32),
        far=tables["far"][at].astype(np.uint32),
        moving_lost=int(np.count_nonzero(moving & ~scored)),
        static_lost=int(np.count_nonzero(static & ~scored)),
        ignored=int(truth.motion.size - np.count_nonzero(moving) - np.count_nonzero(static)),
        moving_flagged=flagged["moving"],
        static_flagged=flagged["static"],
        far_flagged=flagged["far"],
    )


@dataclass
class Counts:
    """Frame after frame of one score."""

    frames: list[FrameCounts] = field(default_factory=list)

    def summed(self, weights: NDArray[np.int64] | None = None) -> Summed:
        """All frames, or each so many times."""
        w = np.ones(len(self.frames), np.int64) if weights is None else weights
        tables = np.zeros((3, BINS), np.int64)
        single = np.zeros(6, np.int64)
        for times, f in zip(w.tolist(), self.frames, strict=True):
            if times:
                for table, values in zip(tables, (f.moving, f.static, f.far), strict=True):
                    table[f.at] += times * values
                single += times * np.array(
                    [f.moving_lost, f.static_lost, f.ignored, f.moving_flagged, f.static_flagged, f.far_flagged]
                )
        at = np.flatnonzero(tables[0] + tables[1])
        return Summed(at, tables[0][at], tables[1][at], tables[2][at], *(int(x) for x in single))


@dataclass(frozen=True, eq=False)
class Summed:
    """Counts of many frames; fields as in FrameCounts."""

    at: Int64
    moving: Int64
    static: Int64
    far: Int64
    moving_lost: int
    static_lost: int
    ignored: int
    moving_flagged: int
    static_flagged: int
    far_flagged: int

    @property
    def pixels(self) -> int:
        """That have a truth."""
        return int(self.moving.sum() + self.static.sum()) + self.moving_lost + self.static_lost

    @property
    def prevalence(self) -> float:
        """Share of them that moves: average precision of a random score."""
        return _share(int(self.moving.sum()) + self.moving_lost, self.pixels)

    @property
    def coverage(self) -> float:
        """Share of them that was scored."""
        return _share(int(self.moving.sum() + self.static.sum()), self.pixels)

    @property
    def recall(self) -> float:
        """Share of moving pixels above the threshold; those that were not scored are missed."""
        return _share(self.moving_flagged, int(self.moving.sum()) + self.moving_lost)

    @property
    def precision(self) -> float:
        """Share of flagged pixels that move."""
        return _share(self.moving_flagged, self.moving_flagged + self.static_flagged)

    @property
    def static_flags(self) -> float:
        """Share of scored static pixels above the threshold."""
        return _share(self.static_flagged, int(self.static.sum()))

    @property
    def far_flags(self) -> float:
        """Share of scored static far pixels above the threshold."""
        return _share(self.far_flagged, int(self.far.sum()))

    def full_frame(self) -> tuple[Float64, Float64]:
        """Moving and static pixels by rising score; those not scored have score 0, as others may."""
        moving, static = np.zeros((2, self.at.size + 1))
        moving[1:], static[1:] = self.moving, self.static
        lost = 1 if self.at.size and self.at[0] == 0 else 0
        moving[lost] += self.moving_lost
        static[lost] += self.static_lost
        return moving, static

    def far_flags_at(self, recall: float) -> float:
        """Far static flags at the highest threshold that finds this share of all moving pixels; NaN where none does."""
        if recall <= 0:
            return _share(0, int(self.far.sum()))
        total = int(self.moving.sum()) + self.moving_lost
        found = np.cumsum(self.moving[::-1]) / max(total, 1)
        enough = int(np.searchsorted(found, recall - 1e-12))
        if enough >= found.size:
            return float("nan")
        return _share(int(self.far[::-1][: enough + 1].sum()), int(self.far.sum()))


def _share(part: int, whole: int) -> float:
    return part / whole if whole else float("nan")
