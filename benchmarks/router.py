"""How often a query is routed to the right intent, by the paper's router and by the default parser.

    python -m benchmarks.router

Every section of benchmarks/queries/*.toml is a row: queries whose intent and noun are right, that were told as not
understood (the paper's router never does), and that were answered wrongly with nothing told. A noun is right when it is
the expected one up to its number.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path

from vlmm_log.pipeline.language.parser import parse
from vlmm_log.pipeline.language.router import route
from vlmm_log.pipeline.language.words import singular
from vlmm_log.queries import Query
from vlmm_log.query_tree import AllOf, AnyOf, Class, Movable, Moved, Named, Node, Not

QUERIES = Path(__file__).parent / "queries"
PARSERS: dict[str, Callable[[str], Query]] = {"paper": route, "default": parse}


def leaves(node: Node, holds: bool = True) -> Iterator[tuple[Node, bool]]:
    """What is said of the elements themselves, and whether it is affirmed; targets of relations left out."""
    match node:
        case Not(inner):
            yield from leaves(inner, not holds)
        case AllOf(nodes) | AnyOf(nodes):
            for each in nodes:
                yield from leaves(each, holds)
        case _:
            yield node, holds


def intent(query: Query) -> str:
    """Which of the paper's three intents a query has: the first that its tree speaks of; or none."""
    for node, holds in leaves(query.filter):
        match node:
            case Moved() | Class("moving"):
                return "moving" if holds else "static"
            case Movable():
                return "movable" if holds else "static"
            case Class("static"):
                return "static" if holds else "moving"
    return "movable" if query.order and query.order.field == "rho" else "none"


def noun(query: Query) -> str:
    """The names that a query affirms."""
    return " ".join(node.text for node, holds in leaves(query.filter) if isinstance(node, Named) and holds)


def same_noun(a: str, b: str) -> bool:
    """Equal up to the number of the words."""
    return [singular(word) for word in a.lower().split()] == [singular(word) for word in b.lower().split()]


def sections() -> dict[str, list[dict[str, str]]]:
    """Queries with what is expected of them, by section."""
    tables = [tomllib.loads(path.read_text("utf-8")) for path in sorted(QUERIES.glob("*.toml"))]
    return {name: table["queries"] for each in tables for name, table in each.items()}


def verdict(query: Query, expected: dict[str, str]) -> str:
    """ "right": intent and noun; "refused": told as not understood; "wrong": answered, and nothing told."""
    if query.unparsed:
        return "refused"
    return "right" if intent(query) == expected["intent"] and same_noun(noun(query), expected["noun"]) else "wrong"


def score(name: str, queries: list[dict[str, str]], parser: str) -> list[str]:
    """Print a row; give what is not right."""
    parsed = [(PARSERS[parser](expected["text"]), expected) for expected in queries]
    verdicts = [verdict(query, expected) for query, expected in parsed]
    intents = sum(intent(query) == expected["intent"] for query, expected in parsed)
    counts = [*(verdicts.count(v) for v in ("right", "refused", "wrong")), intents]
    n = len(queries)
    print(f"{name:10s} {parser:8s} {n:3d}  " + "  ".join(f"{count:3d} ({count / n:4.0%})" for count in counts))
    return [
        f"  {name:10s} {parser:8s} {v:8s} {e['text']!r}: {intent(q)} {noun(q)!r}, expected {e['intent']} {e['noun']!r}"
        + (f", not understood: {', '.join(q.unparsed)}" if q.unparsed else "")
        for (q, e), v in zip(parsed, verdicts, strict=True)
        if v != "right"
    ]


def main() -> None:
    print("section    parser   of   right       refused     wrong       intent right, refused or not")
    missed = [line for name, queries in sections().items() for p in PARSERS for line in score(name, queries, p)]
    print("\nnot right:" if missed else "\nall are right")
    print("\n".join(missed))


if __name__ == "__main__":
    main()
