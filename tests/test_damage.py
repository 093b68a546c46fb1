"""Logs that are damaged, odd or lie: commands say in one line what cannot be used, and count what is left out."""

import json
import os
from collections import Counter

import numpy as np
import pytest
from click.testing import CliRunner
from test_bag import COLOURS, DEPTH, DEPTHS, INFO, OPTICAL, RGB, STAMPS, at, images, made, matrix, metres, read, tf

from bags import KINDS, ORIGIN_NS, STEP_NS, Messages
from tum_folder import write_tum_folder
from vlmm_log.cli import cli
from vlmm_log.conversion import convert
from vlmm_log.readers import open_log
from vlmm_log.readers.bag.topics import choose
from vlmm_log.settings import Settings
from vlmm_log.survey import info
from vlmm_log.types import InputError

DAY_NS = 86_400 * 10**9


def stamped(m, stamp_of, count=12, *, log_of=lambda k: ORIGIN_NS + k * STEP_NS, info=True):
    """Colour, depth and camera_info of image k, with a stamp and a log time of its own."""
    for k in range(count):
        stamp, log_ns = stamp_of(k), log_of(k)
        yield RGB, log_ns, m.image(stamp, OPTICAL, COLOURS[k % 6], "rgb8")
        yield DEPTH, log_ns + 1, m.image(stamp, OPTICAL, DEPTHS[k % 6], "16UC1")
        if info:
            yield INFO, log_ns + 2, m.camera_info(stamp, OPTICAL)


def at_step(k):
    return ORIGIN_NS + k * STEP_NS


def settings(*sets):
    return Settings.load(sets=sets)


def reasons(left_out):
    return dict(Counter(x.reason for x in left_out))


def converted(path, out, *options):
    """The report of a command that must succeed."""
    done = CliRunner().invoke(cli, ["convert", str(path), str(out), "--json", *options], catch_exceptions=False)
    assert done.exit_code == 0
    return json.loads(done.stdout)


# ---- files


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("share", [0.0, 0.0003, 0.3, 0.7, 0.95, 0.9999])
def test_of_a_truncated_file_what_is_left_is_had_and_the_loss_told(tmp_path, kind, share):
    path = made(tmp_path, kind, images(Messages(kind)))
    whole = {f.stamp_ns: f for f in read(path)[0]}
    body = path if path.is_file() else next(p for p in path.iterdir() if p.suffix in (".db3", ".mcap"))
    body.write_bytes(body.read_bytes()[: int(share * body.stat().st_size)])
    out = tmp_path / "out.mcap"
    try:
        done = convert(path, out)
    except InputError as e:
        assert "\n" not in str(e)
        assert not [p for p in tmp_path.iterdir() if p.name.startswith("out")]
        return
    frames, _ = read(out)
    assert done.skipped or len(frames) == 6
    for f in frames:
        np.testing.assert_array_equal(f.depth, whole[f.stamp_ns].depth)
        np.testing.assert_array_equal(f.rgb, whole[f.stamp_ns].rgb)


def test_a_corrupt_chunk_is_counted_and_never_passed_on(tmp_path):
    path = made(tmp_path, "mcap", images(Messages("mcap")))
    whole = {f.stamp_ns: f for f in read(path)[0]}
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0x55
    path.write_bytes(data)
    done = converted(path, tmp_path / "out.mcap")
    frames, _ = read(tmp_path / "out.mcap")
    assert any("CRC" in reason or "damaged" in reason for reason in done["skipped"])
    assert 0 < len(frames) < 6
    for f in frames:
        np.testing.assert_array_equal(f.depth, whole[f.stamp_ns].depth)
        np.testing.assert_array_equal(f.rgb, whole[f.stamp_ns].rgb)


def test_a_folder_without_metadata_is_read_and_says_so(tmp_path):
    path = made(tmp_path, "ros2", images(Messages("ros2")))
    (path / "metadata.yaml").unlink()
    done = converted(path, tmp_path / "out.bag")
    assert done["skipped"] == {"metadata.yaml is missing; parts were taken in the order of names": 1}
    assert len(read(tmp_path / "out.bag")[0]) == 6


