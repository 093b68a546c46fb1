"""The default parser: a recursive-descent grammar over a lexicon, from a text to the filter tree.

It adds to the paper's router what that one lacks: negation, "and" and "or", superlatives, counts, relations and time.
Every word is accounted for: a rule took it as structure, or it is part of a name, or it is told in ``Query.unparsed``.
A word that the lexicon lacks is never structure. Only words that add no condition leave no trace in the tree: articles,
"please", "in the room", "actually", "around" behind a verb; what else the lexicon knows and no rule takes is told.

What is decided here: nouns joined by "and" are a union, clauses an intersection, and "and" binds closer than "or"; a
clause behind a list of nouns speaks of all of them, and so does what stands before the first where the others are bare
("the fastest cup or book"). Times joined by "or" are a union; joined by "and" they are told. A clause with "that",
"who" or "which" behind the target of a relation speaks of the target, and "the door and the window" there are both
targets; every other clause, relation and time speaks of the first noun. What may be either's ("cups on the table
moving") is told. "Static", "fixed", "stays still" mean the fused class STATIC, a negated verb ("never moves") means not
seen to move; with "can" or "could" any verb of motion asks for the movability prior. "Now" is the map's last second,
"just" its last five. A superlative gives one answer for a singular and ranks all for a plural.
"""

from __future__ import annotations

from vlmm_log.pipeline.language.asked import Asked, Phrase
from vlmm_log.pipeline.language.clauses import own_clause, predicates
from vlmm_log.pipeline.language.cursor import Cursor
from vlmm_log.pipeline.language.lead import NOTHING, Lead, auxiliaries
from vlmm_log.pipeline.language.measures import time_spans
from vlmm_log.pipeline.language.nouns import joined, noun_phrases, starts_phrase, without_last_word
from vlmm_log.pipeline.language.places import ranked_to
from vlmm_log.pipeline.language.words import also, tokenise
from vlmm_log.queries import Query
from vlmm_log.query_tree import AllOf, Node, both, either, negated, refuse, refuse_long, within

DEEPEST = 6  # exceptions within exceptions


def parse(text: str) -> Query:
    """The query of an English text. Raises InputError for an empty text and one of over 1000 characters."""
    refuse_long(text)
    return read(text)[0]


def read(text: str) -> tuple[Query, Cursor]:
    """The query, and what each token of the text was taken for."""
    c, asked = Cursor(tokenise(text)), Asked()
    if not c.tokens:
        refuse("the text is empty; say what to look for")
    _opening(c, asked)
    spans = time_spans(c)
    c.skip("conj") if spans else None
    _opening(c, asked)
    carried = auxiliaries(c, NOTHING) if c.has("aux", "modal") else NOTHING
    _opening(c, asked)
    node = _union(c, asked, carried, 0)
    node = within(node, spans) if spans else node
    if node == AllOf() and "word" not in c.roles and not (asked.order or asked.limit or _says(c, "thing")):
        c.roles = ["unparsed"] * len(c.roles)  # "please show me the": nothing was asked for
    return Query(node, asked.order, asked.limit, asked.returns, text, c.unparsed()), c


def _says(c: Cursor, kind: str) -> bool:
    return any(also(token, kind) is not None for token in c.tokens)


def _opening(c: Cursor, asked: Asked) -> None:
    while c.has("opener", "stop", "count"):
        if c.has("count"):
            asked.returns = "count"
        c.take()


def _union(c: Cursor, asked: Asked, carried: Lead, depth: int) -> Node:
    """Groups joined by "and" or "or": either way what is of any of them; "and no chairs" takes away."""
    nodes = _group(c, asked, carried, depth)[0]
    while not c.done:
        start = c.at
        joined(c)
        unclear = start == c.behind_target and c.has("neg") and (c.has("det", ahead=1) or not c.target_determined)
        more, takes_away = _group(c, asked, NOTHING, depth)
        if more and takes_away and unclear:
            c.tell(start)
            continue
        if not more:  # "chairs and": joined with nothing
            c.roles[start] = "structure" if c.tokens[start].value == "comma" else "unparsed"
        nodes = [both(either(nodes), *more)] if takes_away and nodes else [*nodes, *more]
    return either(nodes) if nodes else AllOf()


