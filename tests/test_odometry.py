"""Where cameras stand: the log's poses, or one chain of ego-motion."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vlmm_log import se3
from vlmm_log.pipeline.odometry import locate
from vlmm_log.types import Ego, Frame, FramePair

K = np.array([[100.0, 0, 32], [0, 100, 24], [0, 0, 1]])


def frame(index, T=None):
    image = np.zeros((2, 2, 3), np.uint8)
    return Frame(index * 10**8, index, image, np.ones((2, 2), np.float32), K, T)


def ego(T, reliable=True):
    return Ego(T, np.zeros(6), np.eye(6), np.zeros(6), 0.9, 1.0, 1000, reliable)


def steady(index):
    """Pose of a camera on a screw motion, world = frame 0."""
    return se3.exp(index * np.array([0.01, -0.02, 0.015, 0.02, 0.01, -0.03]))


def chained(pairs, *, reliable=lambda a: True):
    before, found = None, {}
    for a, b in pairs:
        pair = FramePair(frame(a), frame(b))
        before = locate(pair, ego(se3.inverse(steady(b)) @ steady(a), reliable(a)), before)
        found[a] = before.T_world_first
    return found


@given(st.integers(1, 4), st.integers(1, 3))
def test_a_chain_recovers_a_steady_motion_at_any_gap_and_stride(gap, stride):
    found = chained([(a, a + gap) for a in range(0, 24, min(stride, gap))])
    for a, T in found.items():
        assert pytest.approx(steady(a), abs=1e-9) == T


def test_the_logs_poses_come_first():
    T_a, T_b = se3.exp(np.full(6, 0.1)), se3.exp(np.full(6, 0.2))
    placed = locate(FramePair(frame(0, T_a), frame(3, T_b)), ego(np.eye(4)), None)
    assert placed.from_log
    assert (placed.T_world_first == T_a).all() and (placed.T_world_second == T_b).all()


def test_a_frame_without_pose_is_placed_between_its_neighbours():
    first = locate(FramePair(frame(0, steady(0)), frame(3, steady(3))), ego(np.eye(4)), None)
    middle = locate(FramePair(frame(1), frame(4, steady(4))), ego(np.eye(4)), first)
    assert not middle.from_log
    assert middle.T_world_first == pytest.approx(steady(1), abs=1e-9)


def test_an_unreliable_pair_does_not_move_the_chain():
    found = chained([(0, 3), (3, 6)], reliable=lambda a: a != 0)
    assert found[3] == pytest.approx(np.eye(4))


def test_a_hole_in_the_log_keeps_the_last_pose():
    found = chained([(0, 3), (1, 4), (50, 53)])
    assert found[50] == pytest.approx(steady(4))


def test_poses_that_begin_late_place_the_pair_that_first_sees_one():
    relative = se3.inverse(steady(3)) @ steady(0)
    lost = locate(FramePair(frame(0), frame(3)), ego(relative), None)
    assert not lost.anchored
    T = se3.exp(np.full(6, 0.3)) @ steady(6)
    found = locate(FramePair(frame(3), frame(6, T)), ego(se3.inverse(steady(6)) @ steady(3)), lost)
    assert found.anchored
    assert found.T_world_first == pytest.approx(se3.exp(np.full(6, 0.3)) @ steady(3), abs=1e-9)
    later = locate(FramePair(frame(6), frame(9)), ego(relative), found)
    assert later.anchored
