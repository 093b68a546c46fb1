"""The nouns of a comparison. A stands for the first recording or map, B for the second."""

from __future__ import annotations

from dataclasses import dataclass, field

NAN = float("nan")
NEVER = -(2**63)  # ns, before all times


@dataclass(frozen=True)
class Change:
    """Something told of both runs that is not the same. None: not told."""

    name: str
    a: object
    b: object


@dataclass(frozen=True)
class Place:
    """A moment of the log. ``index`` None: of no frame; ``stamp_ns`` None: of the whole recording."""

    index: int | None
    stamp_ns: int | None

    @property
    def order(self) -> tuple[int, int]:
        """What places are sorted by: time; the whole recording comes first."""
        return (NEVER if self.stamp_ns is None else self.stamp_ns, -1 if self.index is None else self.index)


@dataclass(frozen=True)
class Figures:
    """How far two values are apart."""

    compared: int = 0  # pixels, cells, points: what both have
    over: int = 0  # of them, apart by more than the tolerance
    unmatched: int = 0  # what one side alone has: NaN against a number, rows
    p50: float = NAN  # of the distances of all that was compared
    p95: float = NAN
    largest: float = NAN
    unit: str = ""
    told: str = ""  # what else is to say: the sizes differ, texts, which columns

    @property
    def differs(self) -> bool:
        """Whether anything is beyond the tolerance."""
        return self.over + self.unmatched > 0


@dataclass(frozen=True)
class FrameDifference:
    """One differing moment of an entity."""

    at: Place
    figures: Figures

    @property
    def badness(self) -> tuple[float, float, float]:
        """What moments are ranked by: most of the distances, then the share beyond the tolerance, the largest one."""
        n = self.figures
        p95, largest = (x if x == x else 0.0 for x in (n.p95, n.largest))
        return p95, self.share, largest

    @property
    def share(self) -> float:
        """Of what either has, the share that is beyond the tolerance."""
        n = self.figures
        return (n.over + n.unmatched) / max(n.compared + n.unmatched, 1)


@dataclass(frozen=True)
class EntityDifference:
    """What differs in an entity."""

    entity: str
    stage: str  # that makes it; "" of what no stage makes
    compared: int  # moments that both have
    only_a: tuple[Place, ...]
    only_b: tuple[Place, ...]
    frames: tuple[FrameDifference, ...]  # the moments that differ, in order

    @property
    def first(self) -> Place:
        """The first moment that differs."""
        return min((*self.only_a, *self.only_b, *(f.at for f in self.frames)), key=lambda place: place.order)

    @property
    def worst(self) -> FrameDifference | None:
        """The moment that differs most; None where rows are missing and no more."""
        return max(self.frames, key=lambda f: f.badness, default=None)

    @property
    def over_share(self) -> float:
        """Of all that was compared in the differing moments, the share beyond the tolerance."""
        return sum(f.figures.over for f in self.frames) / max(sum(f.figures.compared for f in self.frames), 1)

    @property
    def unmatched(self) -> int:
        """What one side alone has, in the moments that both have."""
        return sum(f.figures.unmatched for f in self.frames)

    @property
    def largest(self) -> float:
        """The largest distance; NaN where none was measured."""
        return max((f.figures.largest for f in self.frames if f.figures.largest == f.figures.largest), default=NAN)


@dataclass(frozen=True)
class StageDifference:
    """A stage whose full results differ, by their digests: also where the recorded, thinner fields look the same."""

    stage: str
    frames: int  # how many
    first: Place


@dataclass(frozen=True)
class Divergence:
    """Where the runs part."""

    at: Place
    stage: str  # the earliest that differs there; "" where no stage made what differs
    entity: str  # that shows it; "" where digests alone do


@dataclass(frozen=True)
class ElementChange:
    """Two elements that are taken for the same, and differ; or one that only one map has."""

    a: int | None  # ids
    b: int | None
    label: str
    kinds: tuple[str, ...]  # of "added", "removed", "moved", "relabelled", "flipped", "changed"
    told: str  # what from and to
    classes: tuple[str, ...] = ()  # of a flipped one: in A, in B


@dataclass(frozen=True)
class ElementsDifference:
    """The maps at the end of both runs, or at the last frame that both hold."""

    matched: int
    changes: tuple[ElementChange, ...] = ()

    def of_kind(self, kind: str) -> list[ElementChange]:
        """The changes of a kind."""
        return [change for change in self.changes if kind in change.kinds]


@dataclass(frozen=True)
class QueryDifference:
    """A query's last answers: ranks from 1; None: no answer there."""

    query: str
    ranks: tuple[tuple[str, int | None, int | None], ...]  # element, rank in A and in B


@dataclass(frozen=True)
class Difference:
    """All that differs between A and B."""

    a: str
    b: str
    settings: tuple[Change, ...] = ()
    inputs: tuple[Change, ...] = ()
    about: tuple[Change, ...] = ()  # versions, source's name, reader: told, and no difference by themselves
    frames: tuple[int, int, int] = (0, 0, 0)  # that A, B and both have
    missing: tuple[str, ...] = ()  # what was cut off, or could not be read
    first: Divergence | None = None
    stages: tuple[StageDifference, ...] = ()
    entities: tuple[EntityDifference, ...] = ()
    elements: ElementsDifference = field(default_factory=lambda: ElementsDifference(0))
    queries: tuple[QueryDifference, ...] = ()

    @property
    def same(self) -> bool:
        """Whether nothing differs beyond the tolerance."""
        parts = (self.settings, self.inputs, self.first, self.stages, self.entities)
        return not (any(parts) or self.elements.changes or self.queries)
