"""Bags: which topics are taken, what their messages become, and what is told as left out."""

from collections import Counter

import cv2
import numpy as np
import pytest

import bags
from bags import KINDS, ORIGIN_NS, STEP_NS, Messages
from vlmm_log import convert, se3
from vlmm_log.readers import open_log
from vlmm_log.readers.compressed_depth import encode
from vlmm_log.settings import Settings
from vlmm_log.types import Frame, InputError, Skipped

OPTICAL = "camera_rgb_optical_frame"
EVER = 2**62
RNG = np.random.default_rng(7)
COLOURS = [RNG.integers(0, 256, (48, 64, 3), np.uint8) for _ in range(6)]
DEPTHS = [RNG.integers(0, 4000, (48, 64), np.uint16) for _ in range(6)]
STAMPS = [ORIGIN_NS + k * STEP_NS for k in range(6)]
RGB, DEPTH, INFO = "/camera/rgb/image_raw", "/camera/depth_registered/image_raw", "/camera/rgb/camera_info"


def at(stamp_ns):
    """A pose that moves and turns with time (7,)."""
    t = (stamp_ns - ORIGIN_NS) / 1e9
    q = se3.quaternion(se3.exp(np.array([0.1 * t, 0.4 * t, -0.2 * t, 0, 0, 0])))
    return [1.0 + t, 2.0, -0.5 * t, *q.tolist()]


def matrix(v):
    return se3.from_quaternion(np.array(v[:3], float), np.array(v[3:], float))


def images(m, *, latency_ns=5_000_000, info=True, depth_topic=DEPTH, depth_frame=OPTICAL):
    """Colour, depth and camera_info of every moment, recorded a little after their stamps."""
    for stamp, colour, depth in zip(STAMPS, COLOURS, DEPTHS, strict=True):
        yield RGB, stamp + latency_ns, m.image(stamp, OPTICAL, colour, "rgb8")
        yield depth_topic, stamp + latency_ns + 1, m.image(stamp, depth_frame, depth, "16UC1")
        if info:
            yield INFO, stamp + latency_ns + 2, m.camera_info(stamp, OPTICAL)


def tf(m, *links, every_ns=10_000_000, still=()):
    """/tf over the whole log, /tf_static in its last moment."""
    for stamp in range(STAMPS[0] - 20_000_000, STAMPS[-1] + 30_000_000, every_ns):
        moved = [(parent, child, value(stamp) if callable(value) else value) for parent, child, value in links]
        yield "/tf", stamp + 1_000_000, m.tf(stamp, *moved)
    if still:
        yield "/tf_static", STAMPS[-1] + 90_000_000, m.tf(0, *still)


def made(tmp_path, kind, *records):
    ordered = sorted((r for part in records for r in part), key=lambda r: r[1])
    return bags.write(bags.suffixed(tmp_path, kind), kind, ordered)


def read(path, *sets, window=(0, EVER)):
    items = list(open_log(path, Settings.load(sets=sets).read).frames(*window))
    return [x for x in items if isinstance(x, Frame)], [x for x in items if isinstance(x, Skipped)]


def metres(depth, units=1000):
    out = (depth / np.float32(units)).astype(np.float32)
    return np.where((out < np.float32(0.1)) | (depth == 0), np.float32(np.nan), out)


# ---- images


@pytest.mark.parametrize("kind", KINDS)
def test_frames_are_what_was_written(tmp_path, kind):
    m = Messages(kind)
    frames, left_out = read(made(tmp_path, kind, images(m)))
    assert [f.stamp_ns for f in frames] == STAMPS
    assert [f.index for f in frames] == list(range(6))
    for f, colour, depth in zip(frames, COLOURS, DEPTHS, strict=True):
        np.testing.assert_array_equal(f.rgb, colour)
        np.testing.assert_array_equal(f.depth, metres(depth))
        np.testing.assert_array_equal(f.K, np.array(bags.K).reshape(3, 3))
        assert f.T_world_cam is None
    assert not left_out


