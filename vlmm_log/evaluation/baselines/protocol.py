"""What a baseline gives."""

from __future__ import annotations

from typing import Protocol

from vlmm_log.elements import Elements
from vlmm_log.evaluation.scores import Scores
from vlmm_log.evaluation.trial import Seen
from vlmm_log.types import Float32


class Baseline(Protocol):
    """A mechanism that sees what a trial saw, pair after pair."""

    name: str
    reference: str  # whose mechanism, and what is left out of it
    threshold: float  # pixel scores above it are flags; NaN: it scores no pixels

    def see(self, seen: Seen) -> Float32 | None:
        """Score of each pixel (H, W), not negative, NaN where it has none; None where no pixel is judged."""
        ...

    def answers(self, elements: Elements) -> tuple[Scores, ...]:
        """Its scores of the trial's elements: one, or candidates of which the best counts."""
        ...
