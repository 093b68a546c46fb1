"""What names of things mean: synonyms, kinds and plurals, from data/synonyms.toml."""

from __future__ import annotations

import hashlib
import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

TABLE = files("vlmm_log") / "data" / "synonyms.toml"
_CAMEL = re.compile(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")  # TVStand -> TV Stand
_POSSESSIVE = re.compile(r"['’]s?\b")
_WORD = re.compile(r"[^\W_]+")
_PASSED_OVER = re.compile("an?|the|some|any|my|your|his|her|its|this|that|these|those|all|each|every|piece|[0-9]+")
_TURNS = re.compile("of|with|in|on|from|for|at|near|by|under|beside|behind")  # what it is stands before them
_KNOWN_PLURAL = (("s", ""), ("es", ""), ("ies", "y"), ("ves", "f"), ("ves", "fe"))  # if that gives a word of the table
_ANY_PLURAL = (
    *(("ies", "y"), ("sses", "ss"), ("shes", "sh"), ("ches", "ch"), ("xes", "x")),
    *(("ss", "ss"), ("us", "us"), ("is", "is"), ("s", "")),
)


@dataclass(frozen=True)
class Thesaurus:
    """The table, ready to be looked up."""

    concepts: Mapping[str, str]  # name, its words apart and joined -> the concept it names
    kinds: Mapping[str, frozenset[str]]  # concept -> all that it is a kind of
    plurals: Mapping[str, str]
    words: frozenset[str]  # of all names
    longest: int  # words in the longest name
    fingerprint: str

    def parse(self, text: str) -> list[str]:
        """Concepts of a noun phrase and words that the table lacks, in the singular; what it is comes last.

        "Red Cars" gives red, car; "a cup of coffee" gives coffee, cup; "TVStand" gives tv stand.
        """
        return list(self._concepts([self._singular(word) for word in _words(text)]))

    def _concepts(self, words: list[str]) -> Iterator[str]:
        while words:
            sizes = range(min(self.longest, len(words)), 0, -1)
            names = ((n, name) for n in sizes for name in (" ".join(words[:n]), "".join(words[:n])))
            n, found = next(((n, self.concepts[name]) for n, name in names if name in self.concepts), (1, words[0]))
            yield found
            words = words[n:]

    def _singular(self, word: str) -> str:
        if word in self.plurals or word in self.words:
            return self.plurals.get(word, word)
        known = (stem for stem in _stems(word, _KNOWN_PLURAL) if stem in self.words)
        guessed = _stems(word, _ANY_PLURAL) if len(word) > 3 else iter(())
        return next(known, next(guessed, word))


@cache
def thesaurus() -> Thesaurus:
    """The table that the package ships."""
    text = TABLE.read_text("utf-8")
    table = tomllib.loads(text)
    same, kinds = table["same"], table["kinds"]
    spoken = {name: concept for concept, names in same.items() for name in (concept, *names)}
    for name in (n for kind, members in kinds.items() for n in (kind, *members)):
        spoken.setdefault(name, name)
    apart = {" ".join(_words(name)): concept for name, concept in spoken.items()}
    joined = {name.replace(" ", ""): concept for name, concept in apart.items()}
    concepts = joined | apart
    direct: dict[str, set[str]] = {concept: set() for concept in concepts.values()}
    for kind, members in kinds.items():
        for member in members:
            direct[spoken[member]].add(spoken[kind])
    for concept in direct.keys() - set(table["apart"]["names"]):
        direct[concept] |= {concepts[word] for word in concept.split()[1:][-1:] if word in concepts} - {concept}
    return Thesaurus(
        concepts,
        {c: frozenset(_reached(c, direct) | set(table["may_be"].get(c, ()))) - {c} for c in direct},
        table["plurals"],
        frozenset(word for name in apart for word in name.split()),
        max(len(name.split()) for name in apart),
        f"{TABLE.name} sha256:{hashlib.sha256(text.encode()).hexdigest()}",
    )


def _words(text: str) -> list[str]:
    """Lower-case words that say what it is; what stands after "of", "with", ... goes to the front."""
    found = _WORD.findall(_POSSESSIVE.sub("", _CAMEL.sub(" ", text)).casefold())
    words = [word for word in found if not _PASSED_OVER.fullmatch(word)]
    at = next((i for i, word in enumerate(words) if _TURNS.fullmatch(word)), len(words))
    return [word for word in words[at:] if not _TURNS.fullmatch(word)] + words[:at]


def _stems(word: str, endings: Iterable[tuple[str, str]]) -> Iterator[str]:
    return (word.removesuffix(ending) + instead for ending, instead in endings if word.endswith(ending))


def _reached(start: str, direct: Mapping[str, set[str]]) -> set[str]:
    reached: set[str] = set()
    ahead = [start]
    while ahead:
        new = direct[ahead.pop()] - reached
        reached |= new
        ahead += sorted(new)
    return reached
