"""Pixel scores to calibrated probabilities: a curve, linear between its knots, at every pixel."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vlmm_log.calibration import Curve
from vlmm_log.compiled import jit
from vlmm_log.types import Float32, Motion, Posterior

SHIFT = 16  # bits of a float32 that are dropped: its bins are at most 0.8 % wide
INFINITE = 0x7F80  # the last bin


class _Knots(NamedTuple):
    """A curve as the kernel reads it."""

    start: NDArray[np.int32]  # bin of a score -> last knot that is not above the bin
    x: Float32
    p: Float32
    slope: Float32  # from a knot to the next


def posterior(motion: Motion, curve: Curve) -> Posterior:
    """How likely each valid pixel moved: ``curve`` of its d_M."""
    p_moving = np.empty_like(motion.d_m)
    _follow(np.ascontiguousarray(motion.d_m).reshape(-1), *_knots(curve), p_moving.reshape(-1))
    return Posterior(p_moving)


@lru_cache(maxsize=4)
def _knots(curve: Curve) -> _Knots:
    floors = (np.arange(INFINITE + 1, dtype=np.uint32) << SHIFT).view(np.float32)
    start = np.searchsorted(curve.x, floors, "right") - 1
    with np.errstate(over="ignore"):  # knots as close as float64 has them: as steep as a float32 tells
        slope = np.append(np.diff(curve.p) / np.diff(curve.x), 0.0)
    x, p = curve.x.astype(np.float32), curve.p.astype(np.float32)
    return _Knots(start.clip(0).astype(np.int32), x, p, slope.clip(max=1e30).astype(np.float32))


@jit
def _follow(scores: Any, start: Any, x: Any, p: Any, slope: Any, out: Any) -> None:
    """The curve at scores that are NaN, or +0 and more."""
    bins, last = scores.view(np.uint32), x.size - 1
    for i in range(scores.size):
        score = scores[i]
        if np.isnan(score):
            out[i] = score
            continue
        k = start[bins[i] >> SHIFT]
        while k < last and score >= x[k + 1]:
            k += 1
        at = p[k] + max(score - x[k], np.float32(0)) * slope[k]
        out[i] = min(at, p[min(k + 1, last)])
