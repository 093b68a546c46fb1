"""The stages in their order, and which of them makes an entity."""

from __future__ import annotations

import re

STAGES = (
    "input",
    "flow",
    "segments",
    "matches",
    "ego",
    "motion",
    "posterior",
    "embed",
    "aggregate",
    "odometry",
    "place",
    "associate",
    "map",
    "query",
    "judge",
)
_MADE_BY = (  # the first that fits
    (r"world/camera/image(/rgb|/depth)?", "input"),
    (r"world/camera/image/flow/.*", "flow"),
    (r"world/camera/image/residual/p_moving", "posterior"),
    (r"world/camera/image/(truth|outcome|score)|metrics/.*", "judge"),
    (r"world/camera/image/(validity|residual/.*)", "motion"),
    (r"world/camera/image/(instances|boxes)", "associate"),
    (r"world/camera/image/query/.*|world/map/query/.*", "query"),
    (r"world/camera", "odometry"),
    (r"world/map/observations", "associate"),
    (r"world/map/.*", "map"),
    (r"stats/(inlier_share|spread|(ego|row)_.*)", "ego"),
    (r"stats/(valid_share|flagged_share|median_.*)", "motion"),
)


def stage_of(entity: str) -> str:
    """The stage that makes an entity; "" where none does."""
    return next((stage for pattern, stage in _MADE_BY if re.fullmatch(pattern, entity)), "")


def rank(stage: str) -> int:
    """A stage's place in the order; what no stage makes comes last."""
    return STAGES.index(stage) if stage in STAGES else len(STAGES)