@pytest.mark.parametrize("kind", KINDS)
def test_encoded_images_pass_their_bytes_on(tmp_path, kind):
    m = Messages(kind)
    pngs = [cv2.imencode(".png", c[..., ::-1])[1].tobytes() for c in COLOURS]
    records = [(RGB + "/compressed", t, m.compressed(t, OPTICAL, p, "png")) for t, p in zip(STAMPS, pngs, strict=True)]
    form = "16UC1; compressedDepth png"
    records += [
        (DEPTH + "/compressedDepth", t, m.compressed(t, OPTICAL, encode(d, "png"), form))
        for t, d in zip(STAMPS, DEPTHS, strict=True)
    ]
    records += [(INFO, t, m.camera_info(t, OPTICAL)) for t in STAMPS]
    frames, _ = read(made(tmp_path, kind, records))
    assert len(frames) == 6
    for f, colour, depth, png in zip(frames, COLOURS, DEPTHS, pngs, strict=True):
        np.testing.assert_array_equal(f.rgb, colour)
        np.testing.assert_array_equal(f.depth, metres(depth))
        assert f.encoded_rgb.data == png
        np.testing.assert_array_equal(cv2.imdecode(np.frombuffer(f.encoded_depth.data, np.uint8), -1), depth)
        assert f.encoded_depth.units_per_meter == 1000


def test_float_depth_is_metres_and_padding_is_skipped(tmp_path):
    m = Messages("mcap")
    depth = DEPTHS[0].astype(np.float32) / 1000
    depth[0, 0] = np.nan
    records = [
        (RGB, ORIGIN_NS, m.image(ORIGIN_NS, OPTICAL, COLOURS[0][..., ::-1], "bgr8", padding=5)),
        (DEPTH, ORIGIN_NS, m.image(ORIGIN_NS, OPTICAL, depth, "32FC1", padding=8, big_endian=True)),
        (INFO, ORIGIN_NS, m.camera_info(ORIGIN_NS, OPTICAL)),
    ]
    frames, _ = read(made(tmp_path, "mcap", records))
    np.testing.assert_array_equal(frames[0].rgb, COLOURS[0])
    np.testing.assert_array_equal(frames[0].depth, np.where(depth < np.float32(0.1), np.float32(np.nan), depth))


@pytest.mark.parametrize("kind", ["bag", "mcap"])
@pytest.mark.parametrize(("start", "stop"), [(0, 2), (1, 4), (3, 99), (5, 6), (6, 9)])
def test_a_window_is_a_slice_of_the_whole(tmp_path, kind, start, stop):
    path = made(tmp_path, kind, images(Messages(kind)), tf(Messages(kind), ("world", OPTICAL, at)))
    whole, _ = read(path)
    part, _ = read(path, window=(start * STEP_NS, stop * STEP_NS))
    assert [f.index for f in part] == [f.index for f in whole[start:stop]]
    for a, b in zip(part, whole[start:stop], strict=True):
        np.testing.assert_array_equal(a.T_world_cam, b.T_world_cam)


# ---- cameras


def test_a_rectified_topic_is_measured_with_P(tmp_path):
    m = Messages("ros2")
    P = (50.0, 0, 30.0, 0, 0, 51.0, 20.0, 0, 0, 0, 1.0, 0)
    lens = (0.1, -0.05, 0.001, 0.0, 0.0)
    records = [(t.replace("image_raw", "image_rect_color"), ns, x) for t, ns, x in images(m, info=False)]
    records += [(INFO, t, m.camera_info(t, OPTICAL, p=P, d=lens)) for t in STAMPS]
    log = open_log(made(tmp_path, "ros2", records))
    assert (log.camera.fx, log.camera.fy, log.camera.cx, log.camera.cy) == (50, 51, 30, 20)
    assert not log.camera.distortion


def test_a_name_that_holds_rect_is_not_rectified(tmp_path):
    m = Messages("mcap")
    records = [(t.replace("/camera/", "/camera_direct/"), ns, x) for t, ns, x in images(m, info=False)]
    lens = (0.1, -0.05, 0.001, 0.0, 0.0)
    records += [("/camera_direct/rgb/camera_info", t, m.camera_info(t, OPTICAL, d=lens)) for t in STAMPS]
    assert open_log(made(tmp_path, "mcap", records)).camera.distortion == lens


def test_a_raw_topic_with_a_lens_is_rectified_and_says_so(tmp_path):
    m = Messages("ros2")
    records = [*images(m, info=False)]
    records += [(INFO, t, m.camera_info(t, OPTICAL, d=(0.1, -0.05, 0.001, 0.0, 0.0))) for t in STAMPS]
    path = made(tmp_path, "ros2", records)
    frames, _ = read(path)
    assert any("lens distortion undone: plumb_bob 0.1" in note for note in open_log(path).notes)
    assert not np.array_equal(frames[0].rgb, COLOURS[0])
    assert frames[0].encoded_rgb is None
    plain, _ = read(path, "read.distortion=none")
    np.testing.assert_array_equal(plain[0].rgb, COLOURS[0])


