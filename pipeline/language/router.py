"""The paper's parser: a keyword intent router, exactly as printed (section "Query interface").

No negation, no composition: a wording outside the three sets is a purely semantic query, and it is not told. That is
the paper's own limit and profile ``paper`` keeps it; pipeline/language/parser.py says what it leaves out.
"""

from __future__ import annotations

import re
import tomllib
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

from vlmm_log.queries import Query
from vlmm_log.query_tree import AllOf, Class, Movable, Named, Node, refuse_long


@dataclass(frozen=True)
class Lists:
    """The router's word lists."""

    sets: tuple[tuple[str, tuple[str, ...]], ...]  # field's set and its phrases, in the order in which they are tested
    stop: frozenset[str]
    tokens: frozenset[str]  # move, moves, moving


@cache
def lists() -> Lists:
    """The lists of vlmm_log/data/query_paper.toml."""
    table = tomllib.loads((files("vlmm_log") / "data" / "query_paper.toml").read_text("utf-8"))
    sets = ((name, (*table[name]["printed"], *table[name]["ours"])) for name in ("prior", "static", "moving"))
    return Lists(tuple(sets), frozenset(table["stop"]["ours"]), frozenset(table["stop"]["tokens"]))


def route(text: str) -> Query:
    """The filter <s, field, ret> of a text. Raises InputError for a text of over 1000 characters.

    A phrase matches as a substring, as the paper's remark on "could move" implies; so "immovable" holds "movable"
    and routes to the prior.
    """
    refuse_long(text)
    lowered = " ".join(text.lower().replace("\u2019", "'").split())
    for name, phrases in lists().sets:
        if any(phrase in lowered for phrase in phrases):
            return _query(text, name, _residue(lowered, phrases))
    return _query(text, "", _residue(lowered, ()))


def _residue(lowered: str, phrases: tuple[str, ...]) -> str:
    """The semantic text: what is left when phrases, longest first, stop words and tokens are deleted."""
    for phrase in sorted(phrases, key=lambda p: (-len(p), p)):
        lowered = lowered.replace(phrase, " ")
    drop = lists().stop | lists().tokens
    return " ".join(word for word in re.findall(r"[\w'-]+", lowered) if word not in drop)


def _query(text: str, name: str, residue: str) -> Query:
    fields: dict[str, tuple[Node, ...]] = {"prior": (Movable(),), "static": (Class("static"),)}
    fields["moving"] = (Class("moving"),)
    nodes = (*([Named(residue)] if residue else []), *fields.get(name, ()))
    filter_ = nodes[0] if len(nodes) == 1 else AllOf(nodes)
    return Query(filter_, returns="mask" if name == "static" else "objects", text=text)
