"""What `info` tells, and that it reads no more than it needs."""

import json
import math

import numpy as np
import pytest

import bags
from bags import ORIGIN_NS, STEP_NS, Messages
from tum_folder import write_tum_folder
from vlmm_log.survey import info
from vlmm_log.types import InputError

OPTICAL = "camera_optical"


def bag(tmp_path, kind, frames=20):
    """Frames of 64x48, the chain map -> base -> camera over all of it."""
    m = Messages(kind)
    rgb, depth = np.zeros((48, 64, 3), np.uint8), np.full((48, 64), 1500, np.uint16)
    depth[:, :16] = 0
    records = []
    for k in range(frames):
        t = ORIGIN_NS + k * STEP_NS
        records += [("/cam/rgb/image_raw", t, m.image(t, OPTICAL, rgb, "rgb8"))]
        records += [("/cam/rgb/camera_info", t, m.camera_info(t, OPTICAL))]
        records += [("/cam/depth_registered/image_raw", t + 1, m.image(t, OPTICAL, depth, "16UC1"))]
        records += [("/tf", t, m.tf(t, ("map", "base", [0.1 * k, 0, 0, 0, 0, 0, 1.0])))]
        records += [("/odom", t, m.odometry(t, "odom", "base", [0.0] * 6 + [1.0]))]
    records += [("/tf_static", t, m.tf(0, ("base", OPTICAL, [0.0] * 6 + [1.0])))]
    return bags.write(bags.suffixed(tmp_path, kind), kind, records)


@pytest.mark.parametrize("kind", bags.KINDS)
def test_a_bag_is_told_by_its_index_and_first_frame(tmp_path, kind):
    told = info(bag(tmp_path, kind))
    by_role = {s.role: s for s in told.streams if s.role}
    assert by_role["rgb"].name == "/cam/rgb/image_raw"
    assert by_role["depth"].count == 20
    assert math.isclose(by_role["depth"].rate_hz, 1e9 / STEP_NS)
    assert by_role["depth"].longest_gap_s == STEP_NS / 1e9
    assert {s.name for s in told.streams if s.role == "pose"} == {"/tf", "/tf_static"}
    assert {s.name for s in told.streams if not s.role} == {"/odom"}
    assert told.poses == f"tf, map -> base -> {OPTICAL}"
    assert (told.first.width, told.first.height, told.first.depth_seen) == (64, 48, 0.75)
    assert told.first.depth_median_m == 1.5
    assert told.intrinsics["fx"] == 60
    assert told.depth_units_per_meter == 1000
    assert told.depth_registered
    assert len(told.candidates["pose"]) == 2
    assert not told.skipped


def test_a_folder_is_told_with_its_coverage(tmp_path):
    poses = "".join(f"{1305031237 + k * 0.1:.1f} 0 0 0 0 0 0 1\n" for k in range(3))
    told = info(write_tum_folder(tmp_path / "log", frames=4, groundtruth=poses))
    assert told.poses == "groundtruth.txt, 3 of 4 frames"
    assert told.frames == 4
    assert [s.role for s in told.streams] == ["rgb", "depth", "pose"]


def test_the_report_is_json_without_nan(tmp_path):
    told = info(write_tum_folder(tmp_path / "log", frames=1))
    text = json.dumps(told.report(), allow_nan=False)
    assert json.loads(text)["streams"][0]["rate_hz"] is None


def test_a_long_bag_is_not_read_through(tmp_path, monkeypatch):
    """Payloads that are decoded do not grow with the log."""
    from vlmm_log.readers.bag import log

    counts = []
    for frames in (200, 400):
        (tmp_path / str(frames)).mkdir()
        path = bag(tmp_path / str(frames), "mcap", frames)
        seen = []
        opened = log.open_container(path)
        original = type(opened).messages

        def counted(self, *args, original=original, seen=seen):
            for message in original(self, *args):
                seen.append(message)
                yield message

        monkeypatch.setattr(type(opened), "messages", counted)
        info(path)
        monkeypatch.undo()
        counts.append(len(seen))
    assert counts[0] == counts[1] < 1000


@pytest.mark.parametrize("kind", bags.KINDS)
def test_a_bag_without_images_is_told_by_its_topics(tmp_path, kind):
    m = Messages(kind)
    records = [("/odom", ORIGIN_NS + k, m.odometry(ORIGIN_NS, "odom", "base", [0.0] * 6 + [1.0])) for k in range(3)]
    told = info(bags.write(bags.suffixed(tmp_path, kind), kind, records))
    assert [(x.name, x.count, x.role) for x in told.streams] == [("/odom", 3, "")]
    assert "no depth topic" in told.problem
    assert told.frames == 0


def test_a_bag_that_is_none_is_refused(tmp_path):
    (tmp_path / "a.bag").write_bytes(b"#ROSBAG V2.0")
    with pytest.raises(InputError):
        info(tmp_path / "a.bag")
