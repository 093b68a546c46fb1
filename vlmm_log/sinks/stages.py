"""What a stage is called in figures and recordings."""

from __future__ import annotations

from vlmm_log.elements import Instances, Sightings, Tracked, WorldMap
from vlmm_log.queries import Answer
from vlmm_log.types import (
    Ego,
    Features,
    FlowField,
    FramePair,
    Judgement,
    Motion,
    Odometry,
    Posterior,
    Segments,
    Skipped,
)

_NAMES: dict[type, str] = {
    FlowField: "flow",
    Segments: "segments",
    Ego: "ego",
    Motion: "motion",
    Posterior: "posterior",
    Odometry: "odometry",
    Instances: "aggregate",
    Sightings: "place",
    Features: "embed",
    Tracked: "associate",
    WorldMap: "map",
    Answer: "query",
    Judgement: "judge",
}


def stage_of(result: object) -> str | None:
    """The stage that gave a result; None for what came from the stream."""
    if isinstance(result, FramePair | Skipped):
        return None
    return _NAMES.get(type(result), "matches")  # the one result that is the pipeline's own
