"""Where the cameras of a pair stand in the world: the log's poses, or ego-motion chained from the first frame."""

from __future__ import annotations

import numpy as np

from vlmm_log import se3
from vlmm_log.types import Ego, Float64, FramePair, Odometry, Span


def locate(pair: FramePair, ego: Ego, before: Odometry | None) -> Odometry:
    """Poses of both cameras, the log's where it has them.

    Without: the first frame is the world; one chain of pairs that meet end to end is followed, so that all positions
    share one drift, and the frames between its ends are interpolated by time. An unreliable pair moves the chain
    by the log's relative pose (identity where it has none). Where a log's poses begin late, the pairs before are not
    ``anchored``: they lie in another world.
    """
    first, second = pair.first, pair.second
    relative = ego.T_second_first if ego.reliable else pair.relative_pose()
    T_first, on_chain, anchored = _first_pose(pair, relative, before)
    T_second = second.T_world_cam if second.T_world_cam is not None else T_first @ se3.inverse(relative)
    span = Span(first.stamp_ns, second.stamp_ns, T_first, T_second)
    link = span if on_chain or before is None else before.link
    return Odometry(span, link, first.T_world_cam is not None, anchored)


def _first_pose(pair: FramePair, relative: Float64, before: Odometry | None) -> tuple[Float64, bool, bool]:
    """Pose of a pair's first frame, whether the pair becomes the chain's next link, and whether poses anchor it."""
    first, second = pair.first, pair.second
    if first.T_world_cam is not None:
        return first.T_world_cam, True, True
    if second.T_world_cam is not None and (before is None or not before.anchored):
        return second.T_world_cam @ relative, True, True
    if before is None:
        return np.eye(4), True, False
    known = before.anchored
    if before.link.start_ns <= first.stamp_ns < before.link.stop_ns:
        return _at(before.link, first.stamp_ns), False, known
    if first.stamp_ns == before.link.stop_ns:
        return before.link.T_stop, True, known
    if before.pair.start_ns <= first.stamp_ns <= before.pair.stop_ns:  # frames were left out: no pair meets the chain
        return _at(before.pair, first.stamp_ns), True, known
    return before.pair.T_stop, True, known  # a hole: nothing tells how the camera moved meanwhile


def _at(span: Span, stamp_ns: int) -> Float64:
    """The pose at a time within a span, at constant twist."""
    share = (stamp_ns - span.start_ns) / (span.stop_ns - span.start_ns)
    return np.asarray(se3.exp(share * se3.log(span.T_stop @ se3.inverse(span.T_start))) @ span.T_start)