def _group(c: Cursor, asked: Asked, carried: Lead, depth: int) -> tuple[list[Node], bool]:
    """Nouns and all that is said of them, as one node or none; and whether "no" or "not" takes them away."""
    takes_away = _negates_nouns(c)
    begin = c.at
    phrases = noun_phrases(c)
    if (takes_away and any(p.asked != Asked() for p in phrases)) or not asked.takes(phrases):
        c.at, phrases = begin, []
        c.take("unparsed")  # a second superlative or number, "not the largest"
    if not phrases:
        c.skip("det")
    nodes = [either([p.node for p in phrases])] if phrases else []
    last = c.at - 1
    told = _told(c, asked, carried, depth, nodes)
    if (carried.do or carried.can) and phrases and told == nodes and c.tokens[last].kind == "word":
        without_last_word(phrases[-1])  # "did the chair hum": its verb went into the name
        c.roles[last] = "unparsed"
        told = [either([p.node for p in phrases])]
    if phrases and asked.order and asked.limit is None and asked.one and not _plural(phrases):
        asked.limit = 1
    if c.at == begin and not c.done:
        c.take("unparsed")
    if not told:
        return [], False
    return [negated(both(*told)) if takes_away else both(*told)], takes_away


def _plural(phrases: list[Phrase]) -> bool:
    return any(p.plural or p.joint not in ("", "or") for p in phrases)


def _negates_nouns(c: Cursor) -> bool:
    value = c.value("neg")
    if value == "nothing":
        c.take()
        return True
    start = c.at
    of_nouns = c.peek().text == "neither" or not c.has("verb", "still", "movable", "dynamic", ahead=1)
    if value == "no" or (value == "not" and of_nouns):
        c.take()
        if starts_phrase(c):
            return True
        c.at = start
    return False


def _told(c: Cursor, asked: Asked, carried: Lead, depth: int, nodes: list[Node]) -> list[Node]:
    """The nodes of nouns and of clauses, relations, times and exceptions behind them, up to the next noun in a list."""
    nodes = list(nodes)
    acted_on = not nodes and c.has("agent")  # "can I lift the chair"
    while not c.done:
        found = _clause(c, asked, carried) or _exception(c, depth)
        spans = () if found else time_spans(c)
        if found:
            nodes.append(found)
            asks_on = c.at == c.behind_target and not carried.negate  # "can the chair near the door be moved"
            carried = carried if asks_on else NOTHING
            if acted_on and starts_phrase(c):
                nodes += [either([p.node for p in noun_phrases(c)])]
        elif spans:
            nodes = [within(both(*nodes), spans)]
        elif c.has("conj"):
            break
        elif not (c.accept("stop", "rel", "adverb") or ranked_to(c, asked, lambda: own_clause(c, asked, 1))):
            c.take("unparsed")
    return nodes


def _clause(c: Cursor, asked: Asked, carried: Lead) -> Node | None:
    start = c.at
    c.skip("rel")
    if c.has("conj") and joined(c) == "and" and starts_phrase(c):
        c.at = start
        return None
    node = predicates(c, asked, carried)
    if node is None:
        c.at = start
        return None
    return negated(node) if carried.negate else node


def _exception(c: Cursor, depth: int) -> Node | None:
    """ "except the chairs that moved", "but not tables"."""
    start, behind = c.at, c.at == c.behind_target
    if c.value("conj") == "comma" and c.has("except", ahead=1):
        c.take()
    denies, unclear = c.has("except"), behind and c.peek().text.startswith("but")
    if not (denies or c.value("conj") == "but") or depth >= DEEPEST:
        c.at = start
        return None
    c.take()
    denies |= c.accept("neg") is not None  # "static but movable" takes nothing away
    counted = c.has("number") or c.peek().kind == "number"  # "all but two chairs"
    says = c.has("verb", "still", "movable", "dynamic", "relation", "my_side", "seen")
    if counted or (says and not denies) or not (says or starts_phrase(c) or c.has("det")):
        c.at = start
        return None
    unclear = unclear and not says and (c.has("det") or not c.target_determined)
    own = Asked()
    nodes, _ = _group(c, own, NOTHING, depth + 1)
    if unclear or own != Asked(one=own.one):  # "all but the largest": an order is of what is left
        c.tell(start)
        return AllOf()
    return negated(nodes[0]) if nodes else None
