"""Means of a pixel quantity over each element, of all pairs that showed it."""

from __future__ import annotations

from collections import defaultdict

import numpy as np

from vlmm_log.elements import Elements
from vlmm_log.evaluation.trial import Seen
from vlmm_log.types import Float32, Float64


class ElementMeans:
    """The median over pairs of the mean over an element's scored pixels."""

    def __init__(self) -> None:
        self._seen: dict[int, list[float]] = defaultdict(list)

    def add(self, seen: Seen, score: Float32) -> None:
        """One pair."""
        labels, n = seen.segments.labels, len(seen.segments)
        scored = np.isfinite(score)
        counts = np.bincount(labels[scored], minlength=n + 1)[1:]
        sums = np.bincount(labels[scored], score[scored], minlength=n + 1)[1:]
        for k, element in enumerate(seen.tracked.ids.tolist()):
            if counts[k] and seen.sightings.observed[k]:
                self._seen[element].append(float(sums[k] / counts[k]))

    def of(self, elements: Elements) -> Float64:
        """(n,) 0 for an element without a value."""
        return np.array([np.median(self._seen.get(i, [0.0])) for i in elements.ids.tolist()], np.float64)
