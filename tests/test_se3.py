"""Rigid motions: what a group must do, on arbitrary motions, and against SciPy."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from vlmm_log import se3

unit = st.floats(-1, 1, width=32)
metres = arrays(np.float64, 3, elements=st.floats(-50, 50, width=32))
seeds = st.integers(0, 2**32 - 1)
angles = st.one_of(
    st.floats(0, np.pi),
    st.floats(0, 1e-3),
    st.floats(-14, -1).map(lambda e: 10.0**e),
    st.floats(-14, -1).map(lambda e: np.pi - 10.0**e),
    st.sampled_from([0.0, np.pi, 1e-6, 1e-4, np.pi - 1e-9]),
)


def normal(size):
    """Random unit vectors, none too short to be normed."""
    vectors = arrays(np.float64, size, elements=unit).filter(lambda v: np.linalg.norm(v) > 1e-2)
    return vectors.map(lambda v: v / np.linalg.norm(v))


@st.composite
def twists(draw):
    return np.concatenate([draw(normal(3)) * draw(angles), draw(metres)])


motions = twists().map(se3.exp)
quaternions = normal(4)


def is_rigid(T):
    R = T[..., :3, :3]
    return (
        np.allclose(R @ np.swapaxes(R, -1, -2), np.eye(3), atol=1e-12)
        and np.allclose(np.linalg.det(R), 1.0)
        and np.array_equal(T[..., 3, :], np.broadcast_to([0, 0, 0, 1], (*T.shape[:-2], 4)))
    )


@given(twists())
def test_exp_is_rigid_and_its_rotation_is_scipys(twist):
    T = se3.exp(twist)
    assert is_rigid(T)
    np.testing.assert_allclose(T[:3, :3], Rotation.from_rotvec(twist[:3]).as_matrix(), atol=1e-12)


@given(twists())
def test_exp_composes_along_one_axis(twist):
    np.testing.assert_allclose(se3.exp(twist / 2) @ se3.exp(twist / 2), se3.exp(twist), atol=1e-8)


@given(st.lists(twists(), min_size=1, max_size=4))
def test_exp_of_a_batch_is_exp_of_each(each):
    np.testing.assert_array_equal(se3.exp(np.array(each)), np.array([se3.exp(t) for t in each]))


@given(twists())
def test_log_undoes_exp(twist):
    assume(np.linalg.norm(twist[:3]) < np.pi - 1e-6)  # at pi the axis may be either way round
    np.testing.assert_allclose(se3.log(se3.exp(twist)), twist, atol=1e-7)


@given(motions)
def test_exp_undoes_log_also_at_half_a_turn(T):
    twist = se3.log(T)
    assert np.linalg.norm(twist[:3]) <= np.pi + 1e-9
    np.testing.assert_allclose(se3.exp(twist), T, atol=1e-6)


@pytest.mark.parametrize("axis", [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.6, 0, -0.8], [-0.6, 0.8, 0]])
def test_log_of_half_a_turn_has_the_axis(axis):
    rotation = se3.log(se3.exp(np.array([*axis, 0, 0, 0]) * np.pi))[:3]
    assert abs(rotation @ axis) == pytest.approx(np.pi, abs=1e-7)


@given(motions, motions)
def test_inverse(a, b):
    np.testing.assert_allclose(se3.inverse(a) @ a, np.eye(4), atol=1e-9)
    np.testing.assert_allclose(se3.inverse(a @ b), se3.inverse(b) @ se3.inverse(a), atol=1e-9)
    np.testing.assert_array_equal(se3.inverse(np.stack([a, b])), np.stack([se3.inverse(a), se3.inverse(b)]))


def cloud(seed, *shape):
    return np.random.default_rng(seed).normal(size=(*shape, 3))


def moved(points, T):
    return points @ np.swapaxes(T[..., :3, :3], -1, -2) + T[..., None, :3, 3]


@given(motions, seeds, st.integers(4, 30), st.booleans())
def test_kabsch_recovers_a_motion(T, seed, n, planar):
    points = cloud(seed, n)
    if planar:  # a reflection in the plane would fit as well
        points[:, 2] = 0
    found = se3.kabsch(points, moved(points, T))
    assert is_rigid(found)
    np.testing.assert_allclose(found, T, atol=1e-6)


@given(motions, st.floats(0.1, 5), st.floats(0.1, 5))
def test_kabsch_needs_but_three_points(T, a, b):
    points = np.array([[0.0, 0, 1], [a, 0, 1], [0, b, 2]])
    np.testing.assert_allclose(se3.kabsch(points, moved(points, T)), T, atol=1e-6)


@given(st.lists(motions, min_size=1, max_size=5), seeds)
def test_kabsch_of_a_batch(each, seed):
    T, points = np.array(each), cloud(seed, len(each), 6)
    np.testing.assert_allclose(se3.kabsch(points, moved(points, T)), T, atol=1e-6)


@given(seeds, st.sampled_from(["mirrored", "unrelated", "one point", "a line"]))
def test_kabsch_never_gives_a_reflection(seed, what):
    points = cloud(seed, 5)
    if what == "one point":
        points[:] = points[0]
    elif what == "a line":
        points = points[:1] * np.arange(5.0)[:, None]
    target = {"mirrored": points * [1, 1, -1], "unrelated": cloud(seed + 1, 5)}.get(what, points)
    assert is_rigid(se3.kabsch(points, target))


def angle_between(p, q):
    """Of the rotation from one to the other, the shorter way."""
    q = np.sign(p @ q) * q
    return 4 * np.arctan2(np.linalg.norm(p - q), np.linalg.norm(p + q))


def rotation_of(q):
    return se3.from_quaternion(np.zeros(3), q)[:3, :3]


@given(quaternions, quaternions, st.floats(0, 1))
def test_slerp_goes_the_shorter_arc_at_constant_speed(p, q, s):
    assume(abs(p @ q) > 1e-6)  # at half a turn both arcs are shortest
    mixed = se3.slerp(p, q, s)
    whole = angle_between(p, q)
    assert np.linalg.norm(mixed) == pytest.approx(1)
    assert angle_between(p, mixed) == pytest.approx(s * whole, abs=1e-6)
    assert angle_between(mixed, q) == pytest.approx((1 - s) * whole, abs=1e-6)
    np.testing.assert_allclose(rotation_of(se3.slerp(p, -q, s)), rotation_of(mixed), atol=1e-9)


@given(quaternions, quaternions)
def test_slerp_ends_and_middle(p, q):
    assume(abs(p @ q) > 1e-6)
    np.testing.assert_allclose(se3.slerp(p, q, 0.0), p, atol=1e-9)
    np.testing.assert_allclose(rotation_of(se3.slerp(p, q, 1.0)), rotation_of(q), atol=1e-9)
    first, half, last = (rotation_of(x) for x in (p, se3.slerp(p, q, 0.5), q))
    np.testing.assert_allclose(half @ first.T @ half, last, atol=1e-9)


@given(metres, quaternions)
def test_from_quaternion_is_rigid_and_is_scipys(t, q):
    T = se3.from_quaternion(t, q)
    assert is_rigid(T)
    np.testing.assert_allclose(T[:3, :3], Rotation.from_quat(q).as_matrix(), atol=1e-12)
    np.testing.assert_array_equal(T[:3, 3], t)
    np.testing.assert_array_equal(se3.from_quaternion(t[None], q[None])[0], T)


def test_from_quaternion_takes_w_last():
    T = se3.from_quaternion(np.array([1.0, 2, 3]), np.array([0, 0, 0.5**0.5, 0.5**0.5]))  # x turns into y
    np.testing.assert_allclose(T @ [1, 0, 0, 1], [1, 3, 3, 1], atol=1e-12)


@given(metres, metres)
def test_skew_is_the_cross_product(a, b):
    np.testing.assert_allclose(se3.skew(a) @ b, np.cross(a, b), atol=1e-9)
