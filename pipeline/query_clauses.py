"""Grammar of clauses: "that could not be moved", "left of the monitor", "moved the most between 3 s and 5 s"."""

from __future__ import annotations

from dataclasses import dataclass, replace

from vlmm_log.pipeline.query_cursor import Cursor
from vlmm_log.pipeline.query_measures import (
    after_motion,
    both,
    comparison,
    either,
    negated,
    time_span,
    within,
)
from vlmm_log.pipeline.query_nouns import (
    Asked,
    described,
    joined,
    noun_phrases,
    starts_phrase,
    superlative,
)
from vlmm_log.pipeline.query_places import place, ranked_to
from vlmm_log.pipeline.query_words import looks_like_participle
from vlmm_log.queries import Order
from vlmm_log.query_tree import AllOf, Class, Movable, Moved, Node, Seen, walk


@dataclass(frozen=True)
class Lead:
    """What stands before the heart of a predicate: "could not be", "did", "somebody"."""

    negate: bool = False
    can: bool = False
    be: bool = False
    finite: bool = False  # an auxiliary or modal of its own
    do: bool = False
    agent: str = ""
    inner: int = 0  # clauses of targets that it lies within


NOTHING = Lead()
DEEPEST = 3  # clauses of targets within each other


def lead(c: Cursor, carried: Lead) -> Lead:
    """All words before the heart; ``can`` is carried on until another auxiliary ends it ("can be lifted or moved")."""
    now = auxiliaries(c, replace(carried, finite=False, negate=False))
    while agent := _agent_here(c):
        c.skip("det")
        c.take()
        now = auxiliaries(c, replace(now, agent=agent))
    return now


def auxiliaries(c: Cursor, now: Lead) -> Lead:
    """Auxiliaries, modals, negations and adverbs; those of a question come before its subject."""
    while True:
        aux, neg, modal = c.value("aux"), c.value("neg"), c.value("modal")
        if aux is not None:
            own = aux != "part"
            ended = own and not now.finite
            be, do = now.be or aux in ("be", "part"), now.do or aux == "do"
            now = replace(now, be=be, do=do, finite=now.finite or own, can=now.can and not ended)
        elif neg in ("not", "no") or (neg == "without" and c.has("dynamic", "verb", ahead=1)):
            now = replace(now, negate=not now.negate)
        elif modal == "can" or (modal == "to" and c.has("verb", "aux", ahead=1)):
            now = replace(now, can=True, finite=True)
        elif not (c.has("stop") or (c.has("adverb") and c.peek().text != "still") or _still_is_adverb(c)):
            return now
        c.take()


def _still_is_adverb(c: Cursor) -> bool:
    return c.peek().text == "still" and c.has("verb", "movable", "relation", "dynamic", ahead=1)


def _agent_here(c: Cursor) -> str:
    """Who acts in "a robot could lift", "somebody pushed"; "" where nobody does.

    A map does not hold who moved what: "the chair the robot pushed" has an agent that must be told as not understood.
    """
    ahead = 1 if c.has("det") and not c.has("agent") else 0
    value = c.value("agent", ahead)
    general = c.has("modal", ahead=ahead + 1) or c.value("verb", ahead + 1) in ("base", "third")
    acts = general if value == "noun" else c.has("aux", "modal", "verb", "neg", "adverb", ahead=ahead + 1)
    return c.peek(ahead).text if value and acts else ""


def predicates(c: Cursor, asked: Asked, carried: Lead) -> Node | None:
    """Predicates joined by "and", which binds closer, and "or"."""
    first = predicate(c, asked, carried)
    if first is None:
        return None
    node, head = first
    groups: list[list[Node]] = [[node]]
    while True:
        start = c.at
        joint = joined(c)
        following = None if joint is None or starts_phrase(c) else predicate(c, asked, replace(head, agent=""))
        if following is None:
            c.at = start
            return either([both(*group) for group in groups])
        node, own = following
        if joint == "nor" or (joint == "or" and head.negate and not own.finite and not own.negate):
            groups[-1].append(negated(node))  # "not moving or rolling": neither
        elif joint == "or":
            groups.append([node])
        else:
            groups[-1].append(node)
        head = own if own.finite else replace(own, negate=head.negate)


def predicate(c: Cursor, asked: Asked, carried: Lead) -> tuple[Node, Lead] | None:
    """One predicate and what stood before it; None, with nothing taken, where there is none."""
    start = c.at
    head = lead(c, carried)
    node = _heart(c, asked, head)
    if node is None:
        c.at = start
        return None
    span = time_span(c) if any(isinstance(n, Moved | Seen) for n, _ in walk(node)) else None
    node = within(node, span) if span else node
    return (negated(node) if head.negate else node), head


