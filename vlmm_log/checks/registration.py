"""Whether depth lies on colour: mirrored, moved by a constant, or of another moment."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

import numpy as np

from vlmm_log.checks.case import Case
from vlmm_log.checks.edges import HALF, Alignment
from vlmm_log.checks.report import Evidence, Finding, Told
from vlmm_log.readers.assembly import parse_shift
from vlmm_log.types import Float32, Float64

# A constant shift below is usual. Along rows it is larger: the sensors of one device stand side by side, so that what
# is left of their parallax lies there.
USUAL_PX = (5.5, 3.5)
NEAR_PX = (4.0, 2.0)  # the best shift so near to none is what a larger one must beat
GAIN_SHIFT, GAIN_DELAY = 0.1, 0.2  # of the correlation above its background that they must win
MIRRORED = 2.0  # times the correlation as it is
DELAYED_S = 0.04  # a shorter delay is within the usual stamping of two unsynchronised cameras
MANY = 5  # places, from which on a lack of correlation is looked into
CLEAR = 0.03  # correlation above its background, below which edges say nothing


def check_registration(case: Case) -> Told:
    """Colour against depth, by the edges of both."""
    alignments = [a for a in case.samples.alignments if np.isfinite(a.shifts[a.own]).all()]
    if not alignments:
        yield Evidence("registration", "cannot tell: too few depth edges")
        return
    flips = list(_flips(alignments))
    yield from flips
    if any(isinstance(told, Finding) for told in flips):
        return
    delays_s, pooled = _pooled(alignments)
    if len(alignments) >= MANY and _clearness(pooled[0]) < CLEAR:  # depth of quite another moment?
        delays_s, pooled = _pooled([a for a in case.distant if np.isfinite(a.shifts[a.own]).all()] or alignments)
    delays = list(_delay(case, delays_s, pooled))
    yield from delays
    if not any(isinstance(told, Finding) for told in delays):
        slow = float(np.median([a.flow_px_s for a in alignments]))  # colour and depth are not of quite the same moment
        yield from _shift(case, _pooled([a for a in alignments if a.flow_px_s <= slow])[1][0])


def _clearness(shifts: Float32) -> float:
    """Correlation at the best shift above that at any."""
    return float(shifts.max() - np.median(shifts))


def _pooled(alignments: list[Alignment]) -> tuple[dict[int, float], dict[int, Float32]]:
    """Mean delay s and mean correlation map by distance in frames, of distances that most places have."""
    maps, delays = defaultdict(list), defaultdict(list)
    for a in alignments:
        for k, (delay, shifts) in enumerate(zip(a.delays_s, a.shifts, strict=True), -a.own):
            if np.isfinite(shifts).all():
                maps[k].append(shifts)
                delays[k].append(delay)
    kept = sorted(k for k in maps if 2 * len(maps[k]) > len(alignments))
    return {k: float(np.mean(delays[k])) for k in kept}, {k: np.mean(maps[k], axis=0) for k in kept}


def _flips(alignments: list[Alignment]) -> Told:
    as_is = float(np.median([a.shifts[a.own].max() for a in alignments]))
    scores = {name: float(np.median([a.flipped[name] for a in alignments])) for name in alignments[0].flipped}
    best = max(scores, key=lambda name: scores[name])
    figures = {"correlation": as_is, "correlation_mirrored": scores[best]}
    if scores[best] > max(MIRRORED * as_is, CLEAR):
        text = (
            f"depth edges lie on colour edges only mirrored ({best}): correlation {scores[best]:.2f}, not {as_is:.2f}"
        )
        yield Finding("mirrored depth", text, f"mirror the depth images ({best}) before they are listed", figures)
    else:
        yield Evidence("mirrored depth", f"not mirrored: correlation {as_is:.2f}, mirrored {scores[best]:.2f}", figures)


def _delay(case: Case, delays_s: dict[int, float], pooled: dict[int, Float32]) -> Told:
    """Depth of another moment: its edges follow colour's only at another distance in the list."""
    steps = sorted(pooled)
    scores = np.array([_clearness(pooled[k]) for k in steps])
    best, own = int(np.argmax(scores)), steps.index(0)
    if len(steps) < 5 or scores.min() > 0.7 * scores.max() or scores.max() < CLEAR:
        yield Evidence("depth clock", "cannot tell: depth edges do not move enough against colour")
        return
    delay = peak([delays_s[k] for k in steps], scores)
    gain = float((scores[best] - scores[own]) / scores[best])
    figures = {"delay_s": delay, "gain": gain, "correlation": float(scores[own])}
    text = f"depth edges meet colour edges {delay * 1e3:+.0f} ms later by their stamps"
    if best != own and abs(delay) > DELAYED_S and gain > GAIN_DELAY:
        offset = case.read.depth_offset_s - delay
        text = f"{text}: correlation {scores[best]:.2f} against {scores[own]:.2f}"
        yield Finding("depth clock", text, f"--set read.depth_offset_s={offset:.3f}", figures)
    else:
        yield Evidence("depth clock", text, figures)


def _shift(case: Case, shifts: Float32) -> Told:
    """A constant displacement."""
    row, column = np.unravel_index(int(np.argmax(shifts)), shifts.shape)
    grid = 2 * np.arange(-HALF, HALF + 1)
    dx, dy = peak(grid.tolist(), shifts[row]), peak(grid.tolist(), shifts[:, column])
    near = shifts[np.ix_(np.abs(grid) <= NEAR_PX[1], np.abs(grid) <= NEAR_PX[0])]
    top, clear = float(shifts.max()), _clearness(shifts)
    gain = (top - float(near.max())) / max(clear, 1e-6)
    figures = {"dx_px": dx, "dy_px": dy, "gain": gain, "correlation": top}
    text = f"depth edges lie best on colour edges moved by {dx:+.0f}, {dy:+.0f} px"
    if clear < CLEAR:
        yield Evidence("registration", "cannot tell: depth edges lie on no colour edges", figures)
    elif (abs(dx) > USUAL_PX[0] or abs(dy) > USUAL_PX[1]) and gain > GAIN_SHIFT:
        given = parse_shift(case.read.depth_shift_px)
        x, y = round(given[0] + dx), round(given[1] + dy)
        yield Finding("registration", text, f"--set read.depth_shift_px={x},{y}", figures)
    else:
        yield Evidence("registration", text, figures)


def peak(places: Sequence[float], scores: Float64 | Float32) -> float:
    """Where the scores are largest, refined by the parabola through the neighbours."""
    k = int(np.argmax(scores))
    if not 0 < k < len(scores) - 1:
        return float(places[k])
    a, b, c = (float(x) for x in scores[k - 1 : k + 2])
    bend = a - 2 * b + c
    part = 0.0 if bend >= 0 else 0.5 * (a - c) / bend
    return float(places[k] + part * (places[k + 1] - places[k - 1]) / 2)
