"""Attributes of an element from its observations, and the fusion rule (paper, Eqs. 12 and 13)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from vlmm_log.calibration import Curve
from vlmm_log.elements import OBSERVATION, Element, Evidence, MotionClass, Observations, WorldMap
from vlmm_log.protocols import MovabilityPrior
from vlmm_log.settings import MapSettings
from vlmm_log.types import Float32, Float64, Int64


def fuse(world: WorldMap, prior: MovabilityPrior, s: MapSettings, curve: Curve | None = None) -> WorldMap:
    """The map with the attributes of its touched elements brought up to date.

    ``curve`` makes probabilities of motion evidence; without one they are NaN.
    """
    elements = dict(world.elements)
    for i in world.touched:
        if world.evidence[i].feature_pixels >= s.min_pixels:
            elements[i] = attributes(world.evidence[i], prior, s, curve)
    return replace(world, elements=elements)


def motion_strength(o: Float32 | Float64 | float, tau_o: float) -> Float32 | Float64:
    """How strongly things of these scores moved, in [0, 1): 1/2 at tau_o."""
    with np.errstate(invalid="ignore"):
        return np.asarray(o / (o + max(tau_o, 1e-6)))


def motion_evidence(has_moved: NDArray[np.bool_] | bool, o: Float32 | Float64 | float, tau_o: float) -> Float64:
    """By which elements are ranked as movers, in [0, 2): whether they have the class or an interval, then how much.

    The median o: the kappa-weighted score ranks things that a mover passed by above slow movers.
    """
    return np.asarray(has_moved + motion_strength(o, tau_o), np.float64)


def classify(o: float, kappa: float, rho: float, s: MapSettings) -> tuple[MotionClass, float]:
    """Motion class and its confidence: reliable observed motion overrides the prior."""
    if o > s.tau_o and kappa >= s.kappa_o:
        return MotionClass.MOVING, kappa
    if rho >= s.rho_tau:
        return MotionClass.MOVABLE_STATIC, rho
    return MotionClass.STATIC, 1.0 - rho


def attributes(evidence: Evidence, prior: MovabilityPrior, s: MapSettings, curve: Curve | None = None) -> Element:
    """What all observations of an element together say."""
    seen = evidence.observations
    label = evidence.label
    movability = prior(label)
    sigmas, kappas = seen["o"].astype(np.float64), seen["kappa"].astype(np.float64)
    medians = _medians(seen)
    median, kappa = float(medians[0]), float(medians[1])
    o = median / s.o_unit
    motion_class, confidence = classify(o, kappa, movability.rho, s)
    moved = (sigmas / s.o_unit > s.tau_o) & (kappas >= s.kappa_o) | (seen["part"] > s.part)
    weight = float(kappas.sum())
    pairs = 1 if motion_class is MotionClass.MOVING else s.interval_pairs  # what moves as a rule needs no more proof
    intervals = motion_intervals(seen, moved, pairs)
    score = float(kappas @ sigmas) / s.o_unit / weight if weight else 0.0
    has_moved = motion_class is MotionClass.MOVING or intervals.size > 0
    return Element(
        evidence,
        label,
        medians[2:5],
        medians[5:],
        o,
        kappa,
        movability.rho,
        movability.source,
        motion_class,
        confidence,
        float(chdtrc(3, median**2)),
        score,
        _speed(seen[moved & _within(seen, intervals)]) if intervals.size else 0.0,
        intervals,
        float("nan") if curve is None else float(curve(motion_evidence(has_moved, o, s.tau_o))),
    )


def _words(*names: str) -> list[int]:
    """Where fields of OBSERVATION lie, in units of four bytes."""
    found: list[int] = []
    for kind, offset in (OBSERVATION.fields[name][:2] for name in names):  # type: ignore[index]
        found += range(offset // 4, (offset + kind.itemsize) // 4)
    return found


_MEDIANS = _words("o", "kappa", "position", "extent")


def _medians(seen: Observations) -> Float32:
    """(11,) medians of o, kappa, position and extent over observations, in one partition."""
    n = seen.size
    table = np.ascontiguousarray(np.ascontiguousarray(seen).view(np.float32).reshape(n, -1)[:, _MEDIANS].T)
    table.partition([(n - 1) // 2, n // 2], axis=1)
    return np.asarray((table[:, (n - 1) // 2] + table[:, n // 2]) * np.float32(0.5))


def _speed(moved: Observations) -> float:
    """Median m/s of observations that moved."""
    seconds = (moved["second_ns"] - moved["first_ns"]) / 1e9
    length = np.linalg.norm(moved["drift"].astype(np.float64), axis=1)
    return float(np.median(length / np.maximum(seconds, 1e-9)))


def _within(seen: Observations, intervals: Int64) -> NDArray[np.bool_]:
    """(k,) whether each observation began in a motion interval."""
    first, (starts, stops) = seen["first_ns"], np.sort(intervals, axis=0).T
    began, ended = np.searchsorted(starts, first, "right"), np.searchsorted(stops, first, "right")
    return np.asarray(began > ended)


def motion_intervals(seen: Observations, moved: NDArray[np.bool_], pairs: int) -> Int64:
    """(m, 2) ns: runs of at least ``pairs`` observations in a row that moved. Time unseen ends a run."""
    if np.count_nonzero(moved) < pairs:
        return np.zeros((0, 2), np.int64)
    steps = np.diff(seen["first_ns"])
    usual = 2 * steps[steps > 0].min(initial=np.iinfo(np.int64).max // 2)
    apart = steps > np.maximum(usual, seen["second_ns"][:-1] - seen["first_ns"][:-1])
    starts = np.flatnonzero(np.concatenate([[True], apart | ~moved[1:] | ~moved[:-1]]))
    kept = moved[starts] & (np.diff(starts, append=seen.size) >= pairs)
    spans = np.stack([seen["first_ns"][starts], np.maximum.reduceat(seen["second_ns"], starts)], axis=1)
    return np.asarray(spans[kept], np.int64)