def test_a_bag_without_camera_info_says_what_to_give(tmp_path):
    path = made(tmp_path, "bag", images(Messages("bag"), info=False))
    with pytest.raises(InputError, match="no camera_info for /camera/rgb/image_raw; give --topics info=NAME or --intr"):
        open_log(path)
    frames, _ = read(path, "read.intrinsics=60,60,31.5,23.5")
    assert len(frames) == 6


def test_depth_of_another_camera_is_registered(tmp_path):
    """A plane 2 m ahead, seen by a depth camera 0.1 m to the left: its image moves by fx b / z = 3 px."""
    m = Messages("mcap")
    topic, frame = "/camera/depth/image_raw", "camera_depth_optical_frame"
    depth = np.full((48, 64), 2000, np.uint16)
    depth[:, 32:] = 0
    records = [(RGB, t, m.image(t, OPTICAL, c, "rgb8")) for t, c in zip(STAMPS, COLOURS, strict=True)]
    records += [(topic, t, m.image(t, frame, depth, "16UC1")) for t in STAMPS]
    records += [(INFO, t, m.camera_info(t, OPTICAL)) for t in STAMPS]
    records += [("/camera/depth/camera_info", t, m.camera_info(t, frame)) for t in STAMPS]
    with pytest.raises(InputError, match=r"is not registered to colour .* give --set read.depth_to_rgb"):
        open_log(made(tmp_path, "mcap", records))
    (tmp_path / "log.mcap").unlink()
    left = ("camera_link", frame, [-0.1, 0, 0, 0, 0, 0, 1.0]), ("camera_link", OPTICAL, [0, 0, 0, 0, 0, 0, 1.0])
    path = made(tmp_path, "mcap", records, [("/tf_static", STAMPS[-1] + 10**9, m.tf(0, *left))])
    frames, _ = read(path)
    row = frames[0].depth[24]
    assert np.isnan(row[29:]).all()
    assert np.allclose(row[:29], 2.0)
    same, _ = read(path, "read.depth_to_rgb=-0.1,0,0,0,0,0,1")
    np.testing.assert_array_equal(same[0].depth, frames[0].depth)
    as_is, _ = read(path, "read.depth_to_rgb=registered")
    np.testing.assert_array_equal(as_is[0].depth, metres(depth))


# ---- poses


@pytest.mark.parametrize("kind", KINDS)
def test_transforms_of_the_whole_log_are_chained(tmp_path, kind):
    """map -> odom -> base -> camera: two links move, the still ones are published once, in the last moment."""
    m = Messages(kind)
    mount, turn = [0.1, 0.2, 0.3, 0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0, -0.5, 0.5, -0.5, 0.5]
    drift = [0.5, 0.0, 0.0, 0.0, 0.0, 0.6, 0.8]
    still = ("base", "camera_link", mount), ("camera_link", OPTICAL, turn)
    path = made(tmp_path, kind, images(m), tf(m, ("map", "odom", drift), ("odom", "base", at), still=still))
    frames, left_out = read(path)
    assert not left_out
    for f in frames:
        lower = (f.stamp_ns - (STAMPS[0] - 20_000_000)) // 10_000_000 * 10_000_000 + STAMPS[0] - 20_000_000
        share = (f.stamp_ns - lower) / 1e7
        a, b = np.array(at(lower)), np.array(at(lower + 10_000_000))
        base = se3.from_quaternion((1 - share) * a[:3] + share * b[:3], se3.slerp(a[3:], b[3:], share))
        np.testing.assert_allclose(f.T_world_cam, matrix(drift) @ base @ matrix(mount) @ matrix(turn), atol=1e-9)
    log = open_log(path)
    assert any(f"tf, map -> odom -> base -> camera_link -> {OPTICAL}" in note for note in log.notes)
    assert log.world_up == "+z"


def test_odometry_is_carried_to_the_camera(tmp_path):
    m = Messages("ros2")
    mount = [0.1, 0.2, 0.3, -0.5, 0.5, -0.5, 0.5]
    odometry = [("/odom", t, m.odometry(t, "odom", "base", at(t))) for t in STAMPS]
    static = [("/tf_static", STAMPS[0], m.tf(0, ("base", OPTICAL, mount)))]
    frames, _ = read(made(tmp_path, "ros2", images(m), odometry, static), "read.topics=pose=/odom")
    for f in frames:
        np.testing.assert_allclose(f.T_world_cam, matrix(at(f.stamp_ns)) @ matrix(mount), atol=1e-9)


