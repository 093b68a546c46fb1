"""Grammar of what stands before the heart of a predicate: "could not be", "did", "somebody currently"."""

from __future__ import annotations

from dataclasses import dataclass, replace

from vlmm_log.pipeline.language.cursor import Cursor
from vlmm_log.pipeline.language.measures import present
from vlmm_log.query_tree import Span


@dataclass(frozen=True)
class Lead:
    """What stands before the heart of a predicate: "could not be", "did", "somebody"."""

    negate: bool = False
    can: bool = False
    be: bool = False
    finite: bool = False  # an auxiliary or modal of its own
    do: bool = False
    have: bool = False
    agent: str = ""
    span: Span | None = None  # "currently", "just"
    inner: int = 0  # clauses of targets that it lies within


NOTHING = Lead()


def lead(c: Cursor, carried: Lead) -> Lead:
    """All words before the heart; ``can`` is carried on until another auxiliary ends it ("can be lifted or moved")."""
    now = auxiliaries(c, replace(carried, finite=False, negate=False, span=None))
    while agent := _agent_here(c):
        c.skip("det")
        c.take()
        now = auxiliaries(c, replace(now, agent=agent))
    return now


def auxiliaries(c: Cursor, now: Lead) -> Lead:
    """Auxiliaries, modals, negations and adverbs; those of a question come before its subject."""
    while True:
        aux, neg, modal = c.value("aux"), c.value("neg"), c.value("modal")
        if c.has("seen") and (doing := _seen_doing(c, now)):
            now = doing
            continue
        if aux is not None:
            own = aux != "part"
            ended = own and not now.finite
            be, do, have = now.be or aux in ("be", "part"), now.do or aux == "do", now.have or aux == "have"
            now = replace(now, be=be, do=do, have=have, finite=now.finite or own, can=now.can and not ended)
        elif neg in ("not", "no") or (neg == "without" and c.has("dynamic", "verb", ahead=1)):
            now = replace(now, negate=not now.negate)
        elif modal in ("can", "can be") or (modal == "to" and c.has("verb", "aux", ahead=1)):
            now = replace(now, can=True, finite=True, be=now.be or modal == "can be")
        elif now.span is None and (span := present(c)):
            now = replace(now, span=span)
            continue
        elif not c.has("stop", "adverb"):
            return now
        # "may not have moved": whether it could, or whether it did
        c.take("unparsed" if aux == "have" and now.can and now.negate else "structure")


def _seen_doing(c: Cursor, now: Lead) -> Lead | None:
    """ "seen to have moved", "seen moving", "never seen near the door" say what follows, no more; None elsewhere."""
    start = c.at
    c.take()
    negate = now.negate != (c.accept("neg") is not None)
    told = c.value("modal") == "to" and c.take() is not None
    negate = negate != (told and c.accept("neg") is not None)
    be = False
    while told and (aux := c.accept("aux")):
        be = aux == "part"
    if c.has("verb", "stay", "still", "dynamic", "movable", "relation", "my_side"):
        return replace(now, negate=negate, be=be, can=False, do=False)
    c.at = start
    return None


def _agent_here(c: Cursor) -> str:
    """Who acts in "a robot could lift", "somebody pushed", as the lexicon's kind; "" where nobody does.

    A map does not hold who moved what: "the chair the robot pushed" has an agent that must be told as not understood.
    """
    ahead = 1 if c.has("det") and not c.has("agent") else 0
    value = c.value("agent", ahead)
    general = c.has("modal", ahead=ahead + 1) or c.value("verb", ahead + 1) in ("base", "third")
    acts = general if value == "noun" else c.has("aux", "modal", "verb", "neg", "adverb", ahead=ahead + 1)
    return value if value and acts else ""
