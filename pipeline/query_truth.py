"""For which elements a filter tree holds, how well, and why: vectorised over the columns, in three-valued logic."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlmm_log.elements import MotionClass
from vlmm_log.pipeline.query_explain import SIDES
from vlmm_log.pipeline.query_scene import Column, Scene, values, window
from vlmm_log.pipeline.query_space import direction, nearest, on_side, placed
from vlmm_log.query_tree import AllOf, AnyOf, Class, Compare, Movable, Moved, Named, Near, Node, Not, Seen, Side, walk
from vlmm_log.types import Float32, Float64, Int64

Bools = NDArray[np.bool_]
Why = Callable[[int], str]


@dataclass(frozen=True, eq=False)
class Truth:
    """Neither yes nor no: unknown."""

    yes: Bools  # (n,)
    no: Bools
    strength: Float32  # (n,) in [0, 1]
    why: Why  # the values that decided, of a row


def judge(node: Node, scene: Scene, among: Bools | None = None) -> Truth:
    """Where a tree holds. Unknown values make neither a node nor its negation hold (Kleene's logic).

    Strengths: cosine of a name; score / (score + tau_o) of motion; rho; the class's confidence; 1 of what only
    holds or not; 1 - strength of a negation; their product under "all", the largest that holds under "any".
    Rows that are not ``among`` those still asked may come out either way.
    """
    match node:
        case Named():
            return _named(node, scene)
        case Class():
            return _class(node, scene)
        case Moved():
            return _moved(node, scene)
        case Seen():
            return _seen(node, scene)
        case Movable():
            return _movable(scene)
        case Compare():
            return _compare(node, scene)
        case Near():
            return _near(node, scene, among)
        case Side():
            return _side(node, scene, among)
        case Not(inner):
            of = judge(inner, scene, among)
            return Truth(of.no, of.yes, 1 - of.strength, lambda row: f"not: {of.why(row)}")
        case AllOf(nodes):
            return _all(nodes, scene, among)
        case AnyOf(nodes):
            return _any([judge(n, scene, among) for n in nodes], len(scene.elements))


def _crisp(yes: Bools, known: Bools, why: Why) -> Truth:
    return Truth(yes & known, ~yes & known, np.ones(yes.size, np.float32), why)


def _graded(yes: Bools, known: Bools, strength: Float32 | Float64, why: Why) -> Truth:
    clipped = np.clip(np.nan_to_num(strength, nan=0.0), 0, 1).astype(np.float32, copy=False)
    return Truth(yes & known, ~yes & known, clipped, why)


def _all(nodes: tuple[Node, ...], scene: Scene, among: Bools | None) -> Truth:
    n = len(scene.elements)
    yes, no, strength = np.ones(n, bool), np.zeros(n, bool), np.ones(n, np.float32)
    if among is not None:
        no = ~among
    of: dict[int, Truth] = {}
    for i in sorted(range(len(nodes)), key=lambda i: _is_spatial(nodes[i])):  # places last, for few rows
        t = of[i] = judge(nodes[i], scene, ~no)
        yes, no, strength = yes & t.yes, no | t.no, strength * t.strength
    return Truth(yes & ~no, no, strength, lambda row: ", ".join(filter(None, (of[i].why(row) for i in sorted(of)))))


def _is_spatial(node: Node) -> bool:
    return any(isinstance(n, Near | Side) for n, _ in walk(node))


def _any(of: list[Truth], n: int) -> Truth:
    yes, no, strength = np.zeros(n, bool), np.ones(n, bool), np.zeros(n, np.float32)
    for t in of:
        yes, no, strength = yes | t.yes, no & t.no, np.maximum(strength, np.where(t.yes, t.strength, 0))

    def why(row: int) -> str:
        return " or ".join(t.why(row) for t in of if t.yes[row] or not yes[row])

    return Truth(yes, no, strength, why)


def _named(node: Named, scene: Scene) -> Truth:
    similarity = scene.similarity[node.text]
    yes = similarity >= scene.theta_s  # without a feature it is not so named
    return _graded(yes, np.ones_like(yes), similarity, lambda row: f"named {node.text!r} {similarity[row]:.2f}")


def _class(node: Class, scene: Scene) -> Truth:
    yes = scene.elements.motion_class == MotionClass[node.motion_class.upper()]
    strength = np.where(yes, scene.elements.confidence, 0)
    return _graded(yes, np.ones_like(yes), strength, lambda row: class_why(scene, row))


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


def _moved(node: Moved, scene: Scene) -> Truth:
    e = scene.elements
    begin, end = window(scene, node.t0_s, node.t1_s)
    within = (e.intervals[:, 0] <= end) & (e.intervals[:, 1] >= begin)
    yes = np.zeros(len(e), bool)
    yes[e.interval_rows[within]] = True
    ever = node.t0_s is None and node.t1_s is None
    moving = e.motion_class == MotionClass.MOVING
    order, rows = scene.interval_order

    def why(row: int) -> str:
        own = order[np.searchsorted(rows, row) : np.searchsorted(rows, row, "right")]
        spans = [((e.intervals[i] - scene.origin_ns) / 1e9).tolist() for i in own.tolist() if within[i]]
        told = ", ".join(f"{a:.1f}-{b:.1f} s" for a, b in spans[:3]) + (", ..." if len(spans) > 3 else "")
        parts = [class_why(scene, row)] if ever else []
        return ", ".join([*parts, f"moved {told}" if told else "no motion interval" + ("" if ever else " then")])

    with np.errstate(invalid="ignore"):
        strength = e.score / (e.score + max(scene.fusion.tau_o, 1e-6))
    return _graded(yes | moving if ever else yes, np.ones_like(yes), strength, why)


def _seen(node: Seen, scene: Scene) -> Truth:
    e = scene.elements
    begin, end = window(scene, node.t0_s, node.t1_s)
    yes = (e.first_ns <= end) & (e.last_ns >= begin)

    def why(row: int) -> str:
        first, last = (e.first_ns[row] - scene.origin_ns) / 1e9, (e.last_ns[row] - scene.origin_ns) / 1e9
        return f"seen {first:.1f}-{last:.1f} s"

    return _crisp(yes, np.ones_like(yes), why)


def _movable(scene: Scene) -> Truth:
    rho, tau = scene.elements.rho, scene.fusion.rho_tau
    yes = rho >= tau
    sources = scene.elements.rho_sources

    def why(row: int) -> str:
        source = f" ({sources[row]})" if sources else ""
        return f"rho {rho[row]:.2f} {'>=' if yes[row] else '<'} {tau:g}{source}"

    return _graded(yes, np.isfinite(rho), rho, why)


def _compare(node: Compare, scene: Scene) -> Truth:
    column = values(scene, node.field)
    with np.errstate(over="ignore"):  # a number too large for the column's type is infinite
        limit = np.float32(node.value) if column.dtype == np.float32 else np.float64(node.value)
    yes = _holds(node.op, column, limit)
    return _crisp(yes, ~np.isnan(column), lambda row: f"{node.field} {column[row]:.4g}")


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


def _near(node: Near, scene: Scene, among: Bools | None) -> Truth:
    metres = scene.near_m if node.metres is None else node.metres
    targets = _targets(node.target, scene)
    distance, name = distances(targets, scene, _rows(scene, among), metres)
    known = _related(scene, targets) & ~np.isnan(distance)

    def why(row: int) -> str:
        d = float(distance[row])
        return f"{d:.2f} m from {name(row)}" if d < np.inf else f"none such within {metres:g} m"

    return _crisp(distance <= metres, known, why)


def distances(targets: Int64 | None, scene: Scene, rows: Int64, reach: float = np.inf) -> tuple[Float32, Why]:
    """Metres (n,) from rows to the nearest other one of the targets, None: to the camera; inf: none within reach."""
    if targets is None:
        camera = np.asarray(values(scene, "distance_m"), np.float32)
        return camera, lambda row: "the camera"  # noqa: ARG005
    distance, which = nearest(scene.elements.positions, targets, rows, reach)
    return distance, lambda row: scene.name(int(which[row])) if which[row] >= 0 else "any such"


def _targets(target: Node | None, scene: Scene) -> Int64 | None:
    return None if target is None else np.flatnonzero(judge(target, scene).yes)


def _related(scene: Scene, targets: Int64 | None) -> Bools:
    """Where a relation can be decided: what has a position, and is not itself the only target."""
    known = placed(scene.elements.positions)
    if targets is not None and targets.size == 1:
        known[targets] = False
    return known


def _rows(scene: Scene, among: Bools | None) -> Int64:
    return np.arange(len(scene.elements)) if among is None else np.flatnonzero(among)


def _side(node: Side, scene: Scene, among: Bools | None) -> Truth:
    targets = _targets(node.target, scene)
    known = _related(scene, targets)
    way = direction(node.relation, scene.T_world_cam, scene.up, node.target is None)
    if way is None or (targets is None and scene.T_world_cam is None):
        return _crisp(known, np.zeros_like(known), lambda row: "")  # noqa: ARG005
    points = scene.elements.positions
    if targets is None:
        assert scene.T_world_cam is not None
        ahead = (points - scene.T_world_cam[:3, 3].astype(np.float32)) @ way.astype(np.float32)
        return _crisp(ahead > 0, known, lambda row: f"{ahead[row]:.2f} m {SIDES[node.relation]} the camera")
    which = on_side(points, np.asarray(values(scene, "size_m"), np.float32), targets, _rows(scene, among), way)

    def why(row: int) -> str:
        return f"{SIDES[node.relation]} {scene.name(int(which[row])) if which[row] >= 0 else 'none'}"

    return _crisp(which >= 0, known, why)
