"""Poses on their way into a frame: quaternions, axes, a tree's frames. Each of these once survived a mutation."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vlmm_log.readers.bag.messages import Placed, stamp_of
from vlmm_log.readers.bag.transforms import Tree
from vlmm_log.readers.conventions import AXES, rigid_from_text
from vlmm_log.readers.matrices import matrix_in
from vlmm_log.readers.poses import unit

X, Y, Z = np.eye(3)
TURNED = (0.0, 0.6, 0.0, 0.8)


def placed(parent, child):
    return Placed(0, parent, child, np.array([1.0, 2, 3, 0, 0, 0, 1]))


@given(st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 0.1))
def test_quaternions_are_scaled_to_unit_length_in_their_own_direction(q):
    (scaled,) = unit(np.array([q]))
    assert np.linalg.norm(scaled) == pytest.approx(1, abs=1e-12)
    assert scaled * np.linalg.norm(q) == pytest.approx(np.array(q), abs=1e-12)


def test_a_unit_quaternion_stays_to_the_bit():
    q = np.array([[0.1, 0.2, 0.3, 0.9]])
    once = unit(q)
    assert (unit(once) == once).all()


@pytest.mark.parametrize(
    ("axes", "right", "down", "forward"), [("body", -Y, -Z, X), ("opengl", X, -Y, -Z)]
)  # REP 103: x forward, y left, z up; OpenGL: x right, y up, z back
def test_axes_are_where_their_convention_says(axes, right, down, forward):
    T = AXES[axes]
    assert (T[:3, :3] == np.stack([right, down, forward], axis=1)).all()
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1)
    assert (T[:3, 3] == 0).all() and (T[3] == [0, 0, 0, 1]).all()


@pytest.mark.parametrize(
    "text", ["1,2,3,0,0,0,1.5", "1,2,3,0,0,0,0", "1,2,3,0,0,1", "1,2,x,0,0,0,1", "nan,2,3,0,0,0,1"]
)
def test_seven_numbers_that_are_no_rigid_motion(text):
    assert rigid_from_text(text) is None


def test_seven_numbers_that_are_one():
    T = rigid_from_text("1, 2, 3, " + ", ".join(map(str, TURNED)))
    assert T[:3, 3] == pytest.approx([1, 2, 3])
    assert T[:3, :3] @ Z == pytest.approx([0.96, 0, 0.28])  # 73.7 degrees about y


def test_a_matrix_file_has_four_rows_of_four(tmp_path):
    for rows, cols in ((4, 4), (4, 5), (5, 4), (3, 4)):
        file = tmp_path / f"{rows}{cols}.txt"
        np.savetxt(file, np.eye(rows, cols))
        assert (matrix_in(file) is not None) == ((rows, cols) == (4, 4))


def test_a_child_of_two_parents_is_told_and_one_of_one_is_not():
    tree = Tree()
    for parent, child in (("odom", "base"), ("map", "base"), ("base", "camera"), ("world", "odom")):
        tree.add(placed(parent, child))
    tree.add_still(placed("a_mount", "camera"))
    tree.add_still(placed("world", "odom"))
    assert tree.conflicts() == ["base has parents map, odom", "camera has parents a_mount, base"]


@pytest.mark.parametrize(("parent", "child"), [("", "camera"), ("world", ""), ("camera", "camera"), ("", "")])
def test_a_transform_needs_two_frames(parent, child):
    tree = Tree()
    tree.add(placed(parent, child))
    tree.add_still(placed(parent, child))
    assert tree.refused == {(child, "transform names no two frames"): 2}
    assert not tree.moving and not tree.still


def test_a_stamp_without_seconds_is_in_the_first_second():
    assert stamp_of(SimpleNamespace(timestamp=SimpleNamespace(nsec=5))) == 5
    assert stamp_of(SimpleNamespace(timestamp=SimpleNamespace(sec=2))) == 2 * 10**9
