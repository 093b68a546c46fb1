"""Maps of appearance or names alone: what they answer to questions about motion."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence

import numpy as np

from vlmm_log.elements import Elements
from vlmm_log.evaluation.scores import QUERIES, Scores
from vlmm_log.evaluation.trial import Seen
from vlmm_log.protocols import Embedder, MovabilityPrior
from vlmm_log.types import Float32, Float64

PHRASES: Mapping[str, Sequence[str]] = {
    "moving": (
        "an object that is currently moving",
        "a moving object",
        "something in motion",
        "the door that opens",
        "a person walking",
        "an object being moved",
    ),
    "movable": (
        "an object that can be moved",
        "a movable object",
        "something I could pick up",
        "a portable thing",
        "an object to carry",
        "household item",
    ),
    "static": (
        "a fixed object that stays still",
        "a static object",
        "part of the building",
        "furniture that never moves",
        "a wall",
        "a built-in fixture",
    ),
}
ANCHORS = (
    "wall", "floor", "ceiling", "window", "door", "cabinet", "counter", "shelf", "bed", "sofa", "table", "desk",
    "fridge", "sink", "stove", "bathtub", "toilet", "curtain", "radiator", "wardrobe",
)  # fmt: skip
VOLATILES = (
    "cup", "bottle", "plate", "bowl", "book", "box", "bag", "phone", "laptop", "remote control", "toy", "ball",
    "pillow", "clothes", "shoe", "fruit", "tool", "chair", "person", "pet",
)  # fmt: skip


def similarities(embed: Embedder, features: Float32, texts: Sequence[str]) -> Float64:
    """(m, n) cosines of texts with elements' features; 0 where an element has none."""
    if not len(features):  # nor does an empty map know how long they are
        return np.zeros((len(texts), 0))
    return np.nan_to_num(embed.texts(texts).astype(np.float64) @ features.T.astype(np.float64))


class SemanticOnly:
    """One phrase a query against the feature of the keyframe that shows most of the element."""

    threshold = float("nan")

    def __init__(self, embed: Embedder, name: str) -> None:
        self.name = f"semantic only [{name}]"
        self.reference = "paper, Table II (i): the element's feature against one phrase a query"
        self._embed = embed

    def see(self, seen: Seen) -> Float32 | None:  # noqa: ARG002  features are in the map
        """No pixel score."""
        return None

    def answers(self, elements: Elements) -> tuple[Scores, ...]:
        """Cosines."""
        first = [PHRASES[q][0] for q in QUERIES]
        moving, movable, static = similarities(self._embed, elements.features, first)
        return (Scores(moving, movable, static),)


class VlMapsStyle:
    """Six phrases a query; the best one counts."""

    name = "VLMaps/ConceptFusion-style"
    reference = (
        "Huang et al., ICRA 2023; Jatavallabhula et al., RSS 2023: features by text similarity, best of six phrasings "
        "by the truth; one feature an element instead of a grid"
    )
    threshold = float("nan")

    def __init__(self, embed: Embedder) -> None:
        self._embed = embed

    def see(self, seen: Seen) -> Float32 | None:  # noqa: ARG002  features are in the map
        """No pixel score."""
        return None

    def answers(self, elements: Elements) -> tuple[Scores, ...]:
        """One candidate a phrase."""
        return _of_phrases(self._embed, elements.features)


class ConceptGraphsStyle:
    """Nodes with the mean feature of all views."""

    name = "ConceptGraphs-style"
    reference = "Gu et al., ICRA 2024: object nodes, features averaged over views; captions and their LLM left out"
    threshold = float("nan")

    def __init__(self, embed: Embedder) -> None:
        self._embed = embed
        self._sums: dict[int, Float64] = {}

    def see(self, seen: Seen) -> Float32 | None:
        """No pixel score; it gathers features."""
        for k, element in enumerate(seen.tracked.ids.tolist()):
            feature = seen.tracked.features[k].astype(np.float64)
            self._sums[element] = self._sums.get(element, np.zeros_like(feature)) + feature
        return None

    def answers(self, elements: Elements) -> tuple[Scores, ...]:
        """One candidate a phrase, as for the others."""
        sums = np.array([self._sums[i] for i in elements.ids.tolist()]).reshape(elements.features.shape)
        means = (sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-12)).astype(np.float32)
        return _of_phrases(self._embed, means)


class DualMapStyle:
    """Anchor or volatile, by likeness to names of either kind."""

    name = "DualMap-style"
    reference = "Jiang et al., 2025: anchor/volatile by similarity to templates; re-detection left out"
    threshold = float("nan")

    def __init__(self, embed: Embedder) -> None:
        self._embed = embed

    def see(self, seen: Seen) -> Float32 | None:  # noqa: ARG002  features are in the map
        """No pixel score."""
        return None

    def answers(self, elements: Elements) -> tuple[Scores, ...]:
        """Volatile stands for movable and, for want of anything else, for moving."""
        anchor = similarities(self._embed, elements.features, ANCHORS).max(axis=0)
        volatile = similarities(self._embed, elements.features, VOLATILES).max(axis=0) - anchor
        return (Scores(volatile, volatile, -volatile),)


class VoxelandStyle:
    """A Dirichlet belief over labels an element; movability is its expectation."""

    name = "Voxeland-style"
    reference = "Matez-Bandera et al., 2024: Dirichlet evidence of labels an instance; voxels left out"
    threshold = float("nan")

    def __init__(self, prior: MovabilityPrior) -> None:
        self._prior = prior
        self._evidence: dict[int, dict[str, float]] = defaultdict(lambda: defaultdict(float))

    def see(self, seen: Seen) -> Float32 | None:
        """No pixel score; it gathers evidence."""
        segments = seen.segments
        for k, element in enumerate(seen.tracked.ids.tolist()):
            self._evidence[element][segments.names[k]] += float(segments.scores[k])
        return None

    def answers(self, elements: Elements) -> tuple[Scores, ...]:
        """Expected movability, with one pseudo-count for a label not seen, of movability 1/2."""
        rho = np.array([self._expected(self._evidence[i]) for i in elements.ids.tolist()])
        return (Scores(rho, rho, 1.0 - rho),)

    def _expected(self, evidence: Mapping[str, float]) -> float:
        known = sum(weight * self._prior(name).rho for name, weight in evidence.items())
        return (known + 0.5) / (sum(evidence.values()) + 1.0)


def _of_phrases(embed: Embedder, features: Float32) -> tuple[Scores, ...]:
    by_query = [similarities(embed, features, PHRASES[q]) for q in QUERIES]
    return tuple(Scores(*each) for each in zip(*by_query, strict=True))
