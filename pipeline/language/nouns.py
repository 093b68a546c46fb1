"""Grammar of noun phrases: "the three fastest office chairs", "moving or static things", "cups of coffee"."""

from __future__ import annotations

from dataclasses import replace

from vlmm_log.pipeline.language.asked import Asked, Phrase
from vlmm_log.pipeline.language.cursor import Cursor
from vlmm_log.pipeline.language.measures import number_here, present
from vlmm_log.pipeline.language.words import is_plural, looks_like_participle, singular
from vlmm_log.queries import Order
from vlmm_log.query_tree import Class, Movable, Moved, Named, Node, both, either, negated, within

MOST_ASKED = 10**6


def noun_phrase(c: Cursor) -> Phrase | None:
    """The phrase here; None where none begins."""
    start, phrase = c.at, Phrase()
    while _before_the_name(c, phrase):
        pass
    name = _name(c, phrase)
    if name:
        phrase.nodes.append(Named(name))
        phrase.named = True
    if not (phrase.nodes or phrase.thing or phrase.asked.order or phrase.asked.limit):
        c.at = start
        return None
    return phrase


def noun_phrases(c: Cursor) -> list[Phrase]:
    """Noun phrases joined by "and", "or" and commas."""
    begin = c.at
    phrases = [phrase] if (phrase := noun_phrase(c)) else []
    while phrases:
        start = c.at
        joint = c.value("conj") != "but" and joined(c)
        following = noun_phrase(c) if joint and starts_phrase(c) else None
        if following is None:
            c.at = start
            break
        following.joint = joint or ""
        phrases.append(following)
    return _shared(c, begin, phrases)


def _shared(c: Cursor, start: int, phrases: list[Phrase]) -> list[Phrase]:
    """The list with what stands before its first noun said of bare nouns behind it too: "the fastest cup or book".

    Told where an order or a number is of one of several nouns alone, or of each: "the fastest cup and the door".
    """
    first, *rest = phrases or [Phrase()]
    bare = [p for p in rest if not p.determined and p.thing is None and len(p.nodes) == 1]
    asks = [p for p in phrases if p.asked.order or p.asked.limit]
    of_each = first.determined and not all(p.plural for p in phrases) and any(p.joint == "and" for p in rest)
    if rest and asks and (asks != [first] or len(bare) < len(rest) or of_each):
        c.tell(start)
        return [replace(p, asked=Asked()) for p in phrases]
    before = [n for n in first.nodes if not isinstance(n, Named)] if first.named and len(bare) == len(rest) else []
    return [first, *(replace(p, nodes=[*before, *p.nodes]) for p in rest)] if phrases else []


def joined(c: Cursor) -> str | None:
    """The word that joins, commas before it included; a lone comma is an "and"."""
    value = c.accept("conj")
    while value in ("comma", "but") and c.has("conj"):
        value = c.accept("conj")
    if value is None:
        return None
    c.skip("rel")
    return value if value in ("or", "nor") else "and"


def starts_phrase(c: Cursor) -> bool:
    """Whether a noun phrase follows rather than a predicate: "and rolling balls"."""
    start = c.at
    phrase = noun_phrase(c)
    c.at = start
    return phrase is not None and (phrase.named or phrase.determined or phrase.thing is not None)


def _before_the_name(c: Cursor, phrase: Phrase) -> bool:
    """One determiner, number, superlative, modifier or word like "object"; False where there is none."""
    if c.has("adverb") and c.has("verb", ahead=1):
        c.take()  # "still moving"
        return True
    return (
        _thing(c, phrase)
        or _determiner(c, phrase)
        or _number(c, phrase)
        or _superlative(c, phrase)
        or _modifiers(c, phrase)
    )


def _thing(c: Cursor, phrase: Phrase) -> bool:
    value = c.value("thing")
    if value is None or (c.has("det") and noun_ahead(c, 1)):
        return False
    c.take()
    if value == "person":
        phrase.nodes.append(Named("person"))
        phrase.named = True
    if value == "mask":
        phrase.asked.returns = "mask"
    phrase.thing = value
    phrase.plural |= value in ("plural", "mask")
    return True


def _determiner(c: Cursor, phrase: Phrase) -> bool:
    if phrase.thing not in (None, "wh", "mask") or c.accept("det") is None:  # "things a robot could lift"
        return False
    phrase.determined = True
    return True


def _number(c: Cursor, phrase: Phrase) -> bool:
    """ "top 3", "three" before what they count."""
    start = c.at
    c.skip("top")
    number = number_here(c)
    countable = 1 <= number <= MOST_ASKED and number.is_integer()
    counts = noun_ahead(c, 1) or (c.at > start and not c.has("unit", "times", ahead=1))
    if not countable or not counts or phrase.asked.limit is not None:
        c.at = start
        return False
    c.take()
    phrase.asked.limit = int(number)
    return True


