"""The filter tree of a query: a closed set of frozen node types, made for ``match``.

A node that cannot be meant (an unknown field, a NaN, an empty name) raises InputError when it is made.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NoReturn

from vlmm_log.types import InputError

FIELDS = (
    *("o", "kappa", "rho", "confidence", "p_stat", "score", "speed", "p_moving", "observations", "pixels"),
    *("motions", "moved_s", "first_s", "last_s", "size_m", "height_m", "distance_m"),
)
"""What can be compared and ordered by. size_m is the diagonal of a box with the element's covariance."""

OPS = ("<", "<=", "=", ">=", ">")
RELATIONS = ("left", "right", "above", "below", "front", "behind")
CLASSES = ("static", "movable_static", "moving")
MAX_TEXT = 1000  # characters of a query
MAX_DEPTH, MAX_NODES = 24, 1024  # of a tree


@dataclass(frozen=True)
class Named:
    """The semantic feature is like that of the text (cosine at least theta_s)."""

    text: str

    def __post_init__(self) -> None:
        if not self.text.strip() or len(self.text) > MAX_TEXT:
            refuse(f"a name has 1 to {MAX_TEXT} characters")


@dataclass(frozen=True)
class Class:
    """The fused motion class."""

    motion_class: str  # of CLASSES

    def __post_init__(self) -> None:
        one_of("motion_class", self.motion_class, CLASSES)


@dataclass(frozen=True)
class Moved:
    """A motion interval touches [t0_s, t1_s]; with both ends open the class MOVING suffices too."""

    t0_s: float | None = None
    t1_s: float | None = None

    def __post_init__(self) -> None:
        _times(self.t0_s, self.t1_s)


@dataclass(frozen=True)
class Seen:
    """Its time in view, first to last, touches [t0_s, t1_s]."""

    t0_s: float | None = None
    t1_s: float | None = None

    def __post_init__(self) -> None:
        _times(self.t0_s, self.t1_s)


@dataclass(frozen=True)
class Movable:
    """The movability prior is at least rho_tau."""


@dataclass(frozen=True)
class Compare:
    """A field's value against a number."""

    field: str  # of FIELDS
    op: str  # of OPS
    value: float

    def __post_init__(self) -> None:
        one_of("field", self.field, FIELDS)
        one_of("op", self.op, OPS)
        _finite("value", self.value)


@dataclass(frozen=True)
class Near:
    """Within so many metres of another element that the target names, between positions."""

    target: Node | None = None  # None: the camera
    metres: float | None = None  # None: query.near_m

    def __post_init__(self) -> None:
        if self.metres is not None and not 0 <= self.metres < math.inf:
            refuse(f"metres is {self.metres}; it must be finite and not negative")


@dataclass(frozen=True)
class Side:
    """On that side of another element that the target names, as the camera sees it."""

    relation: str  # of RELATIONS
    target: Node | None = None  # None: of the camera itself

    def __post_init__(self) -> None:
        one_of("relation", self.relation, RELATIONS)


@dataclass(frozen=True)
class Not:
    """The node does not hold. What is unknown (a NaN, a side without a camera) holds neither way."""

    node: Node


@dataclass(frozen=True)
class AllOf:
    """Every node holds; with none: any element."""

    nodes: tuple[Node, ...] = ()


@dataclass(frozen=True)
class AnyOf:
    """At least one node holds; with none: no element."""

    nodes: tuple[Node, ...] = ()


Span = tuple[float | None, float | None]  # s, as in Moved and Seen
Node = Named | Class | Moved | Seen | Movable | Compare | Near | Side | Not | AllOf | AnyOf
KINDS: Mapping[str, type[Node]] = {
    "all": AllOf,
    "any": AnyOf,
    "not": Not,
    "named": Named,
    "moved": Moved,
    "seen": Seen,
    "movable": Movable,
    "class": Class,
    "compare": Compare,
    "near": Near,
    "side": Side,
}
"""Name of each kind in JSON."""


def walk(root: Node) -> Iterator[tuple[Node, int]]:
    """Every node of a tree with its depth, parents before children."""
    stack = [(root, 1)]
    while stack:
        node, depth = stack.pop()
        yield node, depth
        match node:
            case Near(target=child) | Side(target=child) if child is not None:
                stack.append((child, depth + 1))
            case Not(child):
                stack.append((child, depth + 1))
            case AllOf(nodes) | AnyOf(nodes):
                stack.extend((child, depth + 1) for child in reversed(nodes))
            case _:
                pass


def within(node: Node, spans: Sequence[Span]) -> Node:
    """The tree with its motions bound to any of the time spans; where it speaks of none, seen in any of them.

    What did not move in them must have been seen in each. Of alternatives each is bound.
    """
    bound = _bound(node, spans)
    return bound if bound != node else _seen(node, spans)


def _seen(node: Node, spans: Sequence[Span]) -> Node:
    return both(node, either([Seen(*span) for span in spans]))


def _bound(node: Node, spans: Sequence[Span], *, denied: bool = False) -> Node:
    match node:
        case Moved(None, None):
            return either([Moved(*span) for span in spans])
        case Not(inner):
            bound = _bound(inner, spans, denied=True)
            return node if bound == inner else both(Not(bound), *(Seen(*span) for span in spans))
        case AllOf(nodes):
            parts = tuple(_bound(n, spans, denied=denied) for n in nodes)
            return node if parts == nodes else both(*parts)
        case AnyOf(nodes):
            parts = tuple(_bound(n, spans, denied=denied) for n in nodes)
            if denied or parts == nodes:
                return AnyOf(parts)
            return AnyOf(tuple(_seen(n, spans) if p == n else p for n, p in zip(nodes, parts, strict=True)))
        case _:
            return node


def both(*nodes: Node) -> Node:
    """All of them, flat."""
    flat: list[Node] = []
    for node in nodes:
        flat += node.nodes if isinstance(node, AllOf) else [node]
    unique = tuple(dict.fromkeys(flat))
    return unique[0] if len(unique) == 1 else AllOf(unique)


def either(nodes: Sequence[Node]) -> Node:
    """Any of them."""
    unique = tuple(dict.fromkeys(nodes))
    return unique[0] if len(unique) == 1 else AnyOf(unique)


def negated(node: Node) -> Node:
    """Not the node."""
    return node.node if isinstance(node, Not) else Not(node)


def short(value: object) -> str:
    """A value as an error shows it."""
    return json.dumps(value, default=str)[:60]


def refuse(why: str) -> NoReturn:
    """Raise the InputError of a query that cannot be used."""
    raise InputError(f"query: {why}")


def refuse_long(text: str) -> None:
    """Raise InputError for a query's text of over MAX_TEXT characters."""
    if len(text) > MAX_TEXT:
        refuse(f"the text has {len(text)} characters; ask in at most {MAX_TEXT}")


def one_of(name: str, value: str, known: tuple[str, ...]) -> None:
    """Raise InputError unless the value is known."""
    if value not in known:
        refuse(f"{name} {short(value)} is none of {', '.join(known)}")


def _finite(name: str, value: float) -> None:
    if not abs(value) < math.inf:
        refuse(f"{name} is {value}; it must be finite")


def _times(t0_s: float | None, t1_s: float | None) -> None:
    for t in (t0_s, t1_s):
        _finite("a time", t or 0.0)
    if t0_s is not None and t1_s is not None and t0_s > t1_s and (t0_s < 0) == (t1_s < 0):
        refuse(f"the time span from {t0_s:g} s to {t1_s:g} s ends before it begins")