@pytest.mark.parametrize("source", ["/odom", "tf"])
def test_what_is_asked_of_listed_poses_leaves_the_mount_alone(tmp_path, source):
    """A bag's own transform from the tracked frame to the camera is not inverted, and is replaced by the user's."""
    m = Messages("ros2")
    mount, other = [0.1, 0.2, 0.3, -0.5, 0.5, -0.5, 0.5], [0.0, 0.5, 0.0, 0.0, 0.0, 0.6, 0.8]

    def inverted(stamp_ns):
        T = se3.inverse(matrix(at(stamp_ns)))
        return [*T[:3, 3], *se3.quaternion(T)]

    for listed, mapping in ((at, "camera_to_world"), (inverted, "world_to_camera")):
        odometry = [("/odom", t, m.odometry(t, "odom", "base", listed(t))) for t in STAMPS]
        moved = [("/tf", t, m.tf(t, ("odom", "base", listed(t)))) for t in STAMPS]
        static = [("/tf_static", STAMPS[0], m.tf(0, ("base", OPTICAL, mount)))]
        path = made(tmp_path / mapping, "ros2", images(m), odometry if source == "/odom" else moved, static)
        sets = f"read.poses={mapping}", f"read.topics=pose={source}"
        for asked, expected in (("", mount), (",".join(map(str, other)), other), ("none", [0.0] * 6 + [1.0])):
            frames, _ = read(path, *sets, f"read.pose_to_camera={asked}")
            for f in frames:
                np.testing.assert_allclose(f.T_world_cam, matrix(at(f.stamp_ns)) @ matrix(expected), atol=1e-9)


def test_transforms_of_other_frames_cost_the_camera_no_pose(tmp_path):
    """An arm that publishes NaN is told, and does not stop doctor from examining poses."""
    m = Messages("ros2")
    nowhere = [float("nan")] * 3 + [0.0, 0, 0, 1]
    moved = [("/tf", t, m.tf(t, ("odom", OPTICAL, at(t)), ("arm", "gripper", nowhere))) for t in STAMPS]
    bad = [("/tf", STAMPS[3] + 1, m.tf(STAMPS[3] + 1, ("odom", OPTICAL, nowhere)))]
    log = open_log(made(tmp_path, "ros2", images(m), moved, bad))
    told = Counter(x.reason for x in log.frames(0, 10**18) if isinstance(x, Skipped))
    assert told == {"not of the camera's frames: pose is not finite": len(STAMPS), "pose is not finite": 1}


def test_transforms_that_carry_the_camera_are_known_when_all_is_read(tmp_path):
    """Its mount is said before the window alone; the world that was asked for is carried by a marker."""
    m = Messages("ros2")
    nowhere = [float("nan")] * 3 + [0.0, 0, 0, 1]
    mount = [("/tf", STAMPS[0], m.tf(STAMPS[0], ("base", OPTICAL, [0.0] * 6 + [1.0])))]
    moved = [("/tf", t, m.tf(t, ("odom", "base", at(t)))) for t in STAMPS]
    bad = [("/tf", STAMPS[4] + 1, m.tf(STAMPS[4] + 1, ("odom", "base", nowhere)))]
    bad += [("/tf", STAMPS[4] + 2, m.tf(STAMPS[4] + 2, ("odom", "marker", nowhere)))]
    still = [("/tf", STAMPS[4] + 3, m.tf(STAMPS[4] + 3, ("odom", "marker", [0.0] * 6 + [1.0])))]
    path = made(tmp_path, "ros2", images(m), mount, moved, bad, still)
    start_s = (STAMPS[3] - STAMPS[0]) / 1e9
    for world, carried in (("", 1), (":marker", 2)):
        s = Settings.load(sets=[f"read.start_s={start_s}", "read.pose_gap_s=0.001", f"read.topics=pose=tf{world}"])
        told = Counter(x.reason for x in open_log(path, s.read).frames(0, EVER) if isinstance(x, Skipped))
        assert told["pose is not finite"] == carried
        assert told["not of the camera's frames: pose is not finite"] == 2 - carried