def test_losses_are_told_in_a_late_window_too(tmp_path):
    m = Messages("ros2")
    path = made(tmp_path, "ros2", stamped(m, at_step), tf(m, ("world", OPTICAL, lambda _: [0.0] * 7)))
    (path / "metadata.yaml").unlink()
    _, left_out = read(path, "read.start_s=0.1", window=(10**8, 10**18))
    assert "metadata.yaml is missing; parts were taken in the order of names" in reasons(left_out)
    assert "pose's quaternion is not of unit length" in reasons(left_out)


def test_a_listed_pipe_is_not_waited_for(tmp_path):
    folder = write_tum_folder(tmp_path / "log", files={"depth/1.png": None})
    os.mkfifo(folder / "depth/1.png")
    assert converted(folder, tmp_path / "out.mcap")["skipped"] == {"listed path is a pipe": 1}


# ---- clocks


@pytest.mark.parametrize(
    ("stamp_of", "kept"),
    [
        (lambda k: at_step(k) + (DAY_NS if k == 4 else 0), range(12)),  # one image from the future
        (lambda k: at_step(k) + (DAY_NS if k >= 6 else 0), range(12)),  # set forward
        (lambda k: at_step(k) - (DAY_NS if k == 4 else 0), [k for k in range(12) if k != 4]),
        (lambda k: at_step(k) - (DAY_NS if k >= 6 else 0), range(6)),  # set back: before the first frame
        (lambda k: at_step(k) if k else 0, range(12)),  # the first is stamped 1970
    ],
)
def test_a_clock_that_jumps_loses_no_image_in_silence(tmp_path, stamp_of, kept):
    path = made(tmp_path, "mcap", stamped(Messages("mcap"), stamp_of))
    frames, left_out = read(path, window=(0, 10**18))
    assert [f.index for f in frames] == list(kept)
    lost = reasons(left_out)
    pairs = lost.get("stamp lies before the first frame's", 0) + lost.get("image comes too late: by over 2 s", 0) // 2
    assert pairs == 12 - len(frames)


def test_a_folder_whose_clock_was_set_is_read_to_its_end(tmp_path):
    folder = write_tum_folder(tmp_path / "log")
    for name in ("rgb.txt", "depth.txt"):
        head, first, *rest = (folder / name).read_text().splitlines()
        (folder / name).write_text("\n".join([head, f"1.0 {first.split()[1]}", *rest]))
    log = open_log(folder)
    assert len(list(log.frames(0, 10**18))) == log.count(0, 10**18) == 4


@pytest.mark.parametrize("rate", [0.1, 0.5, 1, 4])
@pytest.mark.parametrize("kind", ["bag", "mcap"])
def test_a_window_of_simulated_time_is_whole(tmp_path, kind, rate):
    """The recorder's clock runs at another rate than that of the stamps, and is elsewhere."""
    path = made(
        tmp_path,
        kind,
        stamped(
            Messages(kind),
            lambda k: 10**9 + k * 10 * STEP_NS,
            60,
            log_of=lambda k: ORIGIN_NS + int(k * 10 * STEP_NS / rate),
        ),
    )
    frames, _ = read(path, "read.start_s=10", "read.stop_s=15", window=(10 * 10**9, 15 * 10**9))
    assert [f.index for f in frames] == list(range(31, 46))


def test_damage_is_told_where_stamps_are_of_another_clock(tmp_path):
    records = list(stamped(Messages("mcap"), lambda k: 10**9 + k * STEP_NS))
    records[3] = (RGB, records[3][1], b"", "sensor_msgs/msg/Image")
    _, left_out = read(made(tmp_path, "mcap", records), window=(0, 10**16))
    assert reasons(left_out) == {"message is empty": 1, "no colour image within 0.02 s": 1}


# ---- cameras


@pytest.mark.parametrize(
    ("camera", "told"),
    [
        ({"k": (0.0,) * 9}, "not calibrated"),
        ({"k": (np.nan,) * 9}, "not calibrated"),
        ({"k": (60.0, 1.0, 31.5, 0, 60.0, 23.5, 0, 0, 1)}, "skew of 1"),
    ],
)
def test_the_remedy_for_a_useless_camera_info_works(tmp_path, camera, told):
    m = Messages("mcap")
    records = [(INFO, t, m.camera_info(t, OPTICAL, **camera)) for t in STAMPS]
    path = made(tmp_path, "mcap", images(m, info=False), records)
    with pytest.raises(InputError, match=f"{told}.*give --intrinsics fx,fy,cx,cy"):
        open_log(path)
    assert len(read(path, "read.intrinsics=60,60,31.5,23.5")[0]) == 6


