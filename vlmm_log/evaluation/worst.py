"""The frames that went worst, kept to be looked at."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from vlmm_log.evaluation.counts import Counts, count
from vlmm_log.evaluation.metrics import full_frame_ap
from vlmm_log.evaluation.outcome import outcome
from vlmm_log.evaluation.results import WorstFrame
from vlmm_log.evaluation.trial import Seen
from vlmm_log.evaluation.truth import MOVING, PairTruth

KEPT = 4
APART = 5  # frames: neighbours look alike
LEAST_SHARE = 0.005  # of the view that moves: the average precision of a handful of pixels says little


@dataclass
class Worst:
    """The frames of lowest average precision, a few of each log."""

    frames: list[WorstFrame] = field(default_factory=list)

    def add(self, source: str, seen: Seen, truth: PairTruth) -> None:
        """Keep it if it is among the worst."""
        if np.count_nonzero(truth.motion == MOVING) < LEAST_SHARE * truth.motion.size:
            return
        score, tau = seen.motion.d_m, seen.motion.tau_px
        ap = full_frame_ap(Counts([count(score, tau, truth, np.zeros(score.shape, bool))]).summed())
        index = seen.pair.first.index
        near = [f for f in self.frames if f.source == source and abs(f.index - index) < APART]
        if any(f.ap <= ap for f in near):
            return
        frame = WorstFrame(source, index, ap, seen.pair.first.rgb, outcome(score, tau, truth), score)
        kept = [f for f in self.frames if f not in near]
        self.frames = sorted([*kept, frame], key=lambda f: (f.ap, f.source, f.index))[:KEPT]