def _superlative(c: Cursor, phrase: Phrase) -> bool:
    value = c.value("superlative")
    if value is None or phrase.asked.order is not None or (phrase.thing and not noun_ahead(c, 1)):
        return False
    c.take()
    order, nodes = superlative(value)
    phrase.asked.order = order
    phrase.nodes += nodes
    return True


def superlative(value: str) -> tuple[Order, list[Node]]:
    """What "fastest" orders by, and that it speaks of what moved."""
    name, direction, *moved = value.split()
    return Order(name, direction), [Moved() for _ in moved]


def _modifiers(c: Cursor, phrase: Phrase) -> bool:
    """ "moving", "not moving", "moving or static" before a noun."""
    start, node = c.at, _modifier(c)
    joint = c.value("conj") if node else None
    while node and joint in ("and", "or", "but"):
        before = c.at
        c.take()
        other = _modifier(c)
        if other is None:
            c.at = before
            break
        node, joint = both(node, other) if joint != "or" else either([node, other]), c.value("conj")
    if node is None or not noun_ahead(c, 0):
        c.at = start
        return False
    phrase.nodes.append(node)
    return True


def _modifier(c: Cursor) -> Node | None:
    start, span = c.at, present(c)
    negate = c.value("neg") == "not" and c.peek().text != "neither" and c.take() is not None
    span = span or present(c)
    if c.value("verb") in ("ing", "past"):
        c.take()
        node: Node | None = Moved()
    else:
        node = described(c)
    if node is None:
        c.at = start
        return None
    node = negated(node) if negate else node
    return within(node, [span]) if span else node


def described(c: Cursor) -> Node | None:
    """What an adjective like "static", "movable" or "in motion" says."""
    if c.accept("still"):
        return Class("static")
    if c.accept("movable"):
        return Movable()
    dynamic = c.accept("dynamic")
    return None if dynamic is None else negated(Moved()) if dynamic == "unmoved" else Moved()


def noun_ahead(c: Cursor, ahead: int) -> bool:
    """Whether a noun comes so far ahead, behind any modifiers."""
    while c.has("verb", "still", "movable", "dynamic", "superlative", "adverb", "present", "number", ahead=ahead):
        if c.value("verb", ahead) in ("base", "third"):
            return False
        ahead += 1
    token = c.peek(ahead)
    if token.kind == "word":
        return not looks_like_participle(token.text)
    return token.kind in ("quote", "compound") or c.has("thing", ahead=ahead) or c.value("agent", ahead) == "noun"


def without_last_word(phrase: Phrase) -> None:
    """Take the last word out of a phrase's name."""
    *rest, name = phrase.nodes
    assert isinstance(name, Named)
    words = name.text.split()[:-1]
    phrase.nodes = [*rest, Named(" ".join(words))] if words else rest


def _name(c: Cursor, phrase: Phrase) -> str:
    """The open-vocabulary name, its head in the singular; "" where there is none."""
    words: list[str] = []
    quoted = False
    c.skip("named")
    while _belongs_to_name(c, phrase, words):
        quoted |= c.peek().kind == "quote"
        words.append(c.take("word").text)
        if c.has("of") and not quoted and (_is_word(c, 1) or (c.has("det", ahead=1) and _is_word(c, 2))):
            words.append(c.take("word").text)
            c.skip("det")
    if not words:
        return ""
    head = max(words.index("of") - 1, 0) if "of" in words else len(words) - 1
    phrase.plural = is_plural(words[head].split()[-1])
    if not quoted:
        *rest, last = words[head].split()
        words[head] = " ".join([*rest, singular(last)])
    return " ".join(words)


def _is_word(c: Cursor, ahead: int) -> bool:
    return c.peek(ahead).kind in ("word", "compound", "quote")


def _belongs_to_name(c: Cursor, phrase: Phrase, words: list[str]) -> bool:
    token, after = c.peek(), bool(words or phrase.thing)
    if token.kind == "word":
        return not (after and looks_like_participle(token.text))
    if token.kind in ("quote", "compound"):
        return True
    if c.value("agent") == "noun":
        acts = bool(words or phrase.thing not in (None, "wh"))
        return not (acts and c.has("aux", "modal", "verb", "neg", ahead=1))
    if c.has("opener"):
        return c.at > 0 and " " not in token.text and not c.has("unknown")
    if c.value("camera") == "noun":
        return True
    form = c.value("verb")
    if after or form in (None, "ing", "past"):
        return False
    return (phrase.determined and not c.has("verb", ahead=1)) or _is_word(c, 1)  # "the lift", "open door"