@pytest.mark.parametrize("source", ["tf", "tf:world", ""])
def test_a_camera_on_a_tripod_stands_where_its_still_transforms_say(tmp_path, source):
    m = Messages("ros2")
    stand, lens = [1.0, 2.0, 3.0, 0.0, 0.0, 0.6, 0.8], [0.1, 0.2, 0.3, -0.5, 0.5, -0.5, 0.5]
    robot = tf(m, ("world", "robot", at), still=(("world", "tripod", stand), ("tripod", OPTICAL, lens)))
    path = made(tmp_path, "ros2", images(m), robot)
    frames, left_out = read(path, *([f"read.topics=pose={source}"] if source else []))
    assert len(frames) == len(STAMPS)
    assert not left_out
    for f in frames:
        np.testing.assert_allclose(f.T_world_cam, matrix(stand) @ matrix(lens), atol=1e-12)
    s = Settings.load(sets=[f"read.topics=pose={source}"] if source else [])
    assert any(note.startswith("a still pose from tf, world -> tripod") for note in open_log(path, s.read).notes)


@pytest.mark.parametrize("name", ["log.mcap", "log.bag", "log"])
def test_the_pose_of_a_camera_on_a_tripod_is_converted(tmp_path, name):
    m = Messages("ros2")
    still = tf(m, still=(("world", OPTICAL, at(STAMPS[2])),))
    out = tmp_path / "out" / name
    convert(
        made(tmp_path, "ros2", images(m), [(topic, t, data) for topic, t, data in still if topic == "/tf_static"]), out
    )
    frames, left_out = read(out)
    assert not left_out
    for f in frames:
        np.testing.assert_allclose(f.T_world_cam, matrix(at(STAMPS[2])), atol=1e-9)


def test_ground_truth_poses_come_before_transforms(tmp_path):
    m = Messages("bag")
    truth = [("/vicon/camera", t, m.pose_stamped(t, "world", at(t))) for t in STAMPS]
    path = made(tmp_path, "bag", images(m), truth, tf(m, ("odom", OPTICAL, [0.0] * 6 + [1.0])))
    frames, _ = read(path)
    np.testing.assert_allclose(frames[3].T_world_cam, matrix(at(STAMPS[3])), atol=1e-12)
    assert any("/vicon/camera does not name what it tracks" in note for note in open_log(path).notes)
    others, _ = read(path, "read.topics=pose=none")
    assert others[0].T_world_cam is None


def test_of_a_path_the_last_message_counts(tmp_path):
    m = Messages("mcap")
    early = [m.pose_stamped(t, "map", [9.0, 9, 9, 0, 0, 0, 1]) for t in STAMPS[:3]]
    final = [m.pose_stamped(t, "map", at(t)) for t in STAMPS]
    paths = [("/slam/path", STAMPS[2], m.path(STAMPS[2], "map", early))]
    paths += [("/slam/path", STAMPS[-1] + 10**9, m.path(STAMPS[-1], "map", final))]
    frames, _ = read(made(tmp_path, "mcap", images(m), paths))
    for f in frames:
        np.testing.assert_allclose(f.T_world_cam, matrix(at(f.stamp_ns)), atol=1e-12)


def test_a_moving_mount_is_no_world(tmp_path):
    """base -> pan -> camera moves, but where the robot went only odometry knows."""
    m = Messages("bag")
    odometry = [("/odom", t, m.odometry(t, "odom", "base", at(t))) for t in STAMPS]
    pan = tf(m, ("base", "pan", at), ("pan", OPTICAL, [0.0] * 6 + [1.0]))
    frames, _ = read(made(tmp_path, "bag", images(m), odometry, pan))
    for f in frames:
        assert not np.allclose(f.T_world_cam, matrix(at(f.stamp_ns)))
    log = open_log(tmp_path / "log.bag")
    assert log.poses.source == log.posed == "/odom"
    assert len(log.poses.moving) == 2  # the robot and its pan


