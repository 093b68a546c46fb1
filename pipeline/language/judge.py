"""For which elements a filter tree holds, how well, and why: its leaves put together, and its relations."""

from __future__ import annotations

import numpy as np

from vlmm_log.pipeline.language.explain import SIDES
from vlmm_log.pipeline.language.scene import Scene, values
from vlmm_log.pipeline.language.space import direction, half_width, nearest, on_side, placed
from vlmm_log.pipeline.language.truth import (
    Bools,
    Truth,
    Why,
    compare,
    crisp,
    movable,
    moved,
    named,
    of_class,
    seen,
)
from vlmm_log.query_tree import AllOf, AnyOf, Class, Compare, Movable, Moved, Named, Near, Node, Not, Seen, Side, walk
from vlmm_log.types import Float32, Int64


def judge(node: Node, scene: Scene, among: Bools | None = None) -> Truth:
    """Where a tree holds. Unknown values make neither a node nor its negation hold (Kleene's logic).

    Strengths: cosine of a name, o / (o + tau_o) of motion, rho, the class's confidence; one minus these where
    they are negated. What only holds or not has 1, negated or not, so that the others alone rank. Under "all" their
    product, under "any" the largest that holds; a negation of either is brought down to its parts.
    Rows that are not ``among`` those still asked may come out either way.
    """
    match node:
        case Named():
            return named(node, scene)
        case Class():
            return of_class(node, scene)
        case Moved():
            return moved(node, scene)
        case Seen():
            return seen(node, scene)
        case Movable():
            return movable(scene)
        case Compare():
            return compare(node, scene)
        case Near():
            return _near(node, scene, among)
        case Side():
            return _side(node, scene, among)
        case Not(Not(inner)):
            return judge(inner, scene, among)
        case Not(AllOf(nodes)):
            return judge(AnyOf(tuple(Not(n) for n in nodes)), scene, among)
        case Not(AnyOf(nodes)):
            return judge(AllOf(tuple(Not(n) for n in nodes)), scene, among)
        case Not(inner):
            of = judge(inner, scene, among)
            graded = isinstance(inner, Named | Class | Moved | Movable)
            return Truth(of.no, of.yes, 1 - of.strength if graded else of.strength, lambda row: f"not: {of.why(row)}")
        case AllOf(nodes):
            return _all(nodes, scene, among)
        case AnyOf(nodes):
            return _any([judge(n, scene, among) for n in nodes], len(scene.elements))


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


def _near(node: Near, scene: Scene, among: Bools | None) -> Truth:
    metres = scene.near_m if node.metres is None else node.metres
    targets = _targets(node.target, scene)
    distance, name = distances(targets, scene, _rows(scene, among), metres)
    known = _related(scene, targets) & ~np.isnan(distance)

    def why(row: int) -> str:
        d = float(distance[row])
        return f"{d:.2f} m from {name(row)}" if d < np.inf else f"none such within {metres:g} m"

    return crisp(distance <= metres, known, why)


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
        return crisp(known, np.zeros_like(known), lambda row: "")  # noqa: ARG005
    points = scene.elements.positions
    if targets is None:
        assert scene.T_world_cam is not None
        ahead = (points - scene.T_world_cam[:3, 3].astype(np.float32)) @ way.astype(np.float32)
        return crisp(
            ahead > half_width(scene.elements.extents, way),
            known,
            lambda row: f"{ahead[row]:.2f} m {SIDES[node.relation]} the camera",
        )
    which = on_side(points, np.asarray(values(scene, "size_m"), np.float32), targets, _rows(scene, among), way)

    def why(row: int) -> str:
        return f"{SIDES[node.relation]} {scene.name(int(which[row])) if which[row] >= 0 else 'none'}"

    return crisp(which >= 0, known, why)
