"""convert: what other containers hold of a log, and that nothing is lost on the way there and back."""

import filecmp
import struct
from collections import Counter
from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from bags import Messages, write
from tum_folder import CAMERA, ORIGIN_NS, png, rows, text_of, write_tum_folder
from vlmm_log import se3
from vlmm_log.conversion import convert
from vlmm_log.readers import open_log
from vlmm_log.readers.images import depth_values
from vlmm_log.readers.poses import Link, Poses, trajectory
from vlmm_log.readers.stamps import seconds_to_ns
from vlmm_log.readers.stored import Shot
from vlmm_log.ros.mcap import mcap_file
from vlmm_log.ros.messages import Ros
from vlmm_log.settings import Settings
from vlmm_log.types import Frame, InputError
from vlmm_log.writers.depth import as_image, in_units, shifted
from vlmm_log.writers.encoded import file_header
from vlmm_log.writers.ros import RosLog
from vlmm_log.writers.timeline import timeline, window_of
from vlmm_log.writers.tum import seconds

EVER = 2**62
STEP = 100_000_000
KINDS = {"mcap": "twin.mcap", "bag": "twin.bag", "ros2": "twin", "ros2-mcap": "twin_mcap"}
TWINS = [(to, images) for to in KINDS for images in ("raw", "compressed")]
RNG = np.random.default_rng(7)
VALUES = RNG.integers(0, 2**16, (4, 48, 64), np.uint16)  # depth, every kind of it
VALUES[:, :4] = 0
VALUES[:, -1] = 65535


