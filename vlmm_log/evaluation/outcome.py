"""A pair's score against the truth, pixel by pixel."""

from __future__ import annotations

import numpy as np

from vlmm_log.evaluation.counts import Counts, FrameCounts
from vlmm_log.evaluation.metrics import full_frame_ap
from vlmm_log.evaluation.truth import IGNORE, MOVING, STATIC, PairTruth
from vlmm_log.types import Float32, Judgement, Outcome, UInt8


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


def judgement(score: Float32, threshold: float, truth: PairTruth, counted: FrameCounts) -> Judgement:
    """What a recording shows of a pair that was judged."""
    one = Counts([counted]).summed()
    figures = {
        "ap": full_frame_ap(one),
        "recall": one.recall,
        "precision": one.precision,
        "static_flags": one.static_flags,
        "far_flags": one.far_flags,
    }
    known = {name: value for name, value in figures.items() if value == value}
    return Judgement(truth.motion, outcome(score, threshold, truth), score, known)
