"""Ten kills; `python -m benchmarks.kill` tries hundreds."""

import sys

import numpy as np
import pytest
from killing import DEEDS, FOUND, frames_hash, trial, whole
from small_room import write_small_room

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="what holds after a kill is tried on Linux")
TRIED = [deed for deed in DEEDS if deed.name in ("process --resume", "process", "convert, ros2", "batch")]


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    folder = tmp_path_factory.mktemp("log") / "room"
    write_small_room(folder, 8)
    return folder


@pytest.fixture(scope="module")
def good(room, tmp_path_factory):
    return whole(room, tmp_path_factory.mktemp("whole"), tuple(TRIED))


@pytest.mark.parametrize("k", range(10))
def test_after_a_kill_outputs_are_whole_or_absent_and_the_rest_can_be_done(room, good, tmp_path, k):
    deed = TRIED[k % len(TRIED)]
    found = trial(deed, room, tmp_path / "trial", good, np.random.default_rng([7, k]))
    assert found in FOUND  # a promise that does not hold is raised


def test_frames_are_told_apart(room, tmp_path):
    write_small_room(tmp_path / "other", 9)
    assert frames_hash(room) != frames_hash(tmp_path / "other")
