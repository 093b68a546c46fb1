"""What a map answers to the paper's three queries, as one number an element: whole, and with a field taken away."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vlmm_log.elements import Elements, MotionClass
from vlmm_log.pipeline.fusion import classify
from vlmm_log.pipeline.language.judge import judge
from vlmm_log.pipeline.language.parser import parse
from vlmm_log.pipeline.language.router import route
from vlmm_log.pipeline.language.scene import Scene
from vlmm_log.settings import Settings
from vlmm_log.types import Float64, freeze

QUERIES = {"moving": "what is moving", "movable": "things I could move", "static": "where it stays still"}


@dataclass(frozen=True, eq=False)
class Scores:
    """By which elements are ranked for each query, higher first, and which of them the answer names."""

    moving: Float64  # (n,)
    movable: Float64
    static: Float64
    named: dict[str, NDArray[np.bool_]] | None = None  # query -> (n,); None where the mechanism only ranks
    motion_class: NDArray[np.uint8] | None = None  # (n,) MotionClass; None where it decides none

    def __post_init__(self) -> None:
        freeze(self)

    def of(self, query: str) -> Float64:
        """(n,) of one of QUERIES."""
        found: Float64 = getattr(self, query)
        return found


def whole(elements: Elements, s: Settings) -> Scores:
    """All fields, asked through the settings' own parser: what the filter names comes first, then by its strength."""
    to_tree = route if s.query.parser == "paper" else parse
    scene = Scene(elements, {}, 1.0, s.query.near_m, s.map, None, "+z", int(elements.first_ns.min(initial=0)))
    truths = {name: judge(to_tree(text).filter, scene) for name, text in QUERIES.items()}
    moving, movable, static = (t.yes.astype(np.float64) + t.strength for t in truths.values())
    named = {name: t.yes for name, t in truths.items()}
    return Scores(moving, movable, static, named, elements.motion_class)


def observed_only(elements: Elements, s: Settings) -> Scores:
    """Without the movability prior: what could move is what did, what is still is what did not."""
    moving = whole(elements, s).moving
    return Scores(moving, moving, -moving)


def prior_only(elements: Elements) -> Scores:
    """Without observed motion: what moves is what could."""
    return Scores(elements.rho, elements.rho, 1.0 - elements.rho)


MOVABLE_FROM = 0.55  # truth: things of at least this movability can be moved


def query_truth(moved: NDArray[np.bool_], movability: Float64) -> dict[str, NDArray[np.bool_]]:
    """Which things answer each query: they moved; their type can be moved; neither."""
    movable = movability >= MOVABLE_FROM
    return {"moving": moved, "movable": movable, "static": ~moved & ~movable}


def true_class(moved: NDArray[np.bool_], movability: Float64) -> NDArray[np.uint8]:
    """(n,) MotionClass."""
    still = np.where(movability >= MOVABLE_FROM, MotionClass.MOVABLE_STATIC, MotionClass.STATIC)
    return np.where(moved, MotionClass.MOVING, still).astype(np.uint8)


def with_prior(elements: Elements, rho: Float64, s: Settings) -> Elements:
    """Elements as another prior would have them, classes too."""
    fields = zip(elements.o.tolist(), elements.kappa.tolist(), rho.tolist(), strict=True)
    found = [classify(o, kappa, r, s.map) for o, kappa, r in fields]
    return replace(
        elements,
        rho=rho,
        motion_class=np.array([y for y, _ in found], np.uint8),
        confidence=np.array([c for _, c in found], np.float32),
    )


def taken(scores: Scores, rows: NDArray[np.int64]) -> Scores:
    """Scores of these rows; -1: a row that is not there, below all others and never named."""
    there = rows >= 0

    def ranks(values: Float64) -> Float64:
        return np.where(there, values[rows] if values.size else 0.0, LAST)

    named, y = scores.named, scores.motion_class
    return Scores(
        ranks(scores.moving),
        ranks(scores.movable),
        ranks(scores.static),
        None if named is None else {q: there & (yes[rows] if yes.size else False) for q, yes in named.items()},
        None if y is None else np.where(there, y[rows] if y.size else 0, NO_CLASS).astype(np.uint8),
    )


LAST = -1e9  # below every score
NO_CLASS = 255
