"""Readers: what becomes a frame, what is told as left out, and what cannot be opened."""

from decimal import Decimal
from fractions import Fraction

import cv2
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.linalg import polar
from scipy.spatial.transform import Rotation, Slerp

from tum_folder import ORIGIN_NS, png, rows
from vlmm_log.readers import conventions, open_log, recognise
from vlmm_log.readers.poses import trajectory
from vlmm_log.readers.stamps import associate, seconds_to_ns
from vlmm_log.settings import ReadSettings, Settings
from vlmm_log.types import Frame, InputError, Skipped

EVER = 2**62
STEP = 100_000_000
HALF = 0.5**0.5
GIVEN = "read.intrinsics=60,60,31.5,23.5"


def opened(folder, *sets):
    return open_log(folder, Settings.load(sets=sets).read)


def read(folder, *sets, window=(0, EVER)):
    """Frames and what was left out."""
    items = list(opened(folder, *sets).frames(*window))
    return [x for x in items if isinstance(x, Frame)], [x for x in items if isinstance(x, Skipped)]


def cannot_open(folder, *sets):
    """The message with which opening fails."""
    with pytest.raises(InputError) as e:
        opened(folder, *sets)
    assert "\n" not in str(e.value)
    assert str(folder) in str(e.value)
    return str(e.value)


# ---- stamps


@given(st.decimals(-4_000_000_000, 4_000_000_000, places=9))
@example(Decimal("1305031237.029714123"))
def test_seconds_are_exact_to_the_nanosecond(seconds):
    assert seconds_to_ns(str(seconds)) == Fraction(seconds) * 10**9


@pytest.mark.parametrize("text", ["", "abc", "nan", "-inf", "sNaN", "1.2.3", "1,5", "1e999999", "0x10"])
def test_what_is_no_time_is_told(text):
    with pytest.raises(ValueError, match="is no time"):
        seconds_to_ns(text)


ascending = st.sets(st.integers(-60, 60), max_size=12).map(sorted)


@given(ascending, ascending, st.integers(0, 40))
@example([0, 10], [5], 5)
def test_association(a, b, tolerance):
    pairs = associate(a, b, tolerance)
    assert pairs == sorted(pairs)
    assert len({i for i, _ in pairs}) == len({j for _, j in pairs}) == len(pairs)
    distance = {(i, j): abs(x - y) for i, x in enumerate(a) for j, y in enumerate(b)}
    assert all(distance[p] <= tolerance for p in pairs)
    assert sorted((j, i) for i, j in associate(b, a, tolerance)) == pairs
    of_a = {i: distance[i, j] for i, j in pairs}
    of_b = {j: distance[i, j] for i, j in pairs}
    for (i, j), d in distance.items():  # none would rather have each other than what they got
        assert d > tolerance or d >= min(of_a.get(i, EVER), of_b.get(j, EVER))


# ---- poses


def poses(times_s, values):
    return rows([ORIGIN_NS + round(t * 1e9) for t in times_s], values)


@given(st.floats(0, 1), st.integers(0, 2**32 - 1))
def test_poses_are_interpolated_linearly_and_by_slerp(share, seed):
    random = np.random.default_rng(seed)
    rotations, positions = Rotation.random(2, random), random.normal(size=(2, 3))
    table = np.hstack([positions, rotations.as_quat()])
    stamp = round(share * STEP)
    T = trajectory([0, STEP], list(table)).at(stamp, STEP)
    np.testing.assert_allclose(T[:3, :3], Slerp([0, STEP], rotations)(stamp).as_matrix(), atol=1e-7)
    np.testing.assert_allclose(T[:3, 3], positions[0] + stamp / STEP * np.diff(positions, axis=0)[0], atol=1e-9)


