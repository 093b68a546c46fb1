"""For which elements a leaf of a filter tree holds, how well, and why: vectorised, in three-valued logic."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlmm_log.elements import MotionClass
from vlmm_log.pipeline.fusion import motion_strength
from vlmm_log.pipeline.language.scene import Column, Scene, values, window
from vlmm_log.query_tree import Class, Compare, Moved, Named, Seen
from vlmm_log.types import Float32, Float64

Bools = NDArray[np.bool_]
Why = Callable[[int], str]


@dataclass(frozen=True, eq=False)
class Truth:
    """Neither yes nor no: unknown."""

    yes: Bools  # (n,)
    no: Bools
    strength: Float32  # (n,) in [0, 1]
    why: Why  # the values that decided, of a row


def crisp(yes: Bools, known: Bools, why: Why) -> Truth:
    """A truth that only holds or not."""
    return Truth(yes & known, ~yes & known, np.ones(yes.size, np.float32), why)


def graded(yes: Bools, known: Bools, strength: Float32 | Float64, why: Why) -> Truth:
    """A truth that holds more or less; strengths are clipped to [0, 1], unknown ones are 0."""
    clipped = np.clip(np.nan_to_num(strength, nan=0.0), 0, 1).astype(np.float32, copy=False)
    return Truth(yes & known, ~yes & known, clipped, why)


def named(node: Named, scene: Scene) -> Truth:
    """Which elements bear a name."""
    similarity = scene.similarity[node.text]
    yes = similarity >= scene.theta_s  # without a feature it is not so named
    return graded(yes, np.ones_like(yes), similarity, lambda row: f"named {node.text!r} {similarity[row]:.2f}")


def of_class(node: Class, scene: Scene) -> Truth:
    """Which elements have a class."""
    yes = scene.elements.motion_class == MotionClass[node.motion_class.upper()]
    strength = np.where(yes, scene.elements.confidence, 0)
    return graded(yes, np.ones_like(yes), strength, lambda row: class_why(scene, row))


def class_why(scene: Scene, row: int) -> str:
    """The fused class of a row with the values and thresholds that made it."""
    e, f = scene.elements, scene.fusion
    o, kappa, rho = float(e.o[row]), float(e.kappa[row]), float(e.rho[row])
    name = MotionClass(e.motion_class[row]).name.lower()
    if e.motion_class[row] == MotionClass.MOVING:
        return f"motion_class {name} (o {o:.2f} > {f.tau_o:g}, kappa {kappa:.2f} >= {f.kappa_o:g})"
    still = f"o {o:.2f} <= {f.tau_o:g}" if o <= f.tau_o else f"kappa {kappa:.2f} < {f.kappa_o:g}"
    sign = ">=" if e.motion_class[row] == MotionClass.MOVABLE_STATIC else "<"
    return f"motion_class {name} ({still}, rho {rho:.2f} {sign} {f.rho_tau:g})"


def moved(node: Moved, scene: Scene) -> Truth:
    """Which elements moved in a time span."""
    e = scene.elements
    begin, end = window(scene, node.t0_s, node.t1_s)
    within = (e.intervals[:, 0] <= end) & (e.intervals[:, 1] >= begin)
    yes = np.zeros(len(e), bool)
    yes[e.interval_rows[within]] = True
    ever = node.t0_s is None and node.t1_s is None
    order, rows = scene.interval_order

    def why(row: int) -> str:
        own = order[np.searchsorted(rows, row) : np.searchsorted(rows, row, "right")]
        spans = [((e.intervals[i] - scene.origin_ns) / 1e9).tolist() for i in own.tolist() if within[i]]
        told = ", ".join(f"{a:.1f}-{b:.1f} s" for a, b in spans[:3]) + (", ..." if len(spans) > 3 else "")
        parts = [class_why(scene, row)] if ever else []
        return ", ".join([*parts, f"moved {told}" if told else "no motion interval" + ("" if ever else " then")])

    strength = motion_strength(e.o, scene.fusion.tau_o)
    return graded(scene.has_moved if ever else yes, np.ones_like(yes), strength, why)


def seen(node: Seen, scene: Scene) -> Truth:
    """Which elements were in view in a time span."""
    e = scene.elements
    begin, end = window(scene, node.t0_s, node.t1_s)
    yes = (e.first_ns <= end) & (e.last_ns >= begin)

    def why(row: int) -> str:
        first, last = (e.first_ns[row] - scene.origin_ns) / 1e9, (e.last_ns[row] - scene.origin_ns) / 1e9
        return f"first seen {first:.1f} s, last seen {last:.1f} s"

    return crisp(yes, np.ones_like(yes), why)


def movable(scene: Scene) -> Truth:
    """Which elements could be moved."""
    rho, tau = scene.elements.rho, scene.fusion.rho_tau
    yes = rho >= tau
    sources = scene.elements.rho_sources

    def why(row: int) -> str:
        source = f" ({sources[row]})" if sources else ""
        return f"rho {rho[row]:.2f} {'>=' if yes[row] else '<'} {tau:g}{source}"

    return graded(yes, np.isfinite(rho), rho, why)


def compare(node: Compare, scene: Scene) -> Truth:
    """Whose field's value compares so with a number; unknown where the field is.

    What stood still is not faster than any speed, and whether it is slower than one is unknown: it has none.
    """
    column = values(scene, node.field)
    with np.errstate(over="ignore"):  # a number too large for the column's type is infinite
        limit = np.float32(node.value) if column.dtype == np.float32 else np.float64(node.value)
    yes = _holds(node.op, column, limit)
    known = ~np.isnan(column)
    if node.field == "speed":
        known &= scene.has_moved | ~yes
    return crisp(yes, known, lambda row: f"{node.field} {column[row]:.4g}")


def _holds(op: str, column: Column, limit: np.floating[Any]) -> Bools:
    match op:
        case "<":
            yes = column < limit
        case "<=":
            yes = column <= limit
        case ">=":
            yes = column >= limit
        case ">":
            yes = column > limit
        case _:
            yes = np.isclose(column, limit, rtol=1e-5, atol=1e-6)
    return np.asarray(yes)
