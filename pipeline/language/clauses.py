"""Grammar of clauses: "that could not be moved", "left of the monitor", "moved the most between 3 s and 5 s"."""

from __future__ import annotations

from dataclasses import replace

from vlmm_log.pipeline.language.asked import Asked
from vlmm_log.pipeline.language.cursor import Cursor
from vlmm_log.pipeline.language.lead import Lead, lead
from vlmm_log.pipeline.language.measures import (
    NOW,
    after_motion,
    comparison,
    quantity,
    time_spans,
)
from vlmm_log.pipeline.language.nouns import (
    described,
    joined,
    noun_phrases,
    starts_phrase,
    superlative,
)
from vlmm_log.pipeline.language.places import place, ranked_to
from vlmm_log.pipeline.language.words import lexicon, looks_like_participle
from vlmm_log.queries import Order
from vlmm_log.query_tree import (
    AllOf,
    Class,
    Compare,
    Movable,
    Moved,
    Near,
    Node,
    Not,
    Seen,
    Side,
    Span,
    both,
    either,
    negated,
    walk,
    within,
)

DEEPEST = 3  # clauses of targets within each other


def predicates(c: Cursor, asked: Asked, carried: Lead) -> Node | None:
    """Predicates joined by "and", which binds closer, and "or"."""
    begin, before = c.at, replace(asked)
    groups = _groups(c, asked, carried)
    if len(groups) > 1 and asked.order != before.order:
        c.tell(begin)  # "that are the fastest or near the door": an order is of all answers
        asked.order, asked.limit = before.order, before.limit
    return either([both(*group) for group in groups]) if groups else None


def _groups(c: Cursor, asked: Asked, carried: Lead) -> list[list[Node]]:
    """Predicates joined by "and", in groups joined by "or"."""
    first = predicate(c, asked, carried)
    if first is None:
        return []
    node, head = first
    groups: list[list[Node]] = [[node]]
    while True:
        start = c.at
        if _of_either(c, head):
            c.take("unparsed")
            return groups
        joint = joined(c)
        following = None if joint is None or starts_phrase(c) else predicate(c, asked, replace(head, agent=""))
        if following is None:
            c.at = start
            return groups
        node, own = following
        neither = joint == "nor" or (joint == "or" and head.negate and not own.finite and not own.negate)
        if isinstance(node, Moved) and not own.finite and groups[-1][-1] == (Not(Moved()) if neither else Moved()):
            groups[-1][-1] = _denied(node) if neither else node  # "walked or sat down after 3 s": both then
        if neither:
            groups[-1].append(_denied(node))  # "not moving or rolling": neither
        elif joint == "or":
            groups.append([node])
        else:
            groups[-1].append(node)
        head = own if own.finite else replace(own, negate=head.negate)


def predicate(c: Cursor, asked: Asked, carried: Lead) -> tuple[Node, Lead] | None:
    """One predicate and what stood before it; None, with nothing taken, where there is none."""
    start, before = c.at, replace(asked)
    head = lead(c, carried)
    node = None if start == c.behind_target and _of_target_too(c, head) else _heart(c, asked, head)
    if node is None:
        c.at = start
        return None
    spans: tuple[Span, ...] = (head.span,) if head.span else ()
    if not spans and (c.has("present") or any(isinstance(n, Moved | Seen) for n, _ in walk(node))):
        spans = time_spans(c)
    unclear = head.negate and (asked.order != before.order or _of_several(node))
    if unclear or (spans and _counts_motions(node)):
        c.tell(start)  # "not the largest", "not near the door and the table"; how often in that time is not known
        asked.order, asked.limit = before.order, before.limit
        return AllOf(), replace(head, negate=False)
    node = negated(node) if head.negate else node
    return (within(node, spans) if spans else node), head


def _denied(node: Node) -> Node:
    """Not the node; of a motion in a time, seen in it."""
    if isinstance(node, Moved) and node != Moved():
        return both(Not(node), Seen(node.t0_s, node.t1_s))
    return negated(node)


def _counts_motions(node: Node) -> bool:
    return any(isinstance(n, Compare) and n.field in ("motions", "moved_s") for n, _ in walk(node))


def _of_several(node: Node) -> bool:
    """Whether it is a relation to each of several targets."""
    related = node.nodes if isinstance(node, AllOf) else ()
    return len({n.target for n in related if isinstance(n, Near | Side)}) > 1


