"""The sensor's own depth noise, from pixels that are known to be still."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from vlmm_log.evaluation.trial import Seen
from vlmm_log.evaluation.truth import STATIC, PairTruth
from vlmm_log.types import Float32, Float64

DEPTHS = np.arange(0.5, 6.01, 0.25)  # m, borders of the bins
FINE = 2000  # bins of |difference|
FINEST_M = 0.0002
ENOUGH = 2000  # pixels of a bin
NORMAL_MAD = 1.482602218505602  # standard deviation of a normal distribution over its median absolute deviation


@dataclass
class NoiseFit:
    """Differences of depth, measured against predicted, of static pixels, by depth."""

    counts: Float64 = field(default_factory=lambda: np.zeros((DEPTHS.size - 1, FINE)))

    def add(self, seen: Seen, truth: PairTruth) -> None:
        """One pair."""
        static = (truth.motion == STATIC) & np.isfinite(seen.motion.d_m)
        z = seen.pair.first.depth[static]
        difference = np.abs(along_axis(seen)[static])
        row = np.digitize(z, DEPTHS) - 1
        column = np.minimum((difference / FINEST_M).astype(np.int64), FINE - 1)
        inside = (row >= 0) & (row < DEPTHS.size - 1)
        flat = np.bincount(row[inside] * FINE + column[inside], minlength=self.counts.size)
        self.counts += flat.reshape(self.counts.shape)

    def sigma(self) -> tuple[Float64, Float64]:
        """Depths (n,) m, standard deviations (n,) m of one measurement there, robust; bins with enough pixels.

        A pair has two independent measurements, so the difference has twice the variance.
        """
        total = self.counts.sum(axis=1)
        middle = (np.cumsum(self.counts, axis=1) < total[:, None] / 2).sum(axis=1)
        enough = total >= ENOUGH
        centre = (DEPTHS[:-1] + DEPTHS[1:]) / 2
        return centre[enough], NORMAL_MAD / np.sqrt(2) * FINEST_M * (middle[enough] + 0.5)

    def model(self, z0: float) -> tuple[float, float] | None:
        """(a, b) of sigma_z = a + b (z - z0)^2, neither negative, least relative squares; None for < 3 bins."""
        from scipy.optimize import nnls

        z, sigma = self.sigma()
        if z.size < 3:
            return None
        design = np.stack([np.ones_like(z), (z - z0) ** 2], axis=1) / sigma[:, None]
        (a, b), _ = nnls(design, np.ones_like(z))
        return float(a), float(b)


def along_axis(seen: Seen) -> Float32:
    """(H, W) m, the residual along the second camera's optical axis."""
    T = seen.pair.second.T_world_cam
    axis = np.array([0, 0, 1], np.float32) if T is None else T[:3, 2].astype(np.float32)
    return np.asarray(np.einsum("k,kvu->vu", axis, seen.motion.residual))
