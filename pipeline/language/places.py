"""Grammar of places: "left of the monitor", "within 1 m of the door", "nearest to me"."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from vlmm_log.pipeline.language.asked import Asked
from vlmm_log.pipeline.language.cursor import Cursor
from vlmm_log.pipeline.language.measures import operator, quantity
from vlmm_log.pipeline.language.nouns import joined, noun_phrase, starts_phrase
from vlmm_log.pipeline.language.words import is_plural
from vlmm_log.query_tree import Near, Node, Not, Side, both, either

SINGULAR_VERBS = ("is", "isn't", "was", "wasn't", "has", "hasn't", "does", "doesn't")
PLURAL_VERBS = ("are", "aren't", "were", "weren't", "have", "haven't", "do", "don't")
Clause = Callable[[], Node | None]


def place(c: Cursor, clause: Clause) -> Node | None:
    """ "left of the monitor", "within 1 m of the door", "on my left".

    ``clause`` reads what is said of the target: "near the door that opened". Near the door and the window is near
    both; on the table and the shelf is on either.
    """
    side = c.accept("my_side")
    if side:
        return Side(side)
    start, on = c.at, c.value("relation") == "on"
    make = _within_metres(c) or _relation(c)
    c.skip("stop")
    found = targets(c, clause) if make else []
    if make is None or not found:
        c.at = start
        return None
    c.behind_target = c.at
    if on and None not in found:
        return make(either([node for node in found if node is not None]))
    return both(*(make(node) for node in found))


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


def targets(c: Cursor, clause: Clause) -> list[Node | None]:
    """The other elements of a relation that must hold for each of them, None: the camera; [] where none follows.

    "The door or the window" is one. A noun that may as well begin anew ("near the door and cups") is told.
    """
    start, first = c.at, _target(c, clause)
    if first is None or first.asks:
        c.at = start
        return []
    found, joints, at = [first], set[str](), c.at
    while c.has("conj") and c.value("conj") != "but" and not c.has("rel", ahead=1):
        comma = c.value("conj") == "comma" and not c.has("conj", ahead=1)
        joint = joined(c) or ""
        following = _target(c, clause) if c.has("camera") or starts_phrase(c) else None
        if following is None or (comma and following.determined != first.determined):
            c.at = at  # a list that goes on: "chairs near the door, tables"
            break
        anew = comma or following.determined < first.determined or joints - {joint}
        either_camera = joint in ("or", "nor") and None in (first.node, following.node)
        if anew or either_camera or following.asks:
            c.tell(at)
        else:
            found.append(following)
            joints.add(joint)
        at = c.at
    c.target_determined = first.determined
    nodes = [each.node for each in found]
    return [either([node for node in nodes if node is not None])] if joints and joints <= {"or", "nor"} else nodes


@dataclass(frozen=True)
class Target:
    """The other element of a relation."""

    node: Node | None  # None: the camera
    determined: bool = True  # "the door", not "doors"
    asks: bool = False  # for what a target cannot: an order, a number


def _target(c: Cursor, clause: Clause) -> Target | None:
    start = c.at
    every = c.value("det") == "every"  # "near every chair"
    c.skip("det")
    if c.has("camera"):
        c.take()
        return Target(None)
    c.at = start
    phrase = noun_phrase(c)
    if phrase is None:
        return None
    own = clause() if not phrase.nodes or (c.has("rel") and _agrees(c)) else None  # "near something that moved"
    if own is None and not phrase.nodes:
        c.at = start
        return None
    return Target(both(*phrase.nodes, *([own] if own else [])), phrase.determined, every or phrase.asked != Asked())


def _agrees(c: Cursor) -> bool:
    """Whether a relative clause may be the target's by number; "things near the person that are" speaks of things."""
    verb, noun = c.peek(1).text, c.peek(-1).text
    return verb not in (SINGULAR_VERBS if is_plural(noun) else PLURAL_VERBS)


def ranked_to(c: Cursor, asked: Asked, clause: Clause) -> bool:
    """ "to the door", "to me" behind "nearest"; False where there is none, or more than one."""
    if not asked.order or asked.order.field != "distance_m" or asked.order.target:
        return False
    start = c.at
    of_those = c.has("of")  # "the nearest of the cups"
    c.skip("from_")
    found = [] if of_those else targets(c, clause)
    if len(found) != 1 or c.at == start:
        c.at = start
        return False
    c.behind_target = c.at
    asked.order = replace(asked.order, target=found[0])
    return True
