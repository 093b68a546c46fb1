"""A query's filter tree in words."""

from __future__ import annotations

from vlmm_log.queries import Order, Query
from vlmm_log.query_tree import AllOf, AnyOf, Class, Compare, Movable, Moved, Named, Near, Node, Not, Seen, Side

SIDES = {
    "left": "left of",
    "right": "right of",
    "above": "above",
    "below": "below",
    "front": "in front of",
    "behind": "behind",
}


def explain(query: Query) -> str:
    """What a query was taken to ask for, in one line, and the words of it that were not understood."""
    parts = [f"{query.returns}: {in_words(query.filter)}"]
    if query.order:
        parts.append(f"ranked by {_order(query.order)}")
    if query.limit:
        parts.append(f"at most {query.limit}")
    if query.unparsed:
        parts.append("NOT UNDERSTOOD: " + ", ".join(f"'{word}'" for word in query.unparsed))
    return "; ".join(parts)


def _order(order: Order) -> str:
    of = f" to {_inner(order.target)}" if order.target else ""
    return f"{order.field}{of}, {'highest' if order.direction == 'most' else 'lowest'} first"


def in_words(node: Node) -> str:
    """A tree in words."""
    match node:
        case Named(text):
            return f"named {text!r}"
        case Class(motion_class):
            return f"motion_class = {motion_class}"
        case Moved(t0_s, t1_s):
            return "moved" + _span(t0_s, t1_s)
        case Seen(t0_s, t1_s):
            return "seen" + _span(t0_s, t1_s)
        case Movable():
            return "movable (rho >= rho_tau)"
        case Compare(field, op, value):
            return f"{field} {op} {value:g}"
        case Near(target, metres):
            return f"{'near' if metres is None else f'within {metres:g} m of'} {_inner(target)}"
        case Side(relation, target):
            return f"{SIDES[relation]} {_inner(target)}"
        case Not(inner):
            return f"not {_inner(inner)}"
        case AllOf(nodes):
            return " and ".join(_inner(n) for n in nodes) or "any element"
        case AnyOf(nodes):
            return " or ".join(_inner(n) for n in nodes) or "no element"


def _inner(node: Node | None) -> str:
    """In brackets where words alone would not say what belongs together."""
    if node is None:
        return "the camera"
    several = isinstance(node, AllOf | AnyOf) and len(node.nodes) > 1
    return f"({in_words(node)})" if several else in_words(node)


def _span(t0_s: float | None, t1_s: float | None) -> str:
    if t0_s is None and t1_s is None:
        return ""
    return f" from {_time(t0_s, 'the start')} to {_time(t1_s, 'the end')}"


def _time(t: float | None, open_end: str) -> str:
    if t is None:
        return open_end
    return f"{t:g} s" if t >= 0 else f"{-t:g} s before the end"
