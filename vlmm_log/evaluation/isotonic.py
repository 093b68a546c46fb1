"""Curves from scores to probabilities by isotonic regression."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vlmm_log.calibration import Curve
from vlmm_log.evaluation.counts import Summed, bin_floor
from vlmm_log.types import Float64


def pixel_curve(s: Summed) -> Curve | None:
    """P(moves) of a pixel's score; None without both kinds of pixels."""
    moving, static = s.moving.astype(np.float64), s.static.astype(np.float64)
    if not moving.sum() or not static.sum():
        return None
    return fitted(bin_floor(s.at).astype(np.float64), moving / (moving + static), moving + static)


def element_curve(evidence: Float64, moved: NDArray[np.bool_]) -> Curve | None:
    """P(has moved) of an element's evidence; None without both kinds of elements."""
    if moved.all() or not moved.any():
        return None
    return fitted(evidence, moved.astype(np.float64), np.ones(moved.size))


def fitted(x: Float64, y: Float64, weight: Float64) -> Curve:
    """The isotonic least-squares fit (scikit-learn), its knots alone."""
    from sklearn.isotonic import IsotonicRegression

    fit = IsotonicRegression(y_min=0.0, y_max=1.0, out_of_bounds="clip").fit(x, y, sample_weight=weight)
    knots = np.unique(np.asarray(fit.X_thresholds_, np.float64))
    return Curve(knots, np.maximum.accumulate(np.clip(fit.predict(knots), 0.0, 1.0)))
