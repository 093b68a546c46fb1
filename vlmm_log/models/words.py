"""Labels and queries as hashed words: the embedder that needs no weights and no download.

A label carries its concept (synonyms are one), all that it is a kind of, the words before it and its character
n-grams; a text to be looked for carries only what it asks for. So "vehicle" finds "bus", and "car" does not. Each
feature goes to several signed places of the vector (Weinberger et al., ICML 2009), so that no two become one.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from vlmm_log.models.thesaurus import thesaurus
from vlmm_log.types import Float32, Frame, Segments

WIDTH = 512
PLACES = 32  # that a feature is spread over
KIND = 0.9  # weights beside the concept's 1
BEFORE = 0.3  # of words before the last: "dog" in "dog bed"
LETTERS = 0.3  # of the character n-grams of a concept in the table
NEW_LETTERS = 0.8  # and of a word that is not
_OR = re.compile(r"[/,;|]|\bor\b")


class Words:
    """The embedder. An instance without a name gives zeros and matches nothing."""

    threshold = 0.3

    def __init__(self) -> None:
        from sklearn.feature_extraction import FeatureHasher

        self.fingerprint = f"words, {thesaurus().fingerprint}"
        self._hasher = FeatureHasher(WIDTH, input_type="pair", dtype=np.float32)
        self._label = lru_cache(1 << 16)(self._embed_label)
        self._text = lru_cache(1 << 16)(self._embed_text)

    def regions(self, frame: Frame, segments: Segments) -> Float32:  # noqa: ARG002  # it sees labels only
        """(n, WIDTH) unit features of the instances' labels; zeros for the label ""."""
        return self.labels(segments.names)

    def labels(self, labels: Sequence[str]) -> Float32:
        """(m, WIDTH) unit features; zeros for the label ""."""
        names = sorted(set(labels))
        place = {name: row for row, name in enumerate(names)}
        return _stacked([self._label(name) for name in names])[[place[label] for label in labels]]

    def texts(self, texts: Sequence[str]) -> Float32:
        """(m, WIDTH) unit features of what is looked for; zeros for a text without a word."""
        return _stacked([self._text(text) for text in texts])

    def _embed_label(self, name: str) -> Float32:
        features: dict[str, float] = {}
        for part in _OR.split(name):  # "cup/mug" is both
            concepts = thesaurus().parse(part)
            kinds = {kind for concept in concepts[-1:] for kind in thesaurus().kinds.get(concept, ())}
            features |= dict.fromkeys(sorted(kinds), KIND) | _asked_for(concepts)
        return self._hashed(features)

    def _embed_text(self, text: str) -> Float32:
        return self._hashed(_asked_for(thesaurus().parse(text)))

    def _hashed(self, features: dict[str, float]) -> Float32:
        pairs = [(f"{i} {name}", weight) for name, weight in features.items() for i in range(PLACES)]
        dense = np.asarray(self._hasher.transform([pairs]).toarray()[0], np.float32)
        return dense / max(float(np.linalg.norm(dense)), 1e-12)


def _asked_for(concepts: list[str]) -> dict[str, float]:
    """Feature -> weight: the last concept, those before it, the last one's character trigrams."""
    if not concepts:
        return {}
    *before, last = concepts
    padded = f" {last} "
    grams = sorted({f"letters {padded[i : i + 3]}" for i in range(len(padded) - 2)})
    known = last in thesaurus().kinds
    letters = (LETTERS if known else NEW_LETTERS) / len(grams) ** 0.5
    return dict.fromkeys(before, BEFORE) | dict.fromkeys(grams, letters) | {last: 1.0}


def _stacked(rows: list[Float32]) -> Float32:
    return np.array(rows, np.float32).reshape(len(rows), WIDTH)
