"""Average precision, calibration error, F1, IDF1 and confidence intervals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from vlmm_log.evaluation.counts import Counts, Summed
from vlmm_log.types import Float64

ECE_BINS = 15


def average_precision(positives: Float64, negatives: Float64) -> float:
    """Sum of precision times the step in recall (scikit-learn's definition), of counts by rising score.

    Equal scores count as one step. NaN without a positive.
    """
    tp, fp = np.cumsum(positives[::-1]), np.cumsum(negatives[::-1])
    if tp.size == 0 or tp[-1] == 0:
        return float("nan")
    steps = positives[::-1] / tp[-1]
    return float(np.sum(steps * tp / np.maximum(tp + fp, 1)))


def element_average_precision(yes: NDArray[np.bool_], scores: Float64) -> float:
    """Average precision of few scores; NaN without a positive."""
    order = np.unique(scores)
    place = np.searchsorted(order, scores)
    counts = [np.bincount(place[m], minlength=order.size).astype(np.float64) for m in (yes, ~yes)]
    return average_precision(counts[0], counts[1])


def full_frame_ap(s: Summed) -> float:
    """A pixel that was not scored has score 0."""
    return average_precision(*s.full_frame())


def scored_ap(s: Summed) -> float:
    """Of scored pixels alone: to be read beside the coverage."""
    return average_precision(s.moving.astype(np.float64), s.static.astype(np.float64))


def interval(counts: Counts, of: Callable[[Summed], float], rng: np.random.Generator, draws: int = 200) -> list[float]:
    """95 % bootstrap interval of a figure: frames are drawn again, with replacement. NaN where it cannot be told."""
    n = len(counts.frames)
    if n < 2:
        return [float("nan")] * 2
    values = [of(counts.summed(np.bincount(rng.integers(0, n, n), minlength=n))) for _ in range(draws)]
    if np.isnan(values).all():
        return [float("nan")] * 2
    return [float(x) for x in np.nanquantile(values, [0.025, 0.975])]


@dataclass(frozen=True)
class Reliability:
    """Confidence against how often it is right, in equal-width bins of [0, 1]."""

    confidence: tuple[float, ...]  # mean of each bin; NaN for an empty one
    frequency: tuple[float, ...]
    weight: tuple[float, ...]  # share of all

    @property
    def ece(self) -> float:
        """Expected calibration error (Guo et al., ICML 2017)."""
        gaps = [w * abs(c - f) for c, f, w in zip(self.confidence, self.frequency, self.weight, strict=True) if w]
        return float(sum(gaps)) if gaps else float("nan")


def reliability(p: Float64, positives: Float64, negatives: Float64) -> Reliability:
    """Of probabilities (m,), each with so many positives and negatives."""
    place = np.minimum((np.asarray(p) * ECE_BINS).astype(np.int64), ECE_BINS - 1)
    both = positives + negatives
    total, right, mass = (
        np.bincount(place, w, ECE_BINS) for w in (both, np.asarray(positives, np.float64), both * np.asarray(p))
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        return Reliability(
            tuple((mass / total).tolist()), tuple((right / total).tolist()), tuple((total / total.sum()).tolist())
        )


@dataclass(frozen=True)
class Decision:
    """A yes or no against the truth."""

    precision: float
    recall: float
    f1: float


def decision(truth: NDArray[np.bool_], yes: NDArray[np.bool_]) -> Decision:
    """Precision 1 where nothing was said, recall 1 where there was nothing to find."""
    right = int(np.count_nonzero(truth & yes))
    said, there = int(np.count_nonzero(yes)), int(np.count_nonzero(truth))
    f1 = 2 * right / (said + there) if said + there else 1.0
    return Decision(right / said if said else 1.0, right / there if there else 1.0, f1)


def macro_f1(truth: Sequence[int], said: Sequence[int], classes: int) -> float:
    """Mean of the classes' F1."""
    a, b = np.asarray(truth), np.asarray(said)
    return float(np.mean([decision(a == k, b == k).f1 for k in range(classes)]))


def idf1(together: NDArray[np.int64], truth_total: int, found_total: int) -> float:
    """IDF1 (Ristani et al., ECCVW 2016): detections under the best one-to-one assignment of found to true identities.

    ``together[i, j]``: in how many frames true identity i was matched by found identity j.
    """
    if truth_total + found_total == 0:
        return float("nan")
    rows, columns = linear_sum_assignment(-together)
    return float(2 * together[rows, columns].sum() / (truth_total + found_total))
