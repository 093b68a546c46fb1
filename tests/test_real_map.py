"""The map of real recordings, where they are at hand: one person, the leaf of a door, rolling fruit."""

import os
from pathlib import Path

import numpy as np
import pytest

import vlmm_log
from vlmm_log.elements import MotionClass

SHARED = Path(__file__).resolve().parents[2] / "shared"
DATA = Path(os.environ.get("VLMM_LOG_DATA", SHARED / "data"))
WEIGHTS = Path(os.environ.get("VLMM_LOG_WEIGHTS", SHARED / "weights"))
SLICE = DATA / "rgbd_dataset_freiburg1_rpy_225_345"
YOLO = WEIGHTS / "yolov8n-seg.onnx"
NOMINAL = "525,525,319.5,239.5"


def mapped(source, *sets):
    if not source.exists():
        pytest.skip(f"{source} is not here; VLMM_LOG_DATA can name the folder that holds it")
    return vlmm_log.process(source, settings=vlmm_log.Settings.load(sets=sets)).map


def test_the_seated_person_is_one_element_that_moved_while_monitors_did_not():
    pytest.importorskip("onnxruntime", reason="YOLO masks need onnxruntime: pip install 'vlmm-log[yolo]'")
    if not YOLO.exists():
        pytest.skip(f"{YOLO} is not here; VLMM_LOG_WEIGHTS can name the folder that holds it")
    saved = mapped(SLICE, f"objects.segmenter=yolo:{YOLO}", "read.stop_s=1.2")
    elements = saved.world.elements.values()
    people = [e for e in elements if "person" in e.evidence.votes]
    assert 1 <= len(people) <= 2
    (person,) = (e for e in people if len(e.evidence.observations) > 25)  # of 33 pairs
    (turn,) = (person.intervals - saved.origin_ns) / 1e9
    assert 0.4 < turn[0] < 0.7 and 0.8 < turn[1] < 1.2  # he turns the head
    screens = [e for e in elements if e.label in ("tv", "laptop", "keyboard")]
    assert screens
    assert not any(e.motion_class is MotionClass.MOVING for e in screens)
    assert vlmm_log.query(saved, "who moved").ids.tolist() == [person.id]


def test_the_leaf_of_a_door_and_who_opens_it_move_and_the_shelf_does_not():
    saved = mapped(DATA / "moving_pairs/opening_door", "keyframes.gap=1", f"read.intrinsics={NOMINAL}")
    moving = [e for e in saved.world.elements.values() if e.motion_class is MotionClass.MOVING]
    leaf, person = sorted(moving, key=lambda e: e.position[0])
    assert leaf.position == pytest.approx([-0.7, 0.2, 1.9], abs=0.15)
    assert person.position == pytest.approx([-0.3, 0.5, 2.1], abs=0.15)
    still = [e for e in saved.world.elements.values() if e.position[0] > 0]
    assert len(still) >= 3
    assert not any(e.motion_class is MotionClass.MOVING for e in still)


def test_rolling_fruit_moves_and_the_laptop_does_not():
    saved = mapped(DATA / "fruit_on_table", "keyframes.gap=1", "read.start_s=14", "read.stop_s=18")
    elements = saved.world.elements.values()
    moving = [e for e in elements if e.motion_class is MotionClass.MOVING]
    small = [e for e in moving if np.median(e.evidence.observations["pixels"]) < 3000]
    assert len(small) >= 8  # pieces of fruit, some under several ids
    laptop = [
        e for e in elements if e.position[0] < -0.15 and e.position[2] < 0.8 and e.evidence.feature_pixels > 10000
    ]
    assert laptop
    assert not any(e.motion_class is MotionClass.MOVING for e in laptop)