def test_a_window_has_the_poses_of_the_whole(tmp_path):
    """One transform is said once, in the beginning; the others come five seconds before their images."""
    m = Messages("mcap")
    drift = [5.0, 0, 0, 0, 0, 0, 1.0]
    early = [(t, at(t)) for t in range(STAMPS[0] - 10**7, STAMPS[-1] + 10**7, 10**7)]
    moving = [("/tf", t - 5 * 10**9, m.tf(t - 5 * 10**9, ("odom", OPTICAL, v))) for t, v in early]
    once = [("/tf", early[0][0] - 6 * 10**9, m.tf(early[0][0] - 6 * 10**9, ("map", "odom", drift)))]
    path = made(tmp_path, "mcap", images(m), moving, once)
    sets = ("read.pose_offset_s=5",)
    whole, _ = read(path, *sets)
    window = (f"read.start_s={2 * STEP_NS / 1e9}", f"read.stop_s={4.5 * STEP_NS / 1e9}")
    part, _ = read(path, *sets, *window, window=(2 * STEP_NS, 5 * STEP_NS))
    assert [f.index for f in part] == [2, 3, 4]
    for a, b in zip(part, whole[2:5], strict=True):
        np.testing.assert_array_equal(a.T_world_cam, b.T_world_cam)


def test_a_camera_that_is_its_own_world_has_no_poses(tmp_path):
    m = Messages("ros2")
    path = made(tmp_path, "ros2", images(m), tf(m, (OPTICAL, "tag", at)))
    assert open_log(path).poses is None
    with pytest.raises(InputError, match="no transforms join"):
        _ = open_log(path, Settings.load(sets=[f"read.topics=pose=tf:{OPTICAL}"]).read).poses


def test_gaps_in_transforms_are_told(tmp_path):
    m = Messages("bag")
    moving = [r for r in tf(m, ("world", OPTICAL, at)) if not STAMPS[1] < r[1] < STAMPS[4]]
    frames, left_out = read(made(tmp_path, "bag", images(m), moving), "read.pose_gap_s=0.05")
    assert [f.T_world_cam is None for f in frames] == [False, True, True, True, True, False]
    assert {x.reason for x in left_out} == {"no two poses around it within 0.05 s"}


# ---- topics


def test_the_guess_prefers_registered_depth_and_colour_beside_it(tmp_path):
    m = Messages("ros2")
    aligned = "/camera/aligned_depth_to_color/image_raw"
    more = [("/camera/infra1/image_rect_raw", t, m.image(t, "ir", COLOURS[0][..., 0], "mono8")) for t in STAMPS]
    more += [("/camera/depth/image_rect_raw", t, m.image(t, "depth", DEPTHS[0], "16UC1")) for t in STAMPS]
    records = images(m, depth_topic=aligned)
    log = open_log(made(tmp_path, "ros2", records, more))
    assert (log.choice.rgb.topic.name, log.choice.depth.topic.name) == (RGB, aligned)
    assert log.ranked["depth"][0].startswith(aligned)
    assert len(log.ranked["rgb"]) == 2


@pytest.mark.parametrize(
    ("topics", "message"),
    [
        ("rgb=/nowhere", "no topic /nowhere for rgb; there are "),
        ("colour=/a", "write role=topic, with roles rgb, depth, info, depth_info, pose"),
        ("rgb", "write role=topic"),
        (f"depth={INFO}", "holds no image that can be read"),
    ],
)
def test_topics_that_cannot_be_are_refused(tmp_path, topics, message):
    path = made(tmp_path, "mcap", images(Messages("mcap")))
    with pytest.raises(InputError, match=message):
        read(path, f"read.topics={topics!r}")


def test_a_bag_without_images_says_what_it_holds(tmp_path):
    m = Messages("bag")
    with pytest.raises(InputError, match=r"no depth topic .*there are /odom \(nav_msgs/msg/Odometry\)"):
        open_log(made(tmp_path, "bag", [("/odom", 5, m.odometry(5, "odom", "base", [0.0] * 6 + [1.0]))]))


# ---- damage


@pytest.mark.parametrize("kind", KINDS)
def test_messages_that_cannot_be_used_are_counted(tmp_path, kind):
    m = Messages(kind)
    records = list(images(m))
    name = "sensor_msgs/msg/Image"
    records[3] = (RGB, records[3][1], b"", name)
    small = m.image(STAMPS[2], OPTICAL, COLOURS[2][:40], "rgb8")
    records[6] = (RGB, records[6][1], small)
    odd = m.image(STAMPS[3], OPTICAL, COLOURS[3], "yuv999")
    records[9] = (RGB, records[9][1], odd)
    frames, left_out = read(made(tmp_path, kind, records))
    assert [f.index for f in frames] == [0, 4, 5]
    reasons = [x.reason for x in left_out]
    assert any("empty" in r for r in reasons)
    assert any("register depth to colour first" in r for r in reasons)
    assert any("yuv999" in r for r in reasons)
    assert any("no colour image within" in r for r in reasons)
