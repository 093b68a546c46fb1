"""Motion without its uncertainty: metres alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vlmm_log.background import empty_background
from vlmm_log.elements import Elements
from vlmm_log.evaluation.baselines.means import ElementMeans
from vlmm_log.evaluation.scores import QUERIES, Scores, whole
from vlmm_log.evaluation.trial import Seen
from vlmm_log.pipeline.fusion import fuse
from vlmm_log.pipeline.objects import aggregate
from vlmm_log.pipeline.world_map import empty_map, update
from vlmm_log.protocols import MovabilityPrior
from vlmm_log.settings import Settings
from vlmm_log.types import Float32

FLAG_M = 0.02  # the paper's inlier threshold of ego-refinement


class RawDisplacement:
    """The length of the residual, nothing else."""

    name = "raw displacement"
    reference = "paper, Table III: ||m|| after the same ego-refinement"
    threshold = float("nan")

    def __init__(self) -> None:
        self._means = ElementMeans()

    def see(self, seen: Seen) -> Float32 | None:
        """No score of its own: every trial's norm is judged beside its d_M."""
        self._means.add(seen, seen.motion.norm)
        return None

    def answers(self, elements: Elements) -> tuple[Scores, ...]:
        """What moved could move; what did not is still."""
        moving = self._means.of(elements)
        return (Scores(moving, moving, -moving),)


class NoUncertainty:
    """Everything of the method but the covariance: one sigma for all pixels."""

    name = "no uncertainty"
    reference = "paper, Table II (v): full fusion, d_M replaced by ||m|| in units of one fixed sigma"
    threshold = float("nan")

    def __init__(self, s: Settings, prior: MovabilityPrior) -> None:
        self._s, self._prior = s, prior
        self._map = empty_map(s.map)

    def see(self, seen: Seen) -> Float32 | None:
        """No score of its own: every trial's norm is judged beside its d_M."""
        motion = seen.motion
        sigma = np.float32(FLAG_M / motion.tau_px)  # flags from FLAG_M on
        flat = replace(motion, d_m=motion.norm / sigma)
        sightings = aggregate(seen.pair, seen.segments, flat, seen.ego, seen.odometry, self._s.objects)
        tracked = replace(seen.tracked, sightings=sightings)
        grown = update(self._map, tracked, empty_background(self._s.map.voxel_m))
        self._map = fuse(grown, self._prior, self._s.map)
        return None

    def answers(self, elements: Elements) -> tuple[Scores, ...]:
        """By the same queries, on its own map of the same elements."""
        own = self._map.columns
        place = {int(i): row for row, i in enumerate(own.ids.tolist())}
        rows = np.array([place[int(i)] for i in elements.ids.tolist()], np.int64)
        scores = whole(own, self._s)
        assert scores.named is not None and scores.motion_class is not None
        named = {name: yes[rows] for name, yes in scores.named.items()}
        moving, movable, static = (scores.of(query)[rows] for query in QUERIES)
        return (Scores(moving, movable, static, named, scores.motion_class[rows]),)
