"""A language model as the query parser: it emits the filter tree of vlmm_log.queries, which is checked as any other."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Protocol

from vlmm_log.queries import Order, Query, from_json, to_json
from vlmm_log.query_tree import (
    CLASSES,
    FIELDS,
    OPS,
    RELATIONS,
    AllOf,
    AnyOf,
    Compare,
    Movable,
    Moved,
    Named,
    Near,
    Not,
    Side,
)
from vlmm_log.types import InputError

EXAMPLES = {
    "the three fastest chairs that are not near the door, after 3 s": Query(
        AllOf((Named("chair"), Moved(3.0), Not(Near(Named("door"))))), Order("speed"), 3
    ),
    "how many cups or mugs left of the monitor could I pick up": Query(
        AllOf((AnyOf((Named("cup"), Named("mug"))), Side("left", Named("monitor")), Movable())), returns="count"
    ),
    "things my brother bought, seen at least 5 times, that never moved": Query(
        AllOf((Compare("observations", ">=", 5.0), Not(Moved()))), unparsed=("my brother bought",)
    ),
}


class Asks(Protocol):
    """What the parser asks of an Endpoint."""

    where: str

    def ask(self, system: str, user: str) -> str:
        """The model's answer."""
        ...


class LlmParser:
    """A query parser that asks an endpoint."""

    def __init__(self, endpoint: Asks) -> None:
        self.endpoint = endpoint

    def __call__(self, text: str) -> Query:
        """The query of a user's words. An answer that is no query is asked for once more, with what is wrong.

        Raises EndpointError where the endpoint gives no answer, and InputError where it gives no query twice.
        """
        if not text.strip():
            raise InputError("query: no words; say what to look for")
        Query(AllOf(), text=text)  # too long a text is refused before it is sent
        asked = json.dumps({"query": text}, ensure_ascii=False)
        first = self.endpoint.ask(PROMPT, asked)
        try:
            return replace(from_json(first), text=text)
        except InputError as e:
            wrong = str(e)
        second = self.endpoint.ask(PROMPT, f"{asked}\nYour last answer was refused: {wrong}\nAnswer once more.")
        try:
            return replace(from_json(second), text=text)
        except InputError as e:
            raise InputError(f"{self.endpoint.where}: answered no query twice ({e}); use query.parser=default") from e


def _prompt() -> str:
    worked = "\n".join(f"{json.dumps({'query': text})}\n{to_json(query)}" for text, query in EXAMPLES.items())
    return f"""{FORM}
Worked examples:
{worked}"""


FORM = f"""You turn a question about objects in a mapped room into a filter. Answer with one JSON object, no more:
{{"filter": NODE, "order": ORDER or null, "limit": whole number or null, "returns": "objects", "mask" or "count",
 "unparsed": [words of the question that the filter leaves out]}}
NODE is one of
{{"type": "all", "nodes": [NODE, ...]}}: every one holds; with no node: any object
{{"type": "any", "nodes": [NODE, ...]}}: at least one holds
{{"type": "not", "node": NODE}}
{{"type": "named", "text": "office chair"}}: what it is, singular
{{"type": "moved", "t0_s": number or null, "t1_s": number or null}}: was seen to move, in that time
{{"type": "seen", "t0_s": number or null, "t1_s": number or null}}: was in view in that time
{{"type": "movable"}}: could be moved, carried, pushed
{{"type": "class", "motion_class": one of {", ".join(CLASSES)}}}: static is what is fixed or stays in place
{{"type": "compare", "field": FIELD, "op": one of {" ".join(OPS)}, "value": number}}
{{"type": "near", "target": NODE or null, "metres": number or null}}
{{"type": "side", "relation": one of {", ".join(RELATIONS)}, "target": NODE or null}}
A null target is the camera, a null metres the usual distance, a null time open. Times are seconds from the start; a \
negative one counts back from the end.
ORDER is {{"field": FIELD, "direction": "most" or "least", "target": NODE or null}}; only distance_m has a target.
FIELD is one of {", ".join(FIELDS)}: o is observed motion (1 for a still object), kappa its reliability, rho \
movability, score motion over all times, speed m/s, p_moving the probability that it has moved, motions how often it \
moved, moved_s for how long, first_s and last_s when it was seen, size_m, height_m along the upward axis, distance_m \
to the camera.
Return "mask" for a question of where, "count" for how many."""
PROMPT = _prompt()
