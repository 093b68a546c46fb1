"""Grammar of quantities: numbers with units, time spans, comparisons of a field with a number."""

from __future__ import annotations

import math
from dataclasses import dataclass

from vlmm_log.pipeline.language.cursor import Cursor
from vlmm_log.query_tree import Compare, Node, Span

DIMENSIONS = {
    **dict.fromkeys(("size_m", "height_m", "distance_m"), "length"),
    **dict.fromkeys(("moved_s", "first_s", "last_s"), "time"),
    "speed": "speed",
}
LARGEST = 1e9
NOW: Span = (-1.0, None)
"""The present: a map holds what was seen, so it is the last second before its end."""
JUST: Span = (-5.0, None)
"""What "just" speaks of."""


@dataclass(frozen=True)
class Quantity:
    """A number in metres, seconds, m/s or of no unit."""

    value: float
    dimension: str  # "length", "time", "speed" or ""


def quantity(c: Cursor) -> Quantity | None:
    """A number, with its unit if it has one."""
    token = c.peek()
    if token.kind == "clock":
        c.take()
        return Quantity(token.number, "time")
    value = number_here(c)
    if not value < LARGEST:
        return None
    c.take()
    unit = c.accept("unit")
    if unit is None:
        return Quantity(value, "")
    dimension, factor = unit.split()
    return Quantity(value * float(factor), dimension)


def number_here(c: Cursor) -> float:
    """The value of a number in digits or words; NaN where there is none."""
    named = c.value("number")
    return float(named) if named else c.peek().number if named is not None else math.nan


def time_spans(c: Cursor) -> tuple[Span, ...]:
    """Seconds from "between 10 s and 12 s", "in the first 2 seconds or after 5 s", "now"; () where there are none.

    Times joined by "and" may mean in each or in either of them, and what is said behind the last may be of it alone:
    that is told.
    """
    start = c.at
    c.skip("stop")
    span = present(c) or _span(c, c.accept("time"))
    if span is None:
        c.at = start
        return ()
    spans = [span]
    while (at := c.at) and (joint := c.accept("conj")):
        denied = c.accept("neg") is not None
        other = _span(c, c.accept("time")) if c.has("time") else None
        if other is None:
            c.at = at
            break
        if joint == "or" and not denied and (c.done or c.has("stop", "conj", "relation")):
            spans.append(other)
        else:
            c.tell(at)
    return tuple(spans)


def present(c: Cursor) -> Span | None:
    """What "now", "currently", "still moving" and "just moved" speak of; None where none of them is."""
    value, text = c.value("present"), c.peek().text
    before_a_verb = c.value("verb", 1) in ("base", "past") or c.value("aux", 1) == "part"
    before_a_predicate = before_a_verb or c.has("verb", "movable", "relation", "dynamic", ahead=1)
    if value is None or (text == "just" and not before_a_verb) or (text == "still" and not before_a_predicate):
        return None
    c.take()
    return NOW if value == "now" else JUST


def _span(c: Cursor, word: str | None) -> Span | None:
    if word in ("between", "from"):
        return _from_to(c, word)
    if word in ("after", "before", "at"):
        t = _seconds(c)
        spans = {"after": (t, None), "before": (0.0, t), "at": (t, t)}
        return None if t is None else spans[word]
    if word in ("in", "within"):
        c.skip("det")
        edge = c.accept("edge")
        t = _seconds(c) if edge else None
        return None if not t else (0.0, t) if edge == "first" else (-t, None)
    return None


def _from_to(c: Cursor, word: str) -> Span | None:
    first = quantity(c)
    joined = c.accept("conj") == "and" if word == "between" else c.accept("from_", "time") is not None
    if first and word == "from" and not joined:
        return (first.value, None) if first.dimension == "time" else None
    last = quantity(c) if joined else None
    if not first or not last or last.dimension != "time" or first.dimension not in ("time", ""):
        return None
    unit = c.value("unit", -1)  # "between 1 and 2 minutes": the first has the unit of the last
    t0 = first.value * (float(unit.split()[1]) if unit and not first.dimension else 1.0)
    return (t0, last.value) if t0 <= last.value else None


def _seconds(c: Cursor) -> float | None:
    t = quantity(c)
    return t.value if t and t.dimension == "time" else None


def comparison(c: Cursor) -> Node | None:
    """ "faster than 1 m/s", "rho above 0.8", "more than 5 observations", "seen at least 3 times", "in 3 frames"."""
    start = c.at
    c.accept("having")
    begin = c.at
    node = _comparative(c) or _field_first(c, begin) or _number_first(c, begin)
    if node is None:
        c.at = start
    return node


def _comparative(c: Cursor) -> Node | None:
    """ "faster than 1 m/s"."""
    named = c.accept("comparative")
    if named is None:
        return None
    field, op = named.split()
    return _checked(field, op, quantity(c))


def _field_first(c: Cursor, start: int) -> Node | None:
    """ "rho above 0.8", "a speed of at least 1 m/s"."""
    c.at = start
    c.skip("det")
    field = c.accept("field")
    if field is None:
        return None
    c.skip("aux", "of", "stop")
    op = operator(c)
    return _checked(field, op, quantity(c)) if op else None


def _number_first(c: Cursor, start: int) -> Node | None:
    """ "more than 5 observations", "more than 5 times seen", "seen 5 times"."""
    c.at = start
    seen = c.accept("seen")
    if seen:
        c.skip("time")
    op, number = operator(c) or "=", times(c)
    if number is not None:
        return Compare("observations", op, number) if seen or c.accept("seen") else None
    counted = quantity(c)
    field = c.accept("field")
    return _checked(field, op, counted) if field and not seen else None


def _checked(field: str, op: str, number: Quantity | None) -> Node | None:
    """The comparison, where the number's unit is one of the field."""
    if number is None or number.dimension not in ("", DIMENSIONS.get(field, "")):
        return None
    return Compare(field, op, number.value)


def operator(c: Cursor) -> str | None:
    """ "at least", "above"; None where there is none."""
    named = c.accept("op")
    if named is None and c.value("relation") in ("above", "below"):
        named = ">" if c.take() and c.value("relation", -1) == "above" else "<"
    return named


def times(c: Cursor) -> float | None:
    """The number of "5 times", "twice"."""
    often = c.accept("how_often")
    if often is not None:
        return float(often)
    start = c.at
    number = quantity(c)
    if number and not number.dimension and c.accept("times"):
        return number.value
    c.at = start
    return None


def after_motion(c: Cursor) -> Node | None:
    """What a verb of motion is said to have: "faster than 1 m/s", "for more than 3 s", "more than twice"."""
    start = c.at
    lasted = c.accept("duration")
    if lasted:
        t = _seconds(c)
        op = {"for": ">=", "longer": ">", "shorter": "<", "least": ">=", "most": "<="}[lasted]
        node: Node | None = Compare("moved_s", op, t) if t is not None else None
    elif c.has("comparative") and (c.value("comparative") or "").startswith("speed"):
        node = _comparative(c)
    else:
        op, number = operator(c) or "=", times(c)
        node = Compare("motions", op, number) if number is not None else None
    if node is None:
        c.at = start
    return node