def test_a_lens_of_no_known_model_can_be_left_alone(tmp_path):
    m = Messages("mcap")
    lens = {"d": (0.1,) * 5, "model": "inverse_brown_conrady"}
    path = made(tmp_path, "mcap", images(m, info=False), [(INFO, t, m.camera_info(t, OPTICAL, **lens)) for t in STAMPS])
    with pytest.raises(InputError, match=r"inverse_brown_conrady.* read\.distortion=none"):
        open_log(path)
    assert len(read(path, "read.distortion=none")[0]) == 6


def test_a_camera_info_that_comes_late_is_used_and_one_that_changes_is_told(tmp_path):
    m = Messages("mcap")
    first, later = {"k": (0.0,) * 9}, {"k": (70.0, 0, 31.5, 0, 70.0, 23.5, 0, 0, 1)}
    cameras = [first, {}, {}, later, later, {}]
    records = [(INFO, t, m.camera_info(t, OPTICAL, **c)) for t, c in zip(STAMPS, cameras, strict=True)]
    frames, left_out = read(made(tmp_path, "mcap", images(m, info=False), records))
    assert {f.K[0, 0] for f in frames} == {60}
    differs = "camera_info differs from the first one, which is used"
    assert reasons(left_out) == {"camera_info cannot be used": 1, differs: 2}


def two_cameras(m, frame):
    for t, colour, depth in zip(STAMPS, COLOURS, DEPTHS, strict=True):
        yield RGB, t, m.image(t, frame, colour, "rgb8")
        yield "/camera/depth/image_raw", t, m.image(t, frame, depth, "16UC1")
        yield INFO, t, m.camera_info(t, frame)
        yield "/camera/depth/camera_info", t, m.camera_info(t, frame, k=(40.0, 0, 31.5, 0, 40.0, 23.5, 0, 0, 1))


def test_a_lens_that_is_left_alone_changes_no_camera_info(tmp_path):
    m = Messages("mcap")
    lens = {"d": (0.1, -0.05, 0.001, 0.0, 0.0)}
    records = [x for x in two_cameras(m, "camera") if not x[0].endswith("camera_info")]
    for t in STAMPS:
        records += [(INFO, t, m.camera_info(t, "camera", **lens))]
        k = (40.0, 0, 31.5, 0, 40.0, 23.5, 0, 0, 1)
        records += [("/camera/depth/camera_info", t, m.camera_info(t, "camera", k=k, **lens))]
    path = made(tmp_path, "mcap", records)
    for distortion in ("none", ""):
        frames, left_out = read(path, f"read.distortion={distortion}", "read.depth_to_rgb=0,0,0,0,0,0,1")
        assert len(frames) == 6
        assert not left_out


@pytest.mark.parametrize("frame", ["", "0"])
def test_frame_ids_that_say_nothing_join_no_two_cameras(tmp_path, frame):
    path = made(tmp_path, "mcap", two_cameras(Messages("mcap"), frame))
    with pytest.raises(InputError, match="is not registered to colour"):
        open_log(path)
    assert len(read(path, "read.depth_to_rgb=0,0,0,0,0,0,1")[0]) == 6


def test_better_intrinsics_do_not_move_registered_depth(tmp_path):
    m = Messages("mcap")
    cameras = [("/camera/depth_registered/camera_info", t, m.camera_info(t, OPTICAL)) for t in STAMPS]
    frames, _ = read(made(tmp_path, "mcap", images(m), cameras), "read.intrinsics=58,58,31,23")
    np.testing.assert_array_equal(frames[0].depth, metres(DEPTHS[0]))


