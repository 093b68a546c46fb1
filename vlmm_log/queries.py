"""The nouns of language: a query as one typed filter tree, its JSON form, and its answer. numpy only.

JSON form (``to_json``, ``from_json``); a parser of any kind may emit it::

    {"filter": NODE, "order": ORDER or null, "limit": n or null, "returns": "objects" | "mask" | "count",
     "text": "the user's words", "unparsed": ["words of it that the filter leaves out"]}
    Only the filter is required.

    NODE is one of
    {"type": "all", "nodes": [NODE, ...]}          every one holds; with no node: any element at all
    {"type": "any", "nodes": [NODE, ...]}          at least one holds
    {"type": "not", "node": NODE}
    {"type": "named", "text": "office chair"}      what it is, in any words, singular
    {"type": "moved", "t0_s": 3, "t1_s": 5}        was seen to move; the times are optional (null: open)
    {"type": "seen", "t0_s": 3, "t1_s": null}      was in view at some time between
    {"type": "movable"}                            could be moved, by the movability prior
    {"type": "class", "motion_class": "moving"}    the fused class: "moving", "movable_static" or "static"
    {"type": "compare", "field": "speed", "op": ">", "value": 0.5}     op: < <= = >= >
    {"type": "near", "target": NODE, "metres": 1}  metres optional; target null: the camera
    {"type": "side", "relation": "left", "target": NODE}   left, right, above, below, front, behind;
                                                           target null: the camera
    ORDER ranks the answers: {"field": "speed", "direction": "most" | "least", "target": NODE or null};
    a target goes only with distance_m, null: the camera.

    Times are seconds from the map's first stamp; a negative one counts back from its last.
    Fields: o (observed motion, 1 for a still thing), kappa (its reliability), rho (movability prior), confidence (of
    the class), p_stat (static-consistency p-value), score (kappa-weighted o), speed (m/s, of what moved),
    p_moving (probability that it has moved, in calibrated maps), observations, pixels, motions (how often it moved),
    moved_s (for how long), first_s, last_s, size_m, height_m, distance_m (to the camera).

    "the three fastest chairs that are not near the door, after 3 s":
    {"filter": {"type": "all", "nodes": [{"type": "named", "text": "chair"}, {"type": "moved", "t0_s": 3},
        {"type": "not", "node": {"type": "near", "target": {"type": "named", "text": "door"}}}]},
     "order": {"field": "speed", "direction": "most"}, "limit": 3}
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, fields
from typing import Any

from vlmm_log.query_tree import (
    FIELDS,
    KINDS,
    MAX_DEPTH,
    MAX_NODES,
    MAX_TEXT,
    Node,
    one_of,
    refuse,
    refuse_long,
    short,
    walk,
)
from vlmm_log.types import Float32, Float64, InputError, Int64, freeze

RETURNS = ("objects", "mask", "count")
MAX_JSON = 100_000  # characters


@dataclass(frozen=True)
class Order:
    """What answers are ranked by."""

    field: str  # of FIELDS
    direction: str = "most"  # or "least"
    target: Node | None = None  # of distance_m; None: the camera

    def __post_init__(self) -> None:
        one_of("field", self.field, FIELDS)
        one_of("direction", self.direction, ("most", "least"))
        if self.target is not None and self.field != "distance_m":
            refuse(f"an order by {self.field} has no target; only distance_m has")


@dataclass(frozen=True)
class Query:
    """What is asked for."""

    filter: Node
    order: Order | None = None  # None: by how well the filter holds
    limit: int | None = None  # None: query.limit
    returns: str = "objects"  # of RETURNS
    text: str = ""  # the user's words
    unparsed: tuple[str, ...] = ()  # those that the tree leaves out; not empty: warn or refuse

    def __post_init__(self) -> None:
        one_of("returns", self.returns, RETURNS)
        if self.limit is not None and not 1 <= self.limit < 2**31:
            refuse(f"limit is {self.limit}; it must be at least 1")
        refuse_long(self.text)
        for count, (_, depth) in enumerate(walk(self.filter), start=1):
            if count > MAX_NODES or depth > MAX_DEPTH:
                refuse(f"the filter has over {MAX_NODES} nodes or {MAX_DEPTH} levels; ask for less at once")
        if self.order and self.order.target:
            Query(self.order.target)  # the same limits


@dataclass(frozen=True, eq=False)
class View:
    """From where and when a query is asked."""

    T_world_cam: Float64 | None = None  # (4, 4) of the last keyframe; None: sides and camera distances are unknown
    up: str = "+z"  # axis of the world that points up, see protocols.Log.world_up
    origin_ns: int | None = None  # time zero of a query; None: the map's first stamp


@dataclass(frozen=True, eq=False)
class Answer:
    """Elements that a query asks for, the best first."""

    text: str  # of the query
    explanation: str  # the filter tree in words, what could not be parsed, what could not be decided
    returns: str  # "objects", "mask" or "count"
    ids: Int64  # (m,)
    scores: Float32  # (m,) what they are ranked by: the order's field, else how well the filter holds, in [0, 1]
    reasons: tuple[str, ...]  # (m,) why each is an answer, with the field values that decided
    matches: int = 0  # how many elements match: m, or more where the limit cut

    def __post_init__(self) -> None:
        freeze(self)


def to_json(query: Query) -> str:
    """The query as JSON, in the module's form."""
    return json.dumps(_plain(query), allow_nan=False)