def _of_either(c: Cursor, head: Lead) -> bool:
    """Whether what is joined may be the target's or the first noun's: "near a person who moved and that is static"."""
    behind_clause = head.inner > 0 and c.has("conj") and c.has("rel", "relation", ahead=1)
    return behind_clause or (c.at == c.behind_target and c.value("conj") == "comma" and c.has("rel", ahead=1))


def _of_target_too(c: Cursor, head: Lead) -> bool:
    """Whether what follows a target may speak of it as well as of the first noun: "cups on the table moving"."""
    if head.agent:
        return True
    form = c.value("verb")
    asks = c.question and form == "past"  # "which chairs near the door moved"
    participle = form in ("ing", "past") or c.has("still", "movable", "dynamic")
    return participle and not (head.finite or head.be or head.do or head.can or asks)


def _heart(c: Cursor, asked: Asked, head: Lead) -> Node | None:
    node = _motion(c, asked, head) or _stay(c) or described(c) or _likely(c, asked)
    node = node or (_is_a(c, asked) if head.be else None) or _ranked(c, asked)
    return node or place(c, lambda: own_clause(c, asked, head.inner + 1)) or comparison(c) or _seen(c)


def _motion(c: Cursor, asked: Asked, head: Lead) -> Node | None:
    """A verb of motion and what is said of it."""
    form = c.value("verb")
    if form is None or (head.be and not head.can and form in ("base", "third", "state")):
        return None  # "is open" is no motion
    generic = form in ("base", "third") and bool(head.agent) and not head.do  # "things people move"
    if head.agent in ("personal", "noun") and not (head.can or generic):
        return None  # "what did I move"
    # "could have opened or moved"; but "can move and moved", "could have fallen and fell": it did
    carried = head.be or form != "past" or (head.have and c.peek().text not in lexicon().preterites)
    c.take()
    could = head.can and (head.finite or carried)
    node: Node = Movable() if could or generic else Moved()
    while True:
        more = after_motion(c)
        if more:
            node = both(node, more)
        elif not (_by_agent(c, head) or _degree(c, asked) or _way(c) or _particle(c)):
            return node


def _way(c: Cursor) -> bool:
    """ "further than 1 m", "to the left": how far and where to, which no map holds, is no place of the camera's."""
    start = c.at
    if c.has("my_side") and c.peek().text.startswith("to "):
        c.take()
    elif not (c.accept("comparative") or "").startswith("distance_m") or quantity(c) is None or c.has("from_"):
        c.at = start
        return False
    c.tell(start)
    return True


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
    if c.has("verb"):
        c.take("unparsed")  # "stays open": how it is, a map does not hold
    return AllOf((Class("static"), Not(Moved())))  # it stays: what moved for a while did not


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
        usual = "least" if name == "distance_m" else "most"
        asked.order, asked.one = Order(name, c.accept("descending") or usual), False
        return AllOf()
    c.at = start
    c.skip("det")
    value = c.value("superlative")
    if value is None or asked.order:
        c.at = start
        return None
    c.take()
    asked.order, nodes = superlative(value)
    ranked_to(c, asked, lambda: own_clause(c, asked, 1))
    return both(*nodes)


def own_clause(c: Cursor, asked: Asked, inner: int) -> Node | None:
    """What is said of a target: "near something that moved", "near the door that opened"; None where nothing is."""
    start = c.at
    c.skip("rel")
    own = predicates(c, asked, Lead(inner=inner)) if inner <= DEEPEST else None
    c.at = start if own is None else c.at
    return own


def _seen(c: Cursor) -> Node | None:
    """ "seen after 3 s", "still there"."""
    usual: Span = NOW if c.accept("lasting") else (None, None)
    if usual != NOW and not c.accept("seen"):
        return None
    return either([Seen(*span) for span in time_spans(c) or [usual]])


def _is_a(c: Cursor, asked: Asked) -> Node | None:
    """ "that are chairs"."""
    if c.peek().kind == "word" and looks_like_participle(c.peek().text):
        return None  # a verb that the lexicon lacks
    start = c.at
    phrases = noun_phrases(c)
    if not phrases or (phrases[-1].named and phrases[-1].determined and c.has("verb")):
        c.at = start  # "what was the person moving"
        return None
    if not all(p.named or p.nodes for p in phrases) or not asked.takes(phrases):
        c.at = start
        return None
    asked.one &= not any(p.plural for p in phrases)  # "what are the fastest chairs"
    return either([p.node for p in phrases])