def _heart(c: Cursor, asked: Asked, head: Lead) -> Node | None:
    node = _motion(c, asked, head) or _stay(c) or described(c) or _likely(c, asked)
    node = node or (_is_a(c, asked) if head.be else None) or _ranked(c, asked)
    return node or place(c, lambda: _own_clause(c, asked, head.inner + 1)) or comparison(c) or _seen(c)


def _motion(c: Cursor, asked: Asked, head: Lead) -> Node | None:
    """A verb of motion and what is said of it."""
    form = c.value("verb")
    if form is None or (head.be and not head.can and form in ("base", "third", "state")):
        return None  # "is open" is no motion
    c.take()
    generic = form in ("base", "third") and bool(head.agent) and not head.do  # "things people move"
    node: Node = Movable() if head.can or generic else Moved()
    while True:
        more = after_motion(c)
        if more:
            node = both(node, more)
        elif not (_by_agent(c, head) or _degree(c, asked) or _particle(c)):
            return node


def _particle(c: Cursor) -> bool:
    """ "around", "away": unless it is a preposition."""
    if not c.has("particle", "adverb", "stop") or (c.has("relation") and _starts_target(c, 1)):
        return False
    c.take()
    return True


def _starts_target(c: Cursor, ahead: int) -> bool:
    return c.peek(ahead).kind in ("word", "quote", "compound") or c.has("det", "camera", "thing", "number", ahead=ahead)


def _by_agent(c: Cursor, head: Lead) -> bool:
    """ "by somebody", "could ... by a robot"."""
    ahead = 2 if c.has("det", ahead=1) else 1
    agents = ("pronoun", "noun") if head.can else ("pronoun",)
    if not c.has("by") or c.value("agent", ahead) not in agents:
        return False
    for _ in range(ahead + 1):
        c.take()
    return True


def _degree(c: Cursor, asked: Asked) -> bool:
    """ "the most" after a verb."""
    ahead = 1 if c.has("det") else 0
    value = c.value("degree", ahead)
    if value is None or asked.order:
        return False
    for _ in range(ahead + 1):
        c.take()
    name, direction = value.split()
    asked.order = Order(name, direction)
    return True


def _stay(c: Cursor) -> Node | None:
    """ "stays still", "remains in place"; "stays" alone."""
    value = c.value("stay")
    if value is None or (value == "with_still" and not c.has("still", ahead=1)):
        return None
    c.take()
    c.accept("still")
    c.skip("particle")
    return Class("static")


def _likely(c: Cursor, asked: Asked) -> Node | None:
    """ "most likely to move"."""
    value = c.value("likely")
    heart = 2 if c.has("aux", ahead=1) else 1
    if value is None or asked.order or not c.has("verb", ahead=heart):
        return None
    for _ in range(heart + 1):
        c.take()
    asked.order = Order("rho", value)
    return AllOf()


def _ranked(c: Cursor, asked: Asked) -> Node | None:
    """ "the fastest", "nearest to the door", "ranked by rho"."""
    start = c.at
    if c.accept("ranked") and c.has("field") and not asked.order:
        name = c.accept("field") or ""
        asked.order, asked.one = Order(name, c.accept("descending") or "most"), False
        return AllOf()
    c.at = start
    c.skip("det")
    value = c.value("superlative")
    if value is None or asked.order:
        c.at = start
        return None
    c.take()
    asked.order, nodes = superlative(value)
    ranked_to(c, asked)
    return both(*nodes)


def _own_clause(c: Cursor, asked: Asked, inner: int) -> Node | None:
    """The clause that is all of a target: "near something that moved"."""
    c.skip("rel")
    own = predicate(c, asked, Lead(inner=inner)) if inner <= DEEPEST else None
    return own[0] if own else None


def _seen(c: Cursor) -> Node | None:
    """ "seen after 3 s"."""
    if not c.accept("seen"):
        return None
    span = time_span(c)
    return Seen(*span) if span else Seen()


def _is_a(c: Cursor, asked: Asked) -> Node | None:
    """ "that are chairs"."""
    if c.peek().kind == "word" and looks_like_participle(c.peek().text):
        return None  # a verb that the lexicon lacks
    start = c.at
    phrases = noun_phrases(c)
    if not phrases or not all(p.named for p in phrases) or not asked.takes(phrases):
        c.at = start
        return None
    return either([p.node for p in phrases])
