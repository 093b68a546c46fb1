"""From text to tokens: contractions, quotes, numbers, and the longest phrases of the lexicon."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

Phrase = tuple[str, ...]

_PATTERN = re.compile(
    r"""(?P<quote>"[^"]*[^\W_][^"]*")|(?P<clock>\d{1,3}:[0-5]\d(?::[0-5]\d)?(?:\.\d+)?(?!\w))
    |(?P<number>(?:\d{1,3}(?:,\d{3})+|\d+)(?:\.\d+)?(?=\W|$|(?:s|sec|secs|ms|m|cm|mm|min)\b)|\.\d+(?!\w))
    |(?P<word>(?:k|c)?m/[sh]\b|and/or\b|\w(?:[\w'-]*\w)?)|(?P<sign>>=|<=|==|[^\s\w])""",
    re.VERBOSE,
)
_CONTRACTIONS = (
    (r"\bcan't\b|\bcannot\b", "can not"),
    (r"\bwon't\b", "will not"),
    (r"n't\b", " not"),
    (r"\b(do|does|did|is|are|was|were|has|have|had|could)nt\b", r"\1 not"),
    (r"\b(what|who|that|there|it|where|which|he|she)'s\b", r"\1 is"),
    (r"'re\b", " are"),
    (r"'ve\b", " have"),
    (r"'ll\b", " will"),
    (r"'d\b", " would"),
    (r"\bi'm\b", "i am"),
    (r"\bnon-(?=\w)", "non "),
)


@dataclass(frozen=True)
class Token:
    """A word or phrase and what the lexicon takes it for."""

    text: str
    kind: str  # a table of the lexicon; "word", "quote", "clock", "sign" or "end" beside them
    value: str = ""
    number: float = float("nan")


END = Token("", "end")


@dataclass(frozen=True)
class Lexicon:
    """The lexicon as one table of phrases."""

    phrases: Mapping[Phrase, tuple[tuple[str, str], ...]]  # phrase -> kinds and values, the first one the usual
    longest: int
    singulars: Mapping[str, str]
    invariant: frozenset[str]
    participles: frozenset[str]  # of names, such as "building"
    preterites: frozenset[str]  # that are no participles: "fell"
    est: frozenset[str]


_FIRST = (
    "compound",
    "named",
    "opener",
    "stop",
    "except",
    "count",
    "my_side",
    "superlative",
    "likely",
    "comparative",
    "op",
)
_NO_KIND = ("version", "verbs", "stay", "plurals", "invariant", "participles", "est")


@cache
def lexicon() -> Lexicon:
    """The words of vlmm_log/data/query_lexicon.toml."""
    table = tomllib.loads((files("vlmm_log") / "data" / "query_lexicon.toml").read_text("utf-8"))
    kinds = [*_FIRST, *(k for k in table if k not in _FIRST and k not in _NO_KIND)]
    entries: dict[Phrase, list[tuple[str, str]]] = {}
    listed = ((phrase, kind, value) for kind in kinds for value, texts in table[kind].items() for phrase in texts)
    for phrase, kind, value in [*listed, *_inflected(table)]:
        own = entries.setdefault(tuple(phrase.split()), [])
        if kind not in [k for k, _ in own]:
            own.append((kind, value))
    return Lexicon(
        {phrase: tuple(own) for phrase, own in entries.items()},
        max(map(len, entries)),
        table["plurals"],
        frozenset(table["invariant"]["words"]),
        frozenset(table["participles"]["words"]),
        frozenset(past for past, *others in table["verbs"]["irregular"].values() if others and past not in others),
        frozenset(table["est"]["words"]),
    )


def _inflected(table: Mapping[str, Any]) -> Iterator[tuple[str, str, str]]:
    """(phrase, kind, form) of every form of every verb."""
    verbs = table["verbs"]
    for form in verbs["state"]["forms"]:
        yield form, "verb", "state"
    for text, past in [*((v, ()) for v in verbs["regular"]), *verbs["irregular"].items()]:
        head, *rest = text.split()
        for form, words in _forms(head).items():
            for phrase in (" ".join([word, *rest]) for word in words):
                if phrase not in past and (form != "past" or not past):
                    yield phrase, "verb", form
        yield from ((p, "verb", "past") for p in past)
        if not rest:
            yield from ((f"{stem}able", "movable", "movable") for stem in _stems(head))
    for verb in table["stay"]["verbs"]:
        head, *rest = verb.split()
        yield from ((" ".join([word, *rest]), "stay", "stay") for words in _forms(head).values() for word in words)
    yield from ((word, "stay", "with_still") for word in table["stay"]["with_still"])


def _stems(verb: str) -> list[str]:
    """What -ing, -ed and -able are put on; with and without a doubled consonant, as spelling varies."""
    if re.search(r"[^aeiouy]e$", verb):
        return [verb[:-1]]
    doubled = re.search(r"[^aeiou][aeiou][bdglmnprtv]$|ivel$", verb)
    return [verb, verb + verb[-1]] if doubled else [verb]


def _forms(verb: str) -> dict[str, list[str]]:
    y = re.search(r"[^aeiou]y$", verb)
    third = verb[:-1] + "ies" if y else verb + ("es" if re.search(r"(s|x|z|ch|sh|o)$", verb) else "s")
    past = [verb[:-1] + "ied"] if y else [stem + "ed" for stem in _stems(verb)]
    return {"base": [verb], "third": [third], "ing": [stem + "ing" for stem in _stems(verb)], "past": past}


def tokenise(text: str) -> list[Token]:
    """The tokens of a text, each the longest phrase of the lexicon at its place; nothing is dropped but spaces."""
    lowered = text.lower().replace("\u2019", "'").replace("\u201c", '"').replace("\u201d", '"')
    for pattern, plain in _CONTRACTIONS:
        lowered = re.sub(pattern, plain, lowered)
    lowered = re.sub(r"[\s?!.]+$", "", lowered)
    raw = [(m.lastgroup or "", m[0]) for m in _PATTERN.finditer(lowered)]
    tokens, at = [], 0
    while at < len(raw):
        token, length = _longest(raw, at)
        tokens.append(token)
        at += length
    return tokens


def _longest(raw: list[tuple[str, str]], at: int) -> tuple[Token, int]:
    kind, text = raw[at]
    known = lexicon()
    for length in range(min(known.longest, len(raw) - at), 0, -1):
        words = tuple(word for _, word in raw[at : at + length])
        if words in known.phrases:
            first, value = known.phrases[words][0]
            number = float(value) if first in ("number", "how_often") else float("nan")
            return Token(" ".join(words), first, value, number), length
    if kind == "quote":
        return Token(text[1:-1].strip(), kind), 1
    if kind in ("number", "clock"):
        return Token(text, kind, number=_number(text)), 1
    if kind == "word" and len(text) > 4 and text.endswith("est") and text not in known.est:
        return Token(text, "unknown", "unknown"), 1  # a superlative that the lexicon lacks
    return Token(text, kind), 1


def _number(text: str) -> float:
    """Of a decimal, or seconds of a clock time."""
    seconds = 0.0
    for part in text.replace(",", "").split(":"):
        seconds = 60 * seconds + float(part)
    return seconds


def also(token: Token, kind: str) -> str | None:
    """The value of a token as another kind that the lexicon lists it in; None where it does not."""
    if token.kind == kind:
        return token.value
    return dict(lexicon().phrases.get(tuple(token.text.split()), ())).get(kind)


def singular(word: str) -> str:
    """The singular of a noun by rule; the word itself where it is one."""
    known = lexicon()
    if word in known.singulars:
        return known.singulars[word]
    if word in known.invariant or len(word) < 4 or not word.endswith("s") or re.search(r"(ss|us|is)$", word):
        return word
    if word.endswith("ies") and len(word) > 4:
        return word[:-3] + "y"
    return word[:-2] if re.search(r"(sses|xes|ches|shes|oes|zzes|\w{3}[^aeo]uses)$", word) else word[:-1]


def is_plural(word: str) -> bool:
    """Whether a noun is in the plural."""
    return singular(word) != word or (word.endswith("s") and word in lexicon().invariant)


def looks_like_participle(word: str) -> bool:
    """Whether an unknown word after a noun is a verb or an adverb rather than part of the name."""
    return word not in lexicon().participles and re.search(r"[aeiouy].*(ing|ed|ly)$", word) is not None