def test_the_pose_is_of_the_depth_stamp_and_never_extrapolated(tum_folder):
    gt = poses((0.05, 0.15, 0.2), ["0 0 0 0 0 0 1", f"1 2 3 0 0 {HALF} {HALF}", "7 8 9 0 0 0 1"])
    frames, left_out = read(tum_folder(groundtruth=gt, offset_ns=15_000_000))
    assert [f.T_world_cam is None for f in frames] == [True, False, False, True]
    np.testing.assert_allclose(frames[1].T_world_cam[:3, 3], [0.5, 1, 1.5], atol=1e-7)
    turn = Rotation.from_matrix(frames[1].T_world_cam[:3, :3])
    np.testing.assert_allclose(turn.as_rotvec(), [0, 0, np.pi / 4], atol=1e-7)
    np.testing.assert_array_equal(frames[2].T_world_cam[:3, 3], [7, 8, 9])
    assert [(s.what, s.index) for s in left_out] == [("pose of frame 0", 0), ("pose of frame 3", 3)]
    assert {s.reason for s in left_out} == {"no two poses around it within 0.1 s"}


def test_no_pose_across_a_large_gap(tum_folder):
    folder = tum_folder(groundtruth=poses((-0.1, 0.11), ["0 0 0 0 0 0 1"] * 2), frames=2)
    assert [f.T_world_cam is None for f in read(folder)[0]] == [True, True]
    assert [f.T_world_cam is None for f in read(folder, "read.pose_gap_s=0.21")[0]] == [False, False]


@pytest.mark.parametrize("groundtruth", [None, "", "# timestamp tx ty tz qx qy qz qw\n"])
def test_no_groundtruth_no_pose(tum_folder, groundtruth):
    folder = tum_folder(groundtruth=groundtruth)
    frames, left_out = read(folder)
    assert [f.T_world_cam for f in frames] == [None] * 4
    assert not left_out
    assert (opened(folder).has_poses, opened(folder).world_up) == (False, "-y")


@pytest.mark.parametrize(
    ("row", "reason"),
    [
        ("nan 0 0 0 0 0 1", "pose is not finite"),
        ("0 0 0 0 0 0 inf", "pose is not finite"),
        ("0 -2e9 0 0 0 0 1", "pose holds more than 1e+09 m"),
        ("0 0 0 0 0 0 1e200", "pose holds more than 1e+09 m"),
        ("0 0 0 0 0 0 1.1", "not of unit length"),
        ("0 0 0 0 0 0 0", "not of unit length"),
        ("0 0 0 0 0 1", "tx ty tz qx qy qz qw"),
        ("0 0 0 0 0 0 1 0", "tx ty tz qx qy qz qw"),
        ("0 0 0 0 0 0 one", "tx ty tz qx qy qz qw"),
    ],
)
def test_a_bad_pose_row_is_told_and_the_rest_is_read(tum_folder, row, reason):
    good = "1 2 3 0 0 0 1.004"  # printed with few digits: normed
    gt = poses((-0.05, 0.0, 0.05), [good, row, good])
    frames, left_out = read(tum_folder(groundtruth=gt, frames=1))
    assert [(reason in s.reason, s.stamp_ns) for s in left_out] == [(True, ORIGIN_NS)]
    np.testing.assert_allclose(frames[0].T_world_cam[:3], [[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 3]])


# ---- lists


@pytest.mark.parametrize("name", ["rgb.txt", "depth.txt", "groundtruth.txt"])
@pytest.mark.parametrize(
    ("lines", "reason"),
    [
        ("one {v}", "row is not 'seconds value ...'"),
        ("1305031237.0", "row is not 'seconds value ...'"),
        ("nan {v}", "row is not 'seconds value ...'"),
        ("1e30 {v}", "row is not 'seconds value ...'"),
        ("\ufeff1305031237.0 {v}", "row is not 'seconds value ...'"),
        ("1305031236.0 {v}", "stamp out of order; the row was sorted in"),
        ("1305031238.0 {v}\n1305031238.0 {v}", "stamp repeated"),
    ],
)
def test_a_bad_row_is_told_and_the_rest_is_read(tum_folder, name, lines, reason):
    still = "0 0 0 0 0 0 1"
    folder = tum_folder(groundtruth=poses(np.arange(-1, 5) / 10, [still] * 6))
    list_ = folder / name
    value = still if name == "groundtruth.txt" else f"{name.removesuffix('.txt')}/0.png"
    list_.write_text(list_.read_text() + lines.format(v=value) + "\n", "utf-8")
    frames, left_out = read(folder)
    assert [f.index - frames[0].index for f in frames] == [0, 1, 2, 3]
    assert all(f.T_world_cam is not None for f in frames)
    told = [s for s in left_out if not s.reason.startswith("no ")]
    assert [s.reason for s in told] == [reason]
    assert told[0].what.startswith(name)