def from_json(text: str) -> Query:
    """The query of a JSON text in the module's form. Raises InputError naming the place."""
    if len(text) > MAX_JSON:
        refuse(f"JSON of {len(text)} characters; at most {MAX_JSON}")
    try:
        value = json.loads(text, parse_constant=lambda name: refuse(f"JSON: {name} is no number"))
    except (ValueError, RecursionError) as e:
        raise InputError(f"query: not JSON: {str(e)[:80] or 'too deep'}") from e
    query: Query = _record(Query, value, "query", 0)
    return query


def _plain(value: object) -> object:
    if isinstance(value, tuple):
        return [_plain(v) for v in value]
    if not hasattr(value, "__dataclass_fields__"):
        return value
    kind = next(({"type": name} for name, k in KINDS.items() if type(value) is k), {})
    return {**kind, **{f.name: _plain(getattr(value, f.name)) for f in fields(value)}}  # type: ignore[arg-type]


def _record(kind: type[Any], value: object, where: str, depth: int) -> Any:
    """An instance from a JSON object whose names are the dataclass's fields."""
    known = {f.name: f for f in fields(kind)}
    if not isinstance(value, dict):
        refuse(f"{where} is {short(value)}, not an object")
    for name in value:
        if name not in known and not (name == "type" and kind in KINDS.values()):
            refuse(f"{where} has no {short(name)}; it has {', '.join(known) or 'only a type'}")
    missing = [n for n, f in known.items() if n not in value and f.default is MISSING]
    if missing:
        refuse(f"{where} lacks {', '.join(missing)}")
    read = {n: _READ[str(f.type)](value[n], f"{where}.{n}", depth) for n, f in known.items() if n in value}
    return kind(**read)


def _node(value: object, where: str, depth: int) -> Node:
    if depth >= MAX_DEPTH:
        refuse(f"the filter has over {MAX_DEPTH} levels; ask for less at once")
    kind = value.get("type") if isinstance(value, dict) else None
    if not isinstance(kind, str) or kind not in KINDS:
        refuse(f"{where} is {short(value)}, not an object with a type of {', '.join(KINDS)}")
    node: Node = _record(KINDS[kind], value, where, depth + 1)
    return node


def _nodes(value: object, where: str, depth: int) -> tuple[Node, ...]:
    if not isinstance(value, list) or len(value) > MAX_NODES:
        refuse(f"{where} is {short(value)}, not a list of at most {MAX_NODES} nodes")
    return tuple(_node(v, f"{where}[{i}]", depth) for i, v in enumerate(value))


def _str(value: object, where: str, depth: int) -> str:  # noqa: ARG001
    return value if isinstance(value, str) else refuse(f"{where} is {short(value)}, not a text")


def _texts(value: object, where: str, depth: int) -> tuple[str, ...]:
    if not isinstance(value, list) or len(value) > MAX_TEXT:
        refuse(f"{where} is {short(value)}, not a list of texts")
    return tuple(_str(v, where, depth) for v in value)


def _int(value: object, where: str, depth: int) -> int:  # noqa: ARG001
    return value if type(value) is int else refuse(f"{where} is {short(value)}, not a whole number")


def _float(value: object, where: str, depth: int) -> float:  # noqa: ARG001
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e300:
        refuse(f"{where} is {short(value)}, not a finite number")
    return float(value)


def _order(value: object, where: str, depth: int) -> Order:
    order: Order = _record(Order, value, where, depth)
    return order


def _or_none(read: Callable[[object, str, int], object]) -> Callable[[object, str, int], object]:
    return lambda value, where, depth: None if value is None else read(value, where, depth)


_READ: Mapping[str, Callable[[object, str, int], object]] = {
    "str": _str,
    "float": _float,
    "Node": _node,
    "tuple[Node, ...]": _nodes,
    "tuple[str, ...]": _texts,
    "Node | None": _or_none(_node),
    "float | None": _or_none(_float),
    "int | None": _or_none(_int),
    "Order | None": _or_none(_order),
}
