"""A Bayes filter of three classes a point, carried along by the flow."""

from __future__ import annotations

import cv2
import numpy as np

from vlmm_log.elements import Elements
from vlmm_log.evaluation.baselines.means import ElementMeans
from vlmm_log.evaluation.scores import Scores
from vlmm_log.evaluation.trial import Seen
from vlmm_log.protocols import MovabilityPrior
from vlmm_log.types import Float32

SIGMA_M = 0.02  # of a still point's residual, whatever its depth
STAY = 0.95  # chance that a point keeps its class from frame to frame
TRUST = 0.9  # that a measurement tells the class it tells


class DewanStyle:
    """Beliefs (non-movable, movable, dynamic) of points: an objectness prior and the residual's length."""

    name = "Dewan-style"
    reference = (
        "Dewan et al., IROS 2017: per-point Bayes filter over non-movable, movable, dynamic; objectness from the "
        "movability prior instead of a network, points of an RGB-D image instead of a LiDAR's"
    )
    threshold = 0.5

    def __init__(self, prior: MovabilityPrior) -> None:
        self._prior = prior
        self._belief: Float32 | None = None
        self._stamp_ns = 0
        self._means = (ElementMeans(), ElementMeans(), ElementMeans())

    def see(self, seen: Seen) -> Float32:
        """Belief in "dynamic"."""
        belief = _predicted(self._carried(seen)) * self._likelihood(seen)
        belief /= belief.sum(axis=0)
        self._belief, self._stamp_ns = belief, seen.pair.first.stamp_ns
        scored = np.isfinite(seen.motion.d_m)
        for mean, plane in zip(self._means, belief, strict=True):
            mean.add(seen, np.where(scored, plane, np.float32(np.nan)))
        return np.asarray(np.where(scored, belief[2], np.float32(np.nan)))

    def answers(self, elements: Elements) -> tuple[Scores, ...]:
        """The filter's own classes."""
        still, movable, dynamic = (mean.of(elements) for mean in self._means)
        return (Scores(dynamic, movable + dynamic, still),)

    def _carried(self, seen: Seen) -> Float32:
        """The last beliefs where their points are now; ignorance elsewhere."""
        H, W = seen.pair.first.depth.shape
        if self._belief is None or self._belief.shape[1:] != (H, W):
            return np.full((3, H, W), 1 / 3, np.float32)
        first, second = seen.pair.first.stamp_ns, seen.pair.second.stamp_ns
        share = np.float32((first - self._stamp_ns) / max(second - first, 1))
        v, u = np.mgrid[0:H, 0:W].astype(np.float32)
        flow = seen.flow.forward
        maps = u - share * flow[..., 0], v - share * flow[..., 1]
        planes = [
            cv2.remap(plane, *maps, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=1 / 3)
            for plane in self._belief
        ]
        return np.stack(planes)

    def _likelihood(self, seen: Seen) -> Float32:
        """(3, H, W) of what this pair shows, given each class."""
        rho = np.array([0.0, *(self._prior(name).rho for name in seen.segments.names)], np.float32)
        movable = rho[seen.segments.labels]
        norm = seen.motion.norm
        moves = np.where(np.isfinite(norm), 1 - np.exp(-0.5 * (norm / np.float32(SIGMA_M)) ** 2), np.float32(0.5))
        told = np.stack([(1 - moves) * (1 - movable), (1 - moves) * movable, moves])
        return np.asarray((1 - TRUST) / 3 + TRUST * told, np.float32)


def _predicted(belief: Float32) -> Float32:
    return np.asarray(STAY * belief + (1 - STAY) / 3, np.float32)