def test_rows_out_of_order_are_sorted_in(tum_folder):
    folder = tum_folder(frames=4)
    lines = (folder / "depth.txt").read_text().splitlines(keepends=True)
    (folder / "depth.txt").write_text("".join([lines[0], lines[2], lines[1], *lines[3:]]))
    frames, left_out = read(folder)
    assert [f.stamp_ns - ORIGIN_NS for f in frames] == [k * STEP for k in range(4)]
    assert [(s.stamp_ns, s.what) for s in left_out] == [(ORIGIN_NS, "depth.txt:3")]


def test_rows_without_partner_are_told(tum_folder):
    late = ORIGIN_NS + 2 * STEP
    folder = tum_folder(frames=5)
    times = [ORIGIN_NS, ORIGIN_NS + STEP + 30_000_000, late]
    (folder / "depth.txt").write_text(rows(times, [f"depth/{k}.png" for k in range(3)]))
    frames, left_out = read(folder)
    assert [f.index for f in frames] == [0, 2]
    assert [(s.what, s.reason, s.index) for s in left_out] == [
        ("rgb/1.png", "no depth image within 0.02 s", 1),
        ("depth/1.png", "no colour image within 0.02 s", None),
        ("rgb/3.png", "no depth image within 0.02 s", 3),
        ("rgb/4.png", "no depth image within 0.02 s", 4),
    ]
    assert [f.index for f in read(folder, "read.association_s=0.03")[0]] == [0, 1, 2]


@pytest.mark.parametrize(("start", "stop", "kept"), [(0, 4, [0, 1, 2, 3]), (1, 3, [1, 2]), (1, 1, []), (4, 9, [])])
def test_the_window_is_half_open_and_indices_stay(tum_folder, start, stop, kept):
    folder = tum_folder(files={"depth/2.png": b""})
    window = (start * STEP, stop * STEP)
    frames, left_out = read(folder, window=window)
    assert sorted(x.index for x in (*frames, *left_out)) == kept
    assert [x.index for x in left_out] == [k for k in kept if k == 2]
    assert opened(folder).count(*window) == len(kept)


# ---- images


def test_a_frame_holds_what_the_files_hold(tum_folder):
    folder = tum_folder(frames=2, depth_m=1.5)
    image = cv2.imread(str(folder / "rgb/1.png"))
    jpeg = cv2.imencode(".jpg", image)[1].tobytes()
    (folder / "rgb/1.png").write_bytes(jpeg)  # what a file is, it says itself
    first, second = read(folder)[0]
    np.testing.assert_array_equal(first.rgb, cv2.imread(str(folder / "rgb/0.png"))[..., ::-1])
    np.testing.assert_allclose(first.depth, 1.5, rtol=1e-6)
    assert (first.rgb.shape, first.depth.shape, first.depth.dtype) == ((48, 64, 3), (48, 64), np.float32)
    for frame, kind in ((first, "png"), (second, "jpeg")):
        assert frame.encoded_rgb.data == (folder / f"rgb/{frame.index}.png").read_bytes()
        assert frame.encoded_rgb.media_type == f"image/{kind}"
        assert frame.encoded_depth.data == (folder / f"depth/{frame.index}.png").read_bytes()
        assert (frame.encoded_depth.media_type, frame.encoded_depth.units_per_meter) == ("image/png", 5000)
    with pytest.raises(ValueError, match="read-only"):
        first.depth[0, 0] = 1


