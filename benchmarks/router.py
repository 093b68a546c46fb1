"""How often a query is routed to the right intent, by the paper's router and by the default parser.

    python -m benchmarks.router

Every section of benchmarks/queries/*.toml is a row. A noun is right when it is the expected one up to its number.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path

from vlmm_log.pipeline.query_parser import parse
from vlmm_log.pipeline.query_router import route
from vlmm_log.pipeline.query_words import singular
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


def score(name: str, queries: list[dict[str, str]], parser: str) -> list[str]:
    """Print a row; give what went wrong."""
    wrong, intents, nouns = [], 0, 0
    for expected in queries:
        query = PARSERS[parser](expected["text"])
        found, named = intent(query), noun(query)
        right = found == expected["intent"]
        whole = right and same_noun(named, expected["noun"]) and not query.unparsed
        intents, nouns = intents + right, nouns + whole
        if not whole:
            told = f", told as not understood: {', '.join(query.unparsed)}" if query.unparsed else ""
            want = f"{expected['intent']} {expected['noun']!r}"
            wrong.append(f"  {name:10s} {parser:8s} {expected['text']!r}: {found} {named!r}, expected {want}{told}")
    n = len(queries)
    print(
        f"{name:10s} {parser:8s} {intents:3d} of {n:3d} ({intents / n:4.0%})  {nouns:3d} of {n:3d} ({nouns / n:4.0%})"
    )
    return wrong


def main() -> None:
    print("section    parser   intent right       intent and noun right")
    wrong = [line for name, queries in sections().items() for p in PARSERS for line in score(name, queries, p)]
    print("\nwrong:" if wrong else "\nnone is wrong")
    print("\n".join(wrong))


if __name__ == "__main__":
    main()
