"""What the rooms ask of each other: one method each, so that a fake is a function or a small class."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeVar, runtime_checkable

from vlmm_log.calibration import Calibration
from vlmm_log.elements import Instances, Movability, Sightings, Tracked, WorldMap
from vlmm_log.queries import Answer
from vlmm_log.settings import ReadSettings
from vlmm_log.types import (
    Ego,
    Features,
    Float32,
    FlowField,
    Frame,
    FramePair,
    Judgement,
    Motion,
    Odometry,
    Posterior,
    RunEnd,
    Segments,
    Skipped,
)

Result = (
    FramePair
    | Skipped
    | FlowField
    | Segments
    | Ego
    | Motion
    | Posterior
    | Odometry
    | Features
    | Instances
    | Sightings
    | Tracked
    | WorldMap
    | Answer
    | Judgement
)
"""What a stage, or the stream before it, gives a sink to see."""

R = TypeVar("R")


class Log(Protocol):
    """An opened log."""

    @property
    def name(self) -> str:
        """What to call it: the folder's or file's name."""
        ...

    @property
    def has_poses(self) -> bool:
        """Whether any pose was read."""
        ...

    @property
    def world_up(self) -> str:
        """Axis of the world that points up, as "+z" or "-x"; "-y" where the world is the camera's frame."""
        ...

    @property
    def notes(self) -> list[str]:
        """What the reader decided, and where from: intrinsics, depth scale, pose source."""
        ...

    def count(self, start_ns: int, stop_ns: int) -> int:
        """How many frames ``frames`` will try, for progress."""
        ...

    def frames(self, start_ns: int, stop_ns: int) -> Iterator[Frame | Skipped]:
        """Frames with ``start_ns <= time since the first frame < stop_ns`` in order, and all that was left out."""
        ...


class Reader(Protocol):
    """A kind of log that can be opened."""

    name: str

    def recognises(self, path: Path) -> bool:
        """Whether the path looks like this kind of log; reads no image."""
        ...

    def open(self, path: Path, s: ReadSettings) -> Log:
        """The log, its lists read. Raises InputError where it cannot be used."""
        ...


class FlowEstimator(Protocol):
    """Dense optical flow."""

    def __call__(self, first: Frame, second: Frame) -> tuple[Float32, Float32]:
        """Flow (H, W, 2) px from the first image to the second, and back."""
        ...


class Segmenter(Protocol):
    """Instances of a frame."""

    def __call__(self, frame: Frame) -> Segments:
        """Masks and labels. Raises InputError where its files cannot be used."""
        ...


class Embedder(Protocol):
    """Open-vocabulary features of regions and of texts, in one space."""

    threshold: float  # cosine from which a text is taken to name an element

    def regions(self, frame: Frame, segments: Segments) -> Float32:
        """(n, D) unit features of the instances of a frame."""
        ...

    def labels(self, labels: Sequence[str]) -> Float32 | None:
        """(m, D) unit features of labels where regions are known by them alone; None where pixels decide."""
        ...

    def texts(self, texts: Sequence[str]) -> Float32:
        """(m, D) unit features."""
        ...


class MovabilityPrior(Protocol):
    """Whether things of a label can move: once a label, then remembered."""

    def __call__(self, label: str) -> Movability:
        """The prior of an open-vocabulary label; "" is a thing without a name."""
        ...


@dataclass(frozen=True)
class Models:
    """What the method asks of learned or library models."""

    flow: FlowEstimator
    segment: Segmenter
    embed: Embedder
    prior: MovabilityPrior
    reports: tuple[
        Callable[[], str], ...
    ] = ()  # what a model has to tell at the end: an endpoint's cost, a cache's use
    calibration: Calibration | None = None  # from scores to probabilities; None: no probability is told


@dataclass(frozen=True)
class Moment:
    """When a result came: the first frame's stamp and index, and what the stage took."""

    stamp_ns: int
    index: int | None  # None for what is no frame: a row of a list, a pose
    elapsed_ms: float


class Sink(Protocol):
    """Somewhere results go. A sink watches; nothing it does changes a result."""

    def write(self, result: Result, at: Moment) -> None:
        """Take one stage's result."""
        ...

    def close(self, end: RunEnd) -> None:
        """Finish what was written. Called once, also when the run was interrupted."""
        ...


Make = Callable[[Result, FramePair], Any]
"""What a sink makes of a result that a pair shows by itself: a pure function that another process can be sent."""


@runtime_checkable
class Halved(Protocol):
    """A sink in two halves, of which the first may run in another process: ``take(made(result, pair), at)`` writes."""

    @property
    def made(self) -> Make:
        """The first half."""
        ...

    def take(self, made: Any, at: Moment) -> None:
        """The second half."""
        ...


class Observe(Protocol):
    """The identity function by which results are seen."""

    def __call__(self, result: R, /) -> R:
        """The same result."""
        ...


def unseen(result: R, /) -> R:
    """Nobody watches."""
    return result


Progress = Callable[[int, int], None]
"""Told (pairs done, pairs expected)."""