def test_depth_zero_or_out_of_range_is_unseen(tum_folder, tmp_path):
    depth = np.full((48, 64), 5000, np.uint16)
    depth[0, :6] = [0, 499, 501, 20000, 20001, 65535]
    frames, _ = read(tum_folder(frames=1, files={"depth/0.png": png(depth)}), "read.depth_max_m=4")
    seen = np.isfinite(frames[0].depth)
    assert seen[0, :6].tolist() == [False, False, True, True, False, False]
    assert seen.sum() == 48 * 64 - 4
    frames, _ = read(tmp_path / "log", "read.depth_min_m=0", "read.depth_max_m=99")
    assert np.isfinite(frames[0].depth).sum() == 48 * 64 - 1


@pytest.mark.parametrize(
    ("camera", "sets", "units"),
    [
        ("", [], 5000),
        ("depth_scale 1000\n", [], 1000),
        ("depth_scale: 1000", ["read.depth_units_per_meter=500"], 500),
    ],
)
def test_depth_scale(tum_folder, camera, sets, units):
    folder = tum_folder(frames=1, camera="fx 60\nfy 60\ncx 31.5\ncy 23.5\n" + camera)
    frames, _ = read(folder, "read.depth_max_m=99", *sets)
    assert frames[0].depth[0, 0] == pytest.approx(10_000 / units)
    assert frames[0].encoded_depth.units_per_meter == units


def grey(width, height, dtype=np.uint16, channels=()):
    return np.full((height, width, *channels), 200, dtype)


NOISE = png(np.random.default_rng(0).integers(0, 255, (48, 64, 3), np.uint8))
NOISE16 = png(np.random.default_rng(0).integers(5000, 9000, (48, 64), np.uint16))


