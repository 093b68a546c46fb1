"""A pair's score against the truth, pixel by pixel."""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from vlmm_log.evaluation.truth import IGNORE, MOVING, STATIC, PairTruth
from vlmm_log.types import Float32, UInt8


class Outcome(IntEnum):
    """What became of a pixel."""

    QUIET = 0  # static, not flagged
    HIT = 1  # moving, flagged
    MISS = 2  # moving, scored, not flagged
    LOST = 3  # moving, not scored
    FALSE_FLAG = 4  # static, flagged
    IGNORED = 5  # no truth


def outcome(score: Float32, threshold: float, truth: PairTruth) -> UInt8:
    """(H, W) Outcome. ``score`` is NaN where a pixel was not scored."""
    scored = np.isfinite(score)
    flagged = scored & (np.nan_to_num(score, nan=0.0) > threshold)
    moving, static = truth.motion == MOVING, truth.motion == STATIC
    out = np.full(score.shape, Outcome.QUIET, np.uint8)
    out[truth.motion == IGNORE] = Outcome.IGNORED
    out[moving] = Outcome.MISS
    out[moving & ~scored] = Outcome.LOST
    out[moving & flagged] = Outcome.HIT
    out[static & flagged] = Outcome.FALSE_FLAG
    return out