def test_depth_that_becomes_floats_is_left_out_and_told(tmp_path):
    """One unit holds for the whole log: metres are not taken for millimetres."""
    m = Messages("mcap")
    records = list(images(m))
    for k in (3, 4):
        floats = (DEPTHS[k] / 1000).astype(np.float32)
        records[3 * k + 1] = (DEPTH, records[3 * k + 1][1], m.image(STAMPS[k], OPTICAL, floats, "32FC1"))
    frames, left_out = read(made(tmp_path, "mcap", records))
    assert [f.index for f in frames] == [0, 1, 2, 5]
    assert [x.reason for x in left_out] == ["depth image's encoding '32FC1' goes not with the first one's"] * 2


@pytest.mark.parametrize("data", [b"", b"\0"])
def test_a_scale_that_cannot_be_read_is_told(tmp_path, data):
    scale = [(f"{DEPTH}/units_per_meter", STAMPS[0], data, "std_msgs/msg/Float64")]
    log = open_log(made(tmp_path, "mcap", images(Messages("mcap")), scale))
    assert log.units_per_meter == 1000
    assert any("units_per_meter cannot be used: message" in note for note in log.notes)


# ---- topics


def chosen(tmp_path, streams):
    """Names of colour and depth among (topic, encoding or format, frame)."""
    m = Messages("ros2")
    pixels = {"rgb8": COLOURS[0], "mono8": COLOURS[0][..., 0], "16UC1": DEPTHS[0], "mono16": DEPTHS[0]}
    records = [
        (topic, STAMPS[0], m.image(STAMPS[0], frame, pixels[form], form))
        if form in pixels
        else (topic, STAMPS[0], m.compressed(STAMPS[0], frame, b"\xff\xd8\xff", form))
        for topic, form, frame in streams
    ]
    choice = choose(open_log_container(made(tmp_path, "ros2", records)), {})
    return choice.rgb.topic.name, choice.depth.topic.name


def open_log_container(path):
    from vlmm_log.readers.bag.containers import open_container

    return open_container(path)


RECORDERS = {
    "D435": (
        ("/camera/color/image_raw", "/camera/aligned_depth_to_color/image_raw"),
        ("/camera/depth/image_rect_raw", "16UC1", "depth"),
        ("/camera/infra1/image_rect_raw", "mono8", "depth"),
    ),
    "realsense-viewer": (
        ("/device_0/sensor_1/Color_0/image/data", "/device_0/sensor_0/Depth_0/image/data"),
        ("/device_0/sensor_0/Infrared_1/image/data", "mono8", "0"),
    ),
    "Azure Kinect": (
        ("/rgb/image_raw", "/depth_to_rgb/image_raw"),
        ("/ir/image_raw", "mono16", "depth"),
        ("/depth/image_raw", "16UC1", "depth"),
    ),
    "OAK-D": (("/oak/rgb/image_raw", "/oak/stereo/image_raw"), ("/oak/left/image_raw", "mono8", "left")),
    "PX4's iris": (("/iris/camera/rgb/image_raw", "/iris/camera/depth/image_raw"),),
    "Kinect 2": (
        ("/kinect2/hd/image_color", "/kinect2/hd/image_depth_rect"),
        ("/kinect2/sd/image_ir", "16UC1", "ir"),
    ),
    "a detector beside": (
        ("/camera/color/image_raw", "/camera/depth/image_raw"),
        ("/a/image_out", "rgb8", "camera"),
        ("/camera/color/image_annotated", "rgb8", "camera"),
    ),
}


@pytest.mark.parametrize(("wanted", "others"), [(w, o) for w, *o in RECORDERS.values()], ids=RECORDERS)
def test_recorders_own_names_are_understood(tmp_path, wanted, others):
    rgb, depth = wanted
    encoding = "mono16" if "device_0" in depth else "16UC1"
    assert chosen(tmp_path, [*others, (rgb, "rgb8", "camera"), (depth, encoding, "camera")]) == wanted


def test_depth_in_lossy_files_is_not_taken(tmp_path):
    topic = "/camera/aligned_depth_to_color/image_raw"
    lossless = (f"{topic}/compressedDepth", "16UC1; compressedDepth png", "c")
    colour = ("/camera/color/image_raw/compressed", "rgb8; jpeg compressed bgr8", "c")
    found = chosen(tmp_path, [(f"{topic}/compressed", "16UC1; jpeg compressed ", "c"), lossless, colour])
    assert found == (colour[0], lossless[0])