@pytest.mark.parametrize(
    ("files", "reason"),
    [
        ({"rgb/1.png": None}, "listed file is missing"),
        ({"depth/1.png": None}, "listed file is missing"),
        ({"depth/1.png": png(grey(64, 48, np.uint8))}, "depth image is 8-bit"),
        ({"depth/1.png": png(grey(64, 48, channels=(3,)))}, "depth image has 3 channels"),
        ({"rgb/1.png": png(grey(64, 40, np.uint8))}, "colour is 64x40, depth is 64x48; register"),
        (dict.fromkeys(("rgb/1.png", "depth/1.png"), png(grey(80, 60))), "size differs from the first"),
        ({"rgb/1.png": png(grey(16, 16, np.uint8))}, "colour image is smaller than 32 px"),
        ({"rgb/1.png": b""}, "colour image cannot be decoded"),
        ({"depth/1.png": b""}, "depth image cannot be decoded"),
        ({"rgb/1.png": b"\x89PNG\r\n\x1a\n"}, "colour image cannot be decoded"),
        ({"rgb/1.png": NOISE[: len(NOISE) // 2]}, "colour image cannot be decoded"),
        ({"depth/1.png": NOISE16[: len(NOISE16) // 2]}, "depth image cannot be decoded"),
        ({"rgb/1.png": "no image"}, "colour image cannot be decoded"),
    ],
)
def test_an_image_that_cannot_be_used_is_told(tum_folder, files, reason):
    frames, left_out = read(tum_folder(files=files))
    assert [f.index for f in frames] == [0, 2, 3]
    assert [(s.index, s.stamp_ns - ORIGIN_NS) for s in left_out] == [(1, STEP)]
    assert left_out[0].reason.startswith(reason) or reason in left_out[0].reason
    assert "rgb/1.png" in left_out[0].what


@pytest.mark.parametrize(
    ("listed", "reason"),
    [
        ("../outside.png", "outside the folder"),
        ("rgb/../../outside.png", "outside the folder"),
        ("/etc/hostname", "outside the folder"),
        ("rgb", "directory"),
        ("rgb/" + "x" * 300, "name too long"),
        ("rgb/\0.png", ""),
        ("rgb/loop.png", ""),
    ],
)
def test_a_listed_path_that_cannot_be_used_is_told(tum_folder, listed, reason):
    folder = tum_folder()
    (folder / "rgb/1.png").rename(folder.parent / "outside.png")
    (folder / "rgb/loop.png").symlink_to("loop.png")
    (folder / "rgb.txt").write_text((folder / "rgb.txt").read_text().replace("rgb/1.png", listed))
    frames, left_out = read(folder)
    assert [f.index for f in frames] == [0, 2, 3]
    assert [(s.index, reason in s.reason.lower()) for s in left_out] == [(1, True)]


def test_intrinsics_for_another_size_are_told_with_every_frame(tum_folder):
    frames, left_out = read(tum_folder("rgbd_dataset_freiburg2_desk", camera=None))
    assert not frames
    assert {s.reason for s in left_out} == {
        "image is 64x48, intrinsics (TUM RGB-D freiburg2) are for 640x480; give --intrinsics fx,fy,cx,cy"
    }


# ---- intrinsics

OTHER = "fx = 61 # px\nfy: 62\n\n# centre\nCX 30\ncy 20\nwidth 64\nheight 48\n"


@pytest.mark.parametrize(
    ("name", "camera", "sets", "fx"),
    [
        ("freiburg1_x", OTHER, [GIVEN], 60),
        ("freiburg1_x", None, [GIVEN], 60),
        ("freiburg1_x", OTHER, [], 61),
        ("plain", OTHER, [], 61),
        ("rgbd_dataset_freiburg1_x", None, [], 517.3),
        ("rgbd_dataset_freiburg3_x", None, [], 535.4),
        ("rgbd_bonn_x", OTHER, [GIVEN], 60),
        ("rgbd_bonn_x", OTHER, [], 61),
        ("rgbd_bonn_x", None, [], 542.822841),
    ],
)
def test_which_intrinsics_are_taken(tum_folder, name, camera, sets, fx):
    folder = tum_folder(name, camera=camera, frames=1, size=(640, 480) if fx > 500 else (64, 48))
    frames, _ = read(folder, *sets)
    assert frames[0].K[0, 0] == fx
    assert f"intrinsics {fx:g}, " in opened(folder, *sets).notes[0]


def test_intrinsics_from_a_file_elsewhere(tum_folder):
    folder = tum_folder(frames=1)
    (folder.parent / "my.txt").write_text(OTHER)
    frames, _ = read(folder, f"read.intrinsics={folder.parent / 'my.txt'}")
    np.testing.assert_array_equal(frames[0].K, [[61, 0, 30], [0, 62, 20], [0, 0, 1]])


@pytest.mark.parametrize(
    ("camera", "told"),
    [
        (None, "no intrinsics: no camera.txt"),
        ("", "lacks fx, fy, cx, cy"),
        ("fx 60\ncx 31.5\ncy 23.5\n", "lacks fy"),
        ("fx 60\nfy\n", "camera.txt:2: write a name and a number"),
        ("fx sixty\n", "camera.txt:1: write a name and a number"),
        ("60 60 31.5 23.5\n", "camera.txt:1: write a name and a number"),
        ("fx -60\nfy 60\ncx 1\ncy 1\n", "must be positive"),
        ("fx nan\nfy 60\ncx 1\ncy 1\n", "a name and a number"),
        ("fx 60\nfy 60\ncx 1\ncy 1\nwidth nan\n", ""),
        ("fx 60\nfy 60\ncx 1\ncy 1\ndepth_scale -1\n", "finite"),
        (b"\xff\xfe\x00", "cannot read the intrinsics"),
    ],
)
def test_intrinsics_that_cannot_be_used(tum_folder, camera, told):
    assert told in cannot_open(tum_folder(camera=camera))


@pytest.mark.parametrize(
    "text",
    ["1,2,3", "1,2,3,x", "nowhere/camera.txt", "0,60,1,1", "60,60,inf,1", "x" * 300],
    ids=lambda t: t[:20],
)
def test_given_intrinsics_that_cannot_be_used(tum_folder, text):
    with pytest.raises(InputError, match="--intrinsics"):
        opened(tum_folder(), f"read.intrinsics={text}")


# ---- what cannot be opened


@pytest.mark.parametrize(
    ("files", "sets", "told"),
    [
        ({"rgb.txt": None}, [], "rgb.txt: not found"),
        ({"depth.txt": None}, [], "depth.txt: not found"),
        ({"rgb.txt": None, "depth.txt": None, "rgb": None}, [], "no known kind of log"),
        ({"rgb.txt": ""}, [], "rgb.txt: lists no image"),
        ({"depth.txt": "# nothing\n\n"}, [], "depth.txt: lists no image"),
        ({"depth.txt": b"\xff\x00\x89PNG"}, [], "depth.txt: cannot be read"),
        ({"groundtruth.txt": b"\xff\x00\x89PNG"}, [], "groundtruth.txt: cannot be read"),
        ({}, ["read.association_s=0.001"], "no colour image within 0.001 s"),
    ],
)
def test_a_folder_that_cannot_be_opened(tum_folder, files, sets, told):
    assert told in cannot_open(tum_folder(files=files), *sets)


def test_a_path_that_is_no_folder(tum_folder, tmp_path):
    assert "no such file or folder" in cannot_open(tmp_path / "nowhere")
    assert "no known kind of log" in cannot_open(tum_folder() / "rgb.txt")
    assert "no known kind of log" in cannot_open(tum_folder("other") / "rgb/0.png")


def test_a_folder_of_logs_names_them(tum_folder):
    folder = tum_folder("one").parent
    tum_folder("two")
    (folder / "neither").mkdir()
    assert cannot_open(folder).endswith("it holds logs, take one: one, two")


# ---- Bonn


@pytest.mark.parametrize(("name", "is_bonn"), [("rgbd_bonn_x", 1), ("Bonn/x", 1), ("x", 0), ("bonn/a/x", 0)])
def test_bonn_is_known_by_name(tum_folder, name, is_bonn):
    log = opened(tum_folder(name, camera=None if is_bonn else "fx 1\nfy 1\ncx 1\ncy 1\n", frames=1))
    assert ("Bonn RGB-D Dynamic" in log.notes[0]) is bool(is_bonn)


def test_poses_of_bonn(tum_folder):
    rotation = Rotation.from_rotvec([0.1, -0.7, 0.4])
    row = " ".join(str(x) for x in [1, 2, 3, *rotation.as_quat()])
    gt = poses((0, 0.1), [row, row])
    frames, left_out = read(tum_folder("rgbd_bonn_x", camera=None, frames=2, groundtruth=gt), GIVEN)
    listed = np.eye(4)
    listed[:3, :3], listed[:3, 3] = rotation.as_matrix(), [1, 2, 3]
    marker = conventions.BONN_MARKER.copy()
    marker[:3, :3] = polar(conventions.BONN_MARKER[:3, :3])[0]
    for frame in frames:
        T = frame.T_world_cam
        np.testing.assert_allclose(T, conventions.BONN_ROS @ listed @ conventions.BONN_ROS @ marker, atol=1e-9)
        np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-9)
        assert np.linalg.det(T[:3, :3]) == pytest.approx(1)
    assert len(frames) == 2
    assert not left_out


def test_given_intrinsics_leave_the_depth_scale_as_it_was(tum_folder):
    folder = tum_folder(files={"camera.txt": "fx 60\nfy 60\ncx 31.5\ncy 23.5\ndepth_scale 1000\n"})
    notes = open_log(folder, ReadSettings(intrinsics="60,60,31.5,23.5")).notes
    assert "depth 1000 per metre" in notes


def test_a_freiburg_log_beside_bonn_ones_is_none(tum_folder):
    assert recognise(tum_folder(name="bonn/rgbd_dataset_freiburg1_xyz")).name == "tum"
    assert recognise(tum_folder(name="bonn/crowd")).name == "bonn"
    assert recognise(tum_folder(name="elsewhere/rgbd_bonn_crowd")).name == "bonn"
