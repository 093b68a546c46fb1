"""Grammar of places: "left of the monitor", "within 1 m of the door", "nearest to me"."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from vlmm_log.pipeline.query_cursor import Cursor
from vlmm_log.pipeline.query_measures import both, either, operator, quantity
from vlmm_log.pipeline.query_nouns import Asked, noun_phrase
from vlmm_log.query_tree import Near, Node, Not, Side

Clause = Callable[[], Node | None]


def place(c: Cursor, clause: Clause) -> Node | None:
    """ "left of the monitor", "within 1 m of the door", "on my left"; ``clause`` reads one that is all of a target."""
    side = c.accept("my_side")
    if side:
        return Side(side)
    start = c.at
    make = _within_metres(c) or _relation(c)
    c.skip("stop")
    found = target(c, clause) if make else None
    if make is None or found is None:
        c.at = start
        return None
    return make(found[0])


def _within_metres(c: Cursor) -> Callable[[Node | None], Node] | None:
    """ "within 1 m of", "more than 2 m from", "closer than 1 m to"."""
    start = c.at
    closer = c.value("comparative") or ""
    if closer.startswith("distance_m"):
        c.take()
        op: str | None = closer.split()[1]
    else:
        op = "<=" if c.accept("time") == "within" else None
        if op is None:
            c.at = start
            op = operator(c)
    reach = quantity(c) if op else None
    if op not in ("<", "<=", ">", ">=") or not reach or reach.dimension != "length" or not c.accept("from_"):
        c.at = start
        return None
    metres, inside = reach.value, op in ("<", "<=")
    return lambda node: Near(node, metres) if inside else Not(Near(node, metres))


def _relation(c: Cursor) -> Callable[[Node | None], Node] | None:
    passive = c.value("verb", -1) == "past"  # "moved by the robot": a map does not hold who moved what
    value = c.accept("relation") or ("near" if not passive and c.accept("by") else None)
    match value:
        case None:
            return None
        case "near":
            return Near
        case "far":
            return lambda node: Not(Near(node))
        case "on":  # on the table: above it, and not on the next floor
            return lambda node: Side("above", node) if node is None else both(Side("above", node), Near(node))
        case _:
            return lambda node: Side(value, node)


def target(c: Cursor, clause: Clause) -> tuple[Node | None] | None:
    """(the other element,) of a relation; (None,): the camera. None where neither follows."""
    start = c.at
    c.skip("det")
    if c.has("camera"):
        c.take()
        return (None,)
    c.at = start
    phrase = noun_phrase(c)
    if phrase is None or phrase.asked != Asked():
        c.at = start
        return None
    if phrase.nodes:
        return (either([phrase.node, *_alternatives(c)]),)
    own = clause()  # "near something that moved"
    if own is None:
        c.at = start
        return None
    return (own,)


def _alternatives(c: Cursor) -> list[Node]:
    """ "or the window" behind "the door"."""
    nodes: list[Node] = []
    while c.value("conj") == "or" and c.has("det", ahead=1):
        start = c.at
        c.take()
        phrase = noun_phrase(c)
        if phrase is None or not phrase.nodes or phrase.asked != Asked():
            c.at = start
            break
        nodes.append(phrase.node)
    return nodes


def ranked_to(c: Cursor, asked: Asked) -> bool:
    """ "to the door", "to me" behind "nearest"; False where there is none."""
    if not asked.order or asked.order.field != "distance_m" or asked.order.target:
        return False
    start = c.at
    c.skip("from_")
    found = target(c, lambda: None)
    if found is None or (c.at == start):
        c.at = start
        return False
    asked.order = replace(asked.order, target=found[0])
    return True