def pose_rows(count=60, step_ns=STEP // 10, start_ns=ORIGIN_NS - STEP, seed=3):
    """A shaken camera, some poses before the first image and after the last one."""
    rng = np.random.default_rng(seed)
    stamps = [start_ns + k * step_ns + int(rng.integers(0, 999_999)) for k in range(count)]
    turns = np.array([0.1, -0.2, 0.3, 0.9]) + rng.normal(0, 0.05, (count, 4))
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    values = np.hstack([rng.normal(0, 0.3, (count, 3)), turns])
    return rows(stamps, [" ".join(f"{v:.4f}" for v in row) for row in values])


def folder(tmp_path, name="log", **options):
    """A TUM folder of four frames with poses, its depth random."""
    images = {f"depth/{k}.png": png(VALUES[k]) for k in range(4)}
    files = images | dict(options.pop("files", {}))
    return write_tum_folder(tmp_path / name, **{"groundtruth": pose_rows(), "files": files, "shift_px": 2} | options)


def frames(path, *sets, window=(0, EVER)):
    """Every field of every frame, arrays as bytes; the files of images aside, which some twins do not hold."""
    found = [x for x in opened(path, *sets).frames(*window) if isinstance(x, Frame)]
    poses = [None if x.T_world_cam is None else x.T_world_cam.tobytes() for x in found]
    return [
        (x.stamp_ns, x.index, x.rgb.tobytes(), x.depth.tobytes(), x.K.tobytes(), pose)
        for x, pose in zip(found, poses, strict=True)
    ]


def opened(path, *sets):
    return open_log(path, Settings.load(sets=sets).read)


def shots(path):
    """(kind, stamp) -> stored image."""
    log = opened(path)
    return {(x.kind, x.stamp_ns): x.load() for x in log.shots(-EVER, EVER) if isinstance(x, Shot)}


def messages(path):
    """Topic -> [(log time, message)], as rosbags reads them."""
    found = {}
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        for connection, log_ns, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            found.setdefault(connection.topic, []).append((log_ns, message))
    return found


def stamp(message):
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def refused(*args, **options):
    with pytest.raises(InputError) as e:
        convert(*args, **options)
    assert "\n" not in str(e.value)
    return str(e.value)


# ---- what ROS's own tools find


@pytest.mark.parametrize("to", KINDS)
def test_raw_images_and_cameras_are_as_ros_defines_them(tmp_path, to):
    log, out = folder(tmp_path), tmp_path / KINDS[to]
    assert convert(log, out, to=to).out == out
    found = messages(out)
    depth_ns = [ORIGIN_NS + k * STEP for k in range(4)]
    for place, late, encoding in (("rgb", 2_000_000, "rgb8"), ("depth_registered", 0, "32FC1")):
        images, infos = found[f"/camera/{place}/image_raw"], found[f"/camera/{place}/camera_info"]
        for listing in (images, infos):
            assert [t for t, _ in listing] == [stamp(m) for _, m in listing] == [t + late for t in depth_ns]
            assert {m.header.frame_id for _, m in listing} == {"camera_rgb_optical_frame"}
        assert {(m.encoding, m.height, m.width, m.is_bigendian) for _, m in images} == {(encoding, 48, 64, 0)}
        for _, m in infos:
            K, D, P, R = (getattr(m, k, getattr(m, k.lower(), None)) for k in "KDPR")
            assert K.tolist() == [60, 0, 31.5, 0, 60, 23.5, 0, 0, 1]
            assert P.tolist() == [60, 0, 31.5, 0, 0, 60, 23.5, 0, 0, 0, 1, 0]
            assert (m.height, m.width, m.distortion_model) == (48, 64, "plumb_bob")
            assert not D.any()
            assert (R.reshape(3, 3) == np.eye(3)).all()
    for k, (_, m) in enumerate(found["/camera/rgb/image_raw"]):
        bgr = cv2.imread(str(log / f"rgb/{k}.png"))
        assert (m.data.reshape(48, m.step)[:, : 3 * 64].reshape(48, 64, 3) == bgr[:, :, ::-1]).all()
    for k, (_, m) in enumerate(found["/camera/depth_registered/image_raw"]):
        metres = m.data.view(np.float32).reshape(48, 64)
        assert (np.isnan(metres) == (VALUES[k] == 0)).all()
        assert (np.rint(np.nan_to_num(metres) * 5000) == VALUES[k]).all()


@pytest.mark.parametrize("to", KINDS)
def test_compressed_images_are_the_files_of_the_log(tmp_path, to):
    log, out = folder(tmp_path), tmp_path / KINDS[to]
    told = convert(log, out, to=to, images="compressed").notes
    found = messages(out)
    for k, (_, m) in enumerate(found["/camera/rgb/image_raw/compressed"]):
        assert m.format == "rgb8; png compressed bgr8"
        assert m.data.tobytes() == (log / f"rgb/{k}.png").read_bytes()
    for k, (_, m) in enumerate(found["/camera/depth_registered/image_raw/compressedDepth"]):
        assert m.format == "16UC1; compressedDepth png"
        assert not m.data[:12].any()
        assert (cv2.imdecode(m.data[12:], cv2.IMREAD_UNCHANGED) == VALUES[k]).all()
    ((log_ns, units),) = found["/camera/depth_registered/image_raw/units_per_meter"]
    assert (log_ns, units.data) == (ORIGIN_NS, 5000)
    assert any("5000 per metre" in note and "other tools" in note for note in told)


@pytest.mark.parametrize("to", KINDS)
def test_poses_are_transforms_at_their_own_stamps(tmp_path, to):
    log, out = folder(tmp_path), tmp_path / KINDS[to]
    convert(log, out, to=to)
    (track,) = opened(log).poses.moving
    found = [t for _, m in messages(out)["/tf"] for t in m.transforms]
    assert {(t.header.frame_id, t.child_frame_id) for t in found} == {("world", "camera_rgb_optical_frame")}
    assert [stamp(t) for t in found] == track.stamps_ns.tolist()
    parts = [(t.transform.translation, t.transform.rotation) for t in found]
    values = [np.array([x.x, x.y, x.z, q.x, q.y, q.z, q.w]) for x, q in parts]
    back = trajectory(track.stamps_ns, values)
    assert (back.positions == track.positions).all()
    assert (back.quaternions == track.quaternions).all()
    assert np.abs(np.linalg.norm(np.array(values)[:, 3:], axis=1) - 1).max() < 1e-4


def test_the_whole_is_in_order_of_time(tmp_path):
    convert(folder(tmp_path), tmp_path / "twin.mcap")
    with AnyReader([tmp_path / "twin.mcap"]) as reader:
        times = [log_ns for _, log_ns, _ in reader.messages()]
    assert times == sorted(times)
    assert times[0] < ORIGIN_NS < times[-1] - 3 * STEP  # poses before and after the images are there too


def test_equal_runs_give_equal_bytes(tmp_path):
    log = folder(tmp_path)
    for name in ("a", "b"):
        for suffix in (".mcap", ".bag"):
            convert(log, tmp_path / f"{name}{suffix}")
    assert filecmp.cmp(tmp_path / "a.mcap", tmp_path / "b.mcap", shallow=False)
    assert filecmp.cmp(tmp_path / "a.bag", tmp_path / "b.bag", shallow=False)


# ---- there and back


@pytest.mark.parametrize(("to", "images"), TWINS)
def test_twins_give_the_same_frames(tmp_path, to, images):
    log, out = folder(tmp_path), tmp_path / KINDS[to]
    result = convert(log, out, to=to, images=images)
    assert not result.skipped
    assert frames(out) == frames(log) != []
    if to == "ros2":
        assert frames(out / "twin.db3") == frames(log)


@pytest.mark.parametrize(("to", "images"), TWINS)
def test_a_log_comes_back_from_its_twin(tmp_path, to, images):
    log, twin, back = folder(tmp_path), tmp_path / KINDS[to], tmp_path / "back"
    convert(log, twin, to=to, images=images)
    assert convert(twin, back).to == "tum"
    before, after = shots(log), shots(back)
    assert list(before) == list(after)
    for (kind, _), image in before.items():
        if images == "compressed":
            assert after[kind, _].data == image.data
        elif kind == "depth":
            assert (depth_values(after[kind, _]) == depth_values(image)).all()
    (a,), (b,) = (opened(path).poses.moving for path in (log, back))
    assert all((getattr(a, name) == getattr(b, name)).all() for name in ("stamps_ns", "positions", "quaternions"))
    assert frames(back) == frames(log)


@settings(max_examples=15, deadline=None)
@given(
    st.lists(st.integers(1, 2 * STEP), min_size=2, max_size=12),
    st.integers(0, 2**31 * 10**9 - 10**10),
    st.integers(0, 2**32),
)
def test_any_stamps_and_poses_come_back_to_the_bit(tmp_path_factory, steps, origin_ns, seed):
    tmp_path = tmp_path_factory.mktemp("any")
    stamps = (origin_ns + np.cumsum(steps)).tolist()
    rng = np.random.default_rng(seed)
    values = np.hstack([rng.normal(0, 10, (len(stamps), 3)), rng.normal(0, 1, (len(stamps), 4))])
    values[:, 3:] /= np.linalg.norm(values[:, 3:], axis=1, keepdims=True)
    listed_rows = rows(stamps, [" ".join(repr(float(v)) for v in row) for row in values])
    texts = {f"{kind}.txt": rows(stamps[:2], [f"{kind}/0.png", f"{kind}/1.png"]) for kind in ("rgb", "depth")}
    log = folder(tmp_path, groundtruth=listed_rows, files=texts)
    convert(log, tmp_path / "twin.mcap")
    convert(tmp_path / "twin.mcap", tmp_path / "back")
    assert frames(tmp_path / "back") == frames(tmp_path / "twin.mcap") == frames(log)
    (a,), (b,) = (opened(tmp_path / name).poses.moving for name in ("log", "back"))
    assert all((getattr(a, name) == getattr(b, name)).all() for name in ("stamps_ns", "positions", "quaternions"))


@settings(derandomize=True)  # one in a million has no factor
@given(st.integers(1, 50), st.integers(0, 2**32), st.floats(0.01, 1))
def test_quaternions_are_read_as_they_were(count, seed, share):
    raw = np.random.default_rng(seed).normal(size=(count, 4)) * [1, 1, share, share**2]
    units = raw / np.linalg.norm(raw, axis=1, keepdims=True)
    back = trajectory(range(count), list(np.pad(units, ((0, 0), (3, 0)))))
    assert (back.quaternions == units).all()


@given(st.integers(-(2**62), 2**62))
def test_stamps_are_written_as_they_are_read(ns):
    assert seconds_to_ns(seconds(ns)) == ns


def test_a_camera_that_stands_still_keeps_its_pose(tmp_path):
    stamps = [ORIGIN_NS + k * STEP for k in range(4)]
    log = folder(tmp_path, groundtruth=rows(stamps, ["0 0 0 0 0 0 1"] * 4))
    convert(log, tmp_path / "twin.mcap")
    assert frames(tmp_path / "twin.mcap") == frames(log)


def test_a_twin_of_a_twin_is_the_same(tmp_path):
    log = folder(tmp_path)
    convert(log, tmp_path / "a.bag", images="compressed")
    convert(tmp_path / "a.bag", tmp_path / "b.mcap", images="compressed")
    convert(tmp_path / "b.mcap", tmp_path / "c", to="ros2")
    assert frames(tmp_path / "b.mcap") == frames(tmp_path / "c") == frames(log)


# ---- depth


@pytest.mark.parametrize("units", [1, 256, 999.9, 1000, 4000, 5000, 10000])
def test_each_of_65536_depths_survives_as_metres(units):
    values = np.arange(2**16, dtype=np.uint16).reshape(256, 256)
    encoding, pixels = as_image(values, units)
    assert encoding == ("16UC1" if units == 1000 else "32FC1")
    assert (in_units(pixels, units if encoding == "16UC1" else 1, units).values == values).all()


def test_depth_beyond_a_folders_range_is_counted(tmp_path):
    values = np.array([[0, 1, 13106, 13107, 13108, 65535]], np.uint16)
    stored = in_units(values, 1000, 5000)
    assert stored.values.tolist() == [[0, 5, 65530, 65535, 0, 0]]
    assert (stored.lost, stored.rounding_m) == (2, 0)
    metres = np.array([[np.nan, np.inf, -1, 0, 1e-5, 1.00009, 13.2]], np.float32)
    stored = in_units(metres, 1, 5000)
    assert stored.values.tolist() == [[0, 0, 0, 0, 0, 5000, 0]]
    assert stored.lost == 2
    assert stored.rounding_m == pytest.approx(9e-5, rel=1e-3)
    log = folder(tmp_path, camera=f"{CAMERA}depth_scale 1000\n")
    notes = convert(log, tmp_path / "out", to="tum").notes
    beyond = np.count_nonzero(VALUES > 13107)
    assert any(note.startswith(f"{beyond} px of depth beyond") for note in notes)


def test_millimetres_stay_integers(tmp_path):
    log = folder(tmp_path, camera=f"{CAMERA}depth_scale 1000\n")
    raw = messages(convert(log, tmp_path / "raw.mcap").out)["/camera/depth_registered/image_raw"]
    assert {m.encoding for _, m in raw} == {"16UC1"}
    assert all((m.data.view(np.uint16).reshape(48, 64) == VALUES[k]).all() for k, (_, m) in enumerate(raw))
    compressed = messages(convert(log, tmp_path / "c.mcap", images="compressed").out)
    assert not any(topic.endswith("units_per_meter") for topic in compressed)


def test_float_depth_is_not_compressed_with_loss(tmp_path):
    log = folder(tmp_path)
    convert(log, tmp_path / "metres.bag")
    result = convert(tmp_path / "metres.bag", tmp_path / "twin.mcap", images="compressed")
    assert "/camera/depth_registered/image_raw" in result.counts
    assert any("would round it" in note for note in result.notes)
    assert frames(tmp_path / "twin.mcap") == frames(log)


@pytest.mark.parametrize("images", ["raw", "compressed"])
def test_compressed_floats_in_another_unit_become_metres(tmp_path, images):
    """32FC1 means metres to every reader; here the source's are millimetres."""
    from test_bag import COLOURS, INFO, OPTICAL, RGB, STAMPS

    m, scale = Messages("mcap"), 10100.0
    header, values = struct.pack("<iff", 0, scale, -1.0), np.full((48, 64), round(scale / 2000 - 1), np.uint16)
    depth = header + cv2.imencode(".png", values)[1].tobytes()
    records = []
    for t, colour in zip(STAMPS, COLOURS, strict=True):
        records += [(RGB, t, m.image(t, OPTICAL, colour, "rgb8")), (INFO, t, m.camera_info(t, OPTICAL))]
        form = "32FC1; compressedDepth png"
        records += [("/camera/depth_registered/image_raw/compressedDepth", t, m.compressed(t, OPTICAL, depth, form))]
    source = write(tmp_path / "log.mcap", "mcap", records)
    units = "read.depth_units_per_meter=1000"
    out = convert(source, tmp_path / "out.mcap", settings=Settings.load(sets=[units]), images=images).out
    before, after = (
        [x.depth for x in opened(path, *sets).frames(0, EVER)] for path, *sets in ((source, units), (out,))
    )
    assert 1.9 < np.nanmedian(before[0]) < 2.1
    np.testing.assert_array_equal(before, after)


@pytest.mark.parametrize("dtype", [np.uint16, np.float32])
def test_a_shift_moves_and_leaves_unseen(dtype):
    values = VALUES[0].astype(dtype)
    moved = shifted(values, 3, -2)
    assert (moved[:-2, 3:] == values[2:, :-3]).all()
    edge = np.concatenate([moved[-2:].ravel(), moved[:, :3].ravel()])
    assert np.isnan(edge).all() if dtype == np.float32 else not edge.any()


# ---- conventions, cameras, windows


def worst(a, b):
    """The largest difference of two logs' poses."""
    A, B = ([x.T_world_cam for x in log.frames(0, EVER) if isinstance(x, Frame)] for log in (a, b))
    assert len(A) == len(B) > 0
    assert [x is None for x in A] == [y is None for y in B]
    return max(np.abs(x - y).max() for x, y in zip(A, B, strict=True) if x is not None)


@pytest.mark.parametrize("to", ["mcap", "bag", "ros2"])
def test_bonns_convention_is_resolved(tmp_path, to):
    log = folder(tmp_path, name="rgbd_bonn_tiny", camera=None)
    result = convert(log, tmp_path / KINDS[to], to=to, settings=Settings.load(sets=["read.intrinsics=60,60,31.5,23.5"]))
    sets = ("read.intrinsics=60,60,31.5,23.5",)
    assert worst(opened(log, *sets), opened(tmp_path / KINDS[to])) < 1e-12
    assert result.counts["/tf_static"] == 1
    assert any("still transforms" in note for note in result.notes)


def test_bonns_folder_becomes_a_plain_one(tmp_path):
    s = Settings.load(sets=["read.intrinsics=60,60,31.5,23.5"])
    log = folder(tmp_path, name="rgbd_bonn_tiny", camera=None)
    assert any("resolved" in note for note in convert(log, tmp_path / "plain", to="tum", settings=s).notes)
    assert worst(opened(log, "read.intrinsics=60,60,31.5,23.5"), opened(tmp_path / "plain")) < 1e-12
    assert "read as a folder of 'bonn'" in refused(log, tmp_path / "rgbd_bonn_again", to="tum", settings=s)
    assert "read as a folder of 'bonn'" in refused(log, tmp_path / "bonn" / "again", to="tum", settings=s)


@pytest.mark.parametrize("out", ["twin.mcap", "twin.bag", "twin_tum"])
@pytest.mark.parametrize(
    "sets",
    [
        ["read.poses=world_to_camera"],
        ["read.quaternion=wxyz"],
        ["read.camera_axes=body"],
        ["read.camera_axes=opengl"],
        ["read.pose_to_camera=0.1,0,0.2,0,0,0.6,0.8"],
        ["read.pose_to_camera=icl"],
        ["read.position_units_per_meter=1000"],
        ["read.pose_offset_s=0.0123"],
    ],
)
def test_what_was_asked_of_poses_is_done(tmp_path, sets, out):
    log = folder(tmp_path)
    to = "tum" if out == "twin_tum" else ""
    convert(log, tmp_path / out, to=to, settings=Settings.load(sets=sets))
    assert worst(opened(log, *sets), opened(tmp_path / out)) < 1e-12


def test_a_chain_of_frames_stays_one(tmp_path):
    log = opened(folder(tmp_path))
    (track,) = log.poses.moving
    slower = trajectory(track.stamps_ns[:-20:5], list(np.hstack([track.positions, track.quaternions])[:-20:5]))
    log.poses = Poses((Link(slower), Link(se3.exp(np.full(6, 0.3))), Link(track)), "a chain")
    result = convert(log, tmp_path / "twin.mcap")
    assert result.counts["/tf"] == slower.stamps_ns.size + track.stamps_ns.size
    assert worst(log, opened(tmp_path / "twin.mcap")) < 1e-12
    result = convert(log, tmp_path / "out", to="tum")
    assert worst(log, opened(tmp_path / "out")) < 1e-12
    beyond = int((track.stamps_ns > slower.stamps_ns[-1]).sum())
    assert result.skipped == Counter({"not every link of the chain of transforms is known at this time": beyond})


def test_offset_and_shift_of_depth_are_done(tmp_path):
    sets = ["read.depth_offset_s=0.003", "read.depth_shift_px=2,-1"]
    log = folder(tmp_path)
    for name, images in (("a.mcap", "raw"), ("b.bag", "compressed")):
        convert(log, tmp_path / name, images=images, settings=Settings.load(sets=sets))
        assert frames(tmp_path / name) == frames(log, *sets)
    convert(log, tmp_path / "out", to="tum", settings=Settings.load(sets=sets))
    assert frames(tmp_path / "out") == frames(log, *sets)


def test_lens_distortion_is_kept(tmp_path):
    lens = "k1 0.05\nk2 -0.01\np1 0.001\np2 0.002\n"
    log = folder(tmp_path, camera=CAMERA + lens)
    for name in ("a.mcap", "b.bag", "c"):
        convert(log, tmp_path / name, to="tum" if name == "c" else "")
        a, b = (opened(path).camera for path in (tmp_path / name, log))
        assert a.distortion == b.distortion == (0.05, -0.01, 0.001, 0.002, 0)
        assert frames(tmp_path / name) == frames(log)


def test_a_window_gives_the_frames_of_the_window(tmp_path):
    s = Settings.load(sets=["read.start_s=0.1", "read.stop_s=0.3"])
    log = folder(tmp_path)
    inside = [(f[0], *f[2:]) for f in frames(log, window=(STEP, 3 * STEP))]
    assert len(inside) == 2
    for name in ("twin.mcap", "twin.bag", "out"):
        result = convert(log, tmp_path / name, to="tum" if name == "out" else "", settings=s)
        assert [(f[0], *f[2:]) for f in frames(tmp_path / name)] == inside
        poses = result.counts["groundtruth.txt" if name == "out" else "/tf"]
        assert 20 < poses < 60
    convert(log, tmp_path / "whole.bag")
    convert(tmp_path / "whole.bag", tmp_path / "part", settings=s)
    assert [(f[0], *f[2:]) for f in frames(tmp_path / "part")] == inside
    assert "no image" in refused(log, tmp_path / "none.mcap", settings=Settings.load(sets=["read.start_s=99"]))


def unregistered(tmp_path, log, camera, T_rgb_depth):
    """An MCAP whose depth is that of a camera beside the colour one."""
    source = opened(log)
    with mcap_file(tmp_path / "beside.mcap", Ros(2), "NONE", {}) as mcap:
        ros = RosLog(Ros(2), mcap, "raw", source.camera, (camera, T_rgb_depth), 5000, (0, 0), None)
        for event in timeline(source, None, window_of(Settings().read)):
            assert ros.write(event) is None
    return tmp_path / "beside.mcap"


@pytest.mark.parametrize("lens", [(), (0.02, 0.0, 0.0, 0.0, 0.0)])
def test_depth_of_another_camera_keeps_its_own_frame(tmp_path, lens):
    depth = np.full((48, 64), 6000, np.uint16)
    log = folder(tmp_path, files={f"depth/{k}.png": png(depth) for k in range(4)})
    T = se3.exp(np.array([0.01, 0, 0, 0.025, 0, 0]))
    own = replace(opened(log).camera, fx=55.0, width=64, height=48, distortion=lens)
    path = unregistered(tmp_path, log, own, T)
    read_camera, read_T = opened(path).depth_camera
    assert (read_camera.fx, read_camera.distortion) == (55.0, lens)
    assert np.abs(read_T - T).max() < 1e-12
    convert(path, tmp_path / "twin.bag")
    topics = {"/camera/depth/image_raw", "/camera/depth/camera_info", "/tf_static"}
    assert set(messages(tmp_path / "twin.bag")) >= topics
    result = convert(path, tmp_path / "out")
    assert any("registered to colour" in note for note in result.notes)
    for a, b in zip(opened(path).frames(0, EVER), opened(tmp_path / "out").frames(0, EVER), strict=True):
        assert (np.isnan(a.depth) == np.isnan(b.depth)).all()
        assert np.nanmax(np.abs(a.depth - b.depth)) <= 0.5001 / 5000
        assert (a.rgb == b.rgb).all()


# ---- images that are not PNG colour


@given(st.integers(1, 70), st.integers(1, 70), st.booleans(), st.sampled_from([".png", ".jpg"]))
def test_headers_say_what_decoding_gives(height, width, grey, suffix):
    image = np.zeros((height, width) if grey else (height, width, 3), np.uint8)
    found = file_header(cv2.imencode(suffix, image)[1].tobytes())
    assert (found.height, found.width, found.channels, found.bits) == (height, width, 1 if grey else 3, 8)
    assert found.kind == {".png": "png", ".jpg": "jpeg"}[suffix]


@pytest.mark.parametrize(("grey", "form"), [(False, "rgb8; jpeg compressed bgr8"), (True, "mono8; jpeg compressed ")])
def test_jpeg_passes_as_it_is(tmp_path, grey, form):
    image = RNG.integers(0, 255, (48, 64) if grey else (48, 64, 3), np.uint8)
    file = cv2.imencode(".jpg", image)[1].tobytes()
    log = folder(tmp_path, files={f"rgb/{k}.png": file for k in range(4)})
    found = messages(convert(log, tmp_path / "twin.mcap", images="compressed").out)["/camera/rgb/image_raw/compressed"]
    assert {(m.format, m.data.tobytes()) for _, m in found} == {(form, file)}
    convert(tmp_path / "twin.mcap", tmp_path / "back")
    assert [p.read_bytes() for p in (tmp_path / "back/rgb").glob("*.jpg")] == [file] * 4
    assert frames(tmp_path / "back") == frames(tmp_path / "twin.mcap") == frames(log)


# ---- what is left out, and what is refused


def test_what_cannot_be_read_is_counted(tmp_path):
    log = folder(tmp_path, files={"rgb/1.png": b"no image", "depth/2.png": None})
    for name in ("twin.mcap", "out"):
        result = convert(log, tmp_path / name, to="tum" if name == "out" else "")
        assert result.skipped == Counter({"colour image cannot be decoded": 1, "listed file is missing": 1})
    assert [f[0] for f in frames(tmp_path / "twin.mcap")] == [f[0] for f in frames(log)]


@pytest.mark.parametrize("name", ["twin.mcap", "twin.bag", "twin"])
def test_stamps_beyond_ros_are_told(tmp_path, name):
    end_ns = 2**31 * 10**9
    stamps = [-1, 0, end_ns - 1, end_ns]
    names = {"rgb": [], "depth": []}
    for kind in names:
        listing = [f"{'-' if t < 0 else ''}{text_of(abs(t))} {kind}/{k}.png\n" for k, t in enumerate(stamps)]
        names[kind] = "".join(listing)
    log = folder(tmp_path, groundtruth=None, files={f"{kind}.txt": text for kind, text in names.items()})
    result = convert(log, tmp_path / name)
    assert result.skipped == Counter({"stamp is beyond what ROS can hold, 1970 to 2038": 4})
    assert [t for t, _ in messages(tmp_path / name)["/camera/rgb/image_raw"]] == stamps[1:3]


def test_a_log_without_a_usable_image_leaves_nothing(tmp_path):
    broken = {f"{kind}/{k}.png": b"no image" for kind in ("rgb", "depth") for k in range(4)}
    log = folder(tmp_path, files=broken)
    for name, to in (("twin.mcap", ""), ("twin.bag", ""), ("twin", ""), ("out", "tum")):
        assert "no image could be written: " in refused(log, tmp_path / name, to=to)
    assert [p.name for p in tmp_path.iterdir()] == ["log"]


@pytest.mark.parametrize(("name", "to"), [("twin.mcap", ""), ("twin.bag", ""), ("twin", ""), ("out", "tum")])
def test_an_output_is_replaced_only_with_force(tmp_path, name, to):
    log = folder(tmp_path)
    out = convert(log, tmp_path / name, to=to).out
    before = sorted(p.read_bytes() for p in ([out] if out.is_file() else out.rglob("*")) if p.is_file())
    assert "--force" in refused(log, out, to=to)
    convert(log, out, to=to, force=True)
    after = sorted(p.read_bytes() for p in ([out] if out.is_file() else out.rglob("*")) if p.is_file())
    assert after == before
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(["log", name])


def test_a_failed_run_leaves_the_old_output(tmp_path):
    log = folder(tmp_path)
    for name, to in (("twin.mcap", ""), ("twin", ""), ("out", "tum")):
        convert(log, tmp_path / name, to=to)

    def stop(done, expected):
        raise KeyboardInterrupt

    before = sorted((p, p.stat().st_mtime_ns) for p in tmp_path.rglob("*"))
    for name, to in (("twin.mcap", ""), ("twin", ""), ("out", "tum")):
        with pytest.raises(KeyboardInterrupt):
            convert(log, tmp_path / name, to=to, force=True, progress=stop)
    assert sorted((p, p.stat().st_mtime_ns) for p in tmp_path.rglob("*") if p != tmp_path) == before


def test_a_folder_that_is_no_log_is_never_replaced(tmp_path):
    log, mine = folder(tmp_path), tmp_path / "mine"
    mine.mkdir()
    assert convert(log, mine).to == "ros2"  # an empty one is as good as none
    (tmp_path / "letters").mkdir()
    (tmp_path / "letters/dear").write_text("aunt")
    assert "holds other things" in refused(log, tmp_path / "letters", force=True)
    assert "is or holds" in refused(log, log, to="tum", force=True)
    assert "is or holds" in refused(log, tmp_path, to="tum", force=True)
    convert(log, tmp_path / "a.bag")
    assert "is the input" in refused(tmp_path / "a.bag", tmp_path / "a.bag", force=True)


@pytest.mark.parametrize(
    ("name", "options", "said"),
    [
        ("a.db3", {}, "ROS 2 keeps a .db3 in a folder"),
        ("a.mcap", {"to": "bag"}, "NAME.bag"),
        ("a.mcap", {"to": "ros2"}, "a folder"),
        ("a", {"to": "mcap"}, "NAME.mcap"),
        ("a", {"to": "zip"}, "there are mcap"),
        ("a.mcap", {"images": "jpeg"}, "raw, compressed"),
        ("log/rgb.txt/a.mcap", {}, "cannot be written"),
        ("log/rgb.txt/a", {}, "cannot be written"),
        ("log/rgb.txt", {"to": "tum"}, "is no folder"),
    ],
)
def test_names_that_cannot_be(tmp_path, name, options, said):
    assert said in refused(folder(tmp_path), tmp_path / name, **options)


def test_progress_counts_depth_images(tmp_path):
    told = []
    convert(folder(tmp_path), tmp_path / "twin.mcap", progress=lambda *x: told.append(x))
    assert told == [(k, 4) for k in (1, 2, 3, 4)]


def test_an_opened_log_may_be_the_source(tmp_path):
    log = folder(tmp_path)
    convert(opened(log), tmp_path / "twin.mcap")
    assert frames(tmp_path / "twin.mcap") == frames(log)
    bare = SimpleNamespace(name="mine", notes=[], has_poses=False, world_up="-y")
    assert "mine: its reader hands out no stored images" in refused(bare, tmp_path / "mine.mcap")