def test_infrared_alone_is_no_depth(tmp_path):
    with pytest.raises(InputError, match="no depth topic"):
        chosen(tmp_path, [("/camera/rgb/image_raw", "rgb8", "c"), ("/camera/ir/image_raw", "16UC1", "i")])


@pytest.mark.parametrize(
    ("topics", "told"),
    [
        ("pose=tfx", "no topic tfx for pose"),
        (f"pose={RGB}", "for pose is of type sensor_msgs/msg/Image; name another"),
        (f"info={RGB}", "for info is of type sensor_msgs/msg/Image; name another"),
        (f"depth={RGB}", "cannot be both colour and depth"),
        ("pose=tf:nowhere", "no transforms join 'nowhere'"),
    ],
)
def test_topics_of_the_wrong_kind_are_refused(tmp_path, topics, told):
    m = Messages("mcap")
    path = made(tmp_path, "mcap", images(m), tf(m, ("world", OPTICAL, at)))
    with pytest.raises(InputError, match=told):
        read(path, f"read.topics={topics!r}")


# ---- poses


def test_a_topic_of_transforms_is_the_whole_tree(tmp_path):
    m = Messages("mcap")
    path = made(tmp_path, "mcap", images(m), tf(m, ("base", OPTICAL, at), ("world", "base", [1.0, 0, 0, 0, 0, 0, 1])))
    by_name, by_tree = (read(path, f"read.topics='pose={pose}'")[0] for pose in ("/tf", "tf"))
    for a, b in zip(by_name, by_tree, strict=True):
        np.testing.assert_array_equal(a.T_world_cam, b.T_world_cam)


def test_where_transforms_do_not_reach_the_world_the_next_best_poses_are_taken(tmp_path):
    m = Messages("ros2")
    mount = [0.1, 0.2, 0.3, -0.5, 0.5, -0.5, 0.5]
    odometry = [("/odom", t, m.odometry(t, "odom", "base", at(t))) for t in STAMPS]
    static = [("/tf_static", STAMPS[0], m.tf(0, ("base", OPTICAL, mount)))]
    path = made(tmp_path, "ros2", images(m), odometry, static, tf(m, ("base", "wheel", at)))
    frames, _ = read(path)
    np.testing.assert_allclose(frames[2].T_world_cam, matrix(at(STAMPS[2])) @ matrix(mount), atol=1e-9)
    assert "6 poses from /odom" in open_log(path).notes
    asked, _ = read(path, "read.topics='pose=tf'")
    assert asked[2].T_world_cam is None


# ---- outputs


@pytest.mark.parametrize("name", ["out.mcap", "out.bag", "sub"])
def test_nothing_is_written_into_the_input(tmp_path, name):
    folder = write_tum_folder(tmp_path / "log")
    before = sorted(folder.rglob("*"))
    with pytest.raises(InputError, match="lies within the input"):
        convert(folder, folder / name)
    assert sorted(folder.rglob("*")) == before


def test_a_window_without_a_pair_leaves_nothing_behind(tmp_path):
    path = made(tmp_path, "mcap", images(Messages("mcap")))
    with pytest.raises(InputError, match="no depth image could be written"):
        convert(path, tmp_path / "out.mcap", settings=settings("read.stop_s=0.0"))
    assert [p.name for p in tmp_path.iterdir()] == ["log.mcap"]


def test_a_loop_of_links_is_refused(tmp_path):
    path = made(tmp_path, "mcap", images(Messages("mcap")))
    (tmp_path / "loop.mcap").symlink_to("loop.mcap")
    with pytest.raises(InputError, match="loop"):
        convert(path, tmp_path / "loop.mcap")


def test_info_looks_at_the_first_frame_of_the_window(tmp_path):
    path = made(tmp_path, "mcap", images(Messages("mcap")))
    assert info(path, settings=settings("read.start_s=0.05")).first.stamp_ns == STAMPS[2]


def test_names_that_are_no_text_are_printed(tmp_path):
    path = made(tmp_path, "mcap", images(Messages("mcap")))
    done = CliRunner().invoke(cli, ["convert", str(path), str(tmp_path / "out\x1b\udcff.mcap")], catch_exceptions=False)
    assert done.exit_code == 0
    assert "\\u001b\\udcff" in done.stdout
