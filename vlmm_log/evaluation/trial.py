"""The method under one set of settings, pair after pair, with everything that a pair showed kept for the judges."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from vlmm_log.elements import Sightings, Tracked, WorldMap
from vlmm_log.pipeline.run import World, empty_world, step
from vlmm_log.protocols import FlowEstimator, Models, R, Segmenter, Sink, unseen
from vlmm_log.settings import Settings
from vlmm_log.sinks.many import watched_by
from vlmm_log.types import Ego, Float32, FlowField, Frame, FramePair, Motion, Odometry, Segments


@dataclass(frozen=True, eq=False)
class Seen:
    """What one pair showed under one trial's settings."""

    pair: FramePair
    flow: FlowField
    segments: Segments
    ego: Ego
    motion: Motion
    odometry: Odometry
    sightings: Sightings
    tracked: Tracked
    map: WorldMap


Adapt = Callable[[FramePair, Models], tuple[FramePair, Models]]
"""What is done to a pair, and to the models, before a trial sees them."""


def as_it_is(pair: FramePair, models: Models) -> tuple[FramePair, Models]:
    """Nothing."""
    return pair, models


@dataclass(frozen=True)
class Plan:
    """What a trial is to be."""

    name: str
    settings: Settings
    adapt: Adapt = as_it_is
    same_ids: bool = True  # elements are those of the first trial
    raw: bool = False  # the residual's length is judged beside d_M


@dataclass
class Trial:
    """A run of the method that goes on a pair at a time."""

    plan: Plan
    world: World
    sink: Sink | None = None  # watches, for a recording

    @staticmethod
    def start(plan: Plan, *, has_poses: bool, sink: Sink | None = None) -> Trial:
        """Nothing seen yet."""
        return Trial(plan, empty_world(plan.settings, has_poses=has_poses), sink)

    @property
    def name(self) -> str:
        """What it is called."""
        return self.plan.name

    @property
    def settings(self) -> Settings:
        """Under which it runs."""
        return self.plan.settings

    def see(self, pair: FramePair, models: Models) -> Seen:
        """One pair more, by the very step that ``process`` takes."""
        pair, models = self.plan.adapt(pair, models)
        kept: dict[type, object] = {}
        shown = unseen if self.sink is None else watched_by(self.sink, pair)

        def observe(result: R, /) -> R:
            kept[type(result)] = result
            return shown(result)

        observe(pair)
        self.world = step(pair, self.world, models, self.settings, observe)
        of = {f: kept[t] for f, t in STAGES.items()}
        return Seen(pair, **of, map=self.world.map)  # type: ignore[arg-type]


STAGES: dict[str, type] = {
    "flow": FlowField,
    "segments": Segments,
    "ego": Ego,
    "motion": Motion,
    "odometry": Odometry,
    "sightings": Sightings,
    "tracked": Tracked,
}


class FlowOnce:
    """Flow that several trials share: the last pair's is kept."""

    def __init__(self, estimate: FlowEstimator) -> None:
        self._estimate = estimate
        self._of: tuple[Frame, Frame] | None = None

    def __call__(self, first: Frame, second: Frame) -> tuple[Float32, Float32]:
        """See FlowEstimator."""
        if self._of is None or self._of[0].rgb is not first.rgb or self._of[1].rgb is not second.rgb:
            self._of, self._flow = (first, second), self._estimate(first, second)
        forward, backward = self._flow
        return forward.copy(), backward.copy()  # kernels round otherwise on what an earlier trial has frozen


class SegmentsOnce:
    """Masks that several trials share: the last frame's are kept."""

    def __init__(self, segment: Segmenter) -> None:
        self._segment = segment
        self._of: Frame | None = None

    def __call__(self, frame: Frame) -> Segments:
        """See Segmenter."""
        if self._of is None or self._of.rgb is not frame.rgb:
            self._of, self._segments = frame, self._segment(frame)
        return self._segments


@dataclass(frozen=True)
class WithoutIdentities:
    """A segmenter whose identities are withheld, so that association has to find them."""

    segment: Segmenter

    def __call__(self, frame: Frame) -> Segments:
        """See Segmenter."""
        segments = self.segment(frame)
        return replace(segments, identities=np.full(len(segments), -1, np.int64))
