"""Folders that are not in TUM layout: equal content gives equal frames, and what is unclear is refused in one line."""

import shutil

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import own_reader
import vlmm_log
from tum_folder import ORIGIN_NS, png, rows, text_of
from vlmm_log import se3
from vlmm_log.readers import recognise
from vlmm_log.readers.matrices import pose_of_matrix
from vlmm_log.readers.numbered import nominal_ns
from vlmm_log.readers.plain import Icl, Plain
from vlmm_log.readers.seven_scenes import SevenScenes
from vlmm_log.readers.tum import Tum
from vlmm_log.settings import Settings
from vlmm_log.types import Frame, InputError, Skipped

EVER = 2**62
N = 4
STEP = 100_000_000
CAMERA = "fx 60\nfy 61\ncx 31.5\ncy 23.5\ndepth_scale 1000\n"
IDENTITY = "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"


def poses(seed=3):
    """N poses (4, 4) of cameras that are held upright in a world with z up."""
    random = np.random.default_rng(seed)
    upright = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    T = np.tile(np.eye(4), (N, 1, 1))
    T[:, :3, :3] = Rotation.from_rotvec(random.normal(0, 0.2, (N, 3))).as_matrix() @ upright
    T[:, :3, 3] = random.normal(size=(N, 3))
    return T


def tum_text(keys, T):
    lines = [[key, *(repr(float(x)) for x in (*M[:3, 3], *se3.quaternion(M)))] for key, M in zip(keys, T, strict=True)]
    return "".join(" ".join(words) + "\n" for words in lines)


def numbers_of(M):
    return " ".join(repr(float(x)) for x in np.ravel(M))


def lines_of(T):
    return "".join(f"{numbers_of(row)}\n" for M in T for row in M)


@pytest.fixture
def content(tum_folder):
    """A log in TUM layout: what all others are made of."""
    gt = tum_text([text_of(ORIGIN_NS + k * STEP) for k in range(N)], poses())
    return tum_folder("content", frames=N, offset_ns=0, shift_px=3, depth_m=0.4, camera=CAMERA, groundtruth=gt)


@pytest.fixture
def plain(content, tmp_path):
    """``plain(files=..., rgb="color", name="{:d}.png", first=0)``: the content as a plain folder."""

    def write(where="plain", *, rgb="rgb", name="{:d}", first=0, camera=CAMERA, files=()):
        folder = tmp_path / where
        for kind, source in ((rgb, "rgb"), ("depth", "depth")):
            (folder / kind).mkdir(parents=True)
            for k in range(N):
                named = name(k) if callable(name) else name.format(first + k)
                shutil.copy(content / source / f"{k}.png", folder / kind / f"{named}.png")
        for file, text in {"camera.txt": camera, **dict(files)}.items():
            if text is not None:
                (folder / file).parent.mkdir(exist_ok=True)
                (folder / file).write_bytes(text.encode() if isinstance(text, str) else text)
        return folder

    return write


def opened(folder, *sets, reader=None):
    return (reader or Plain()).open(folder, Settings.load(sets=sets).read)


def read(folder, *sets, reader=None):
    items = list(opened(folder, *sets, reader=reader).frames(0, EVER))
    return [x for x in items if isinstance(x, Frame)], [x for x in items if isinstance(x, Skipped)]


def refused(folder, *sets, reader=None):
    with pytest.raises(InputError) as e:
        opened(folder, *sets, reader=reader)
    assert "\n" not in str(e.value)
    assert str(folder) in str(e.value)
    return str(e.value)


def assert_same(frames, content, *, stamps=None, posed=range(N)):
    """The frames are those of the TUM folder, at ``stamps``; those in ``posed`` have its poses."""
    true, _ = read(content, reader=Tum())
    assert [f.index for f in frames] == [f.index for f in true] == list(range(N))
    stamps = [nominal_ns(k) for k in range(N)] if stamps is None else stamps
    for k, (a, b) in enumerate(zip(frames, true, strict=True)):
        assert a.stamp_ns == stamps[k]
        for x, y in ((a.rgb, b.rgb), (a.depth, b.depth), (a.K, b.K)):
            np.testing.assert_array_equal(x, y)
        assert a.encoded_depth.data == b.encoded_depth.data
        assert (a.T_world_cam is not None) == (k in posed)
        if k in posed:
            np.testing.assert_allclose(a.T_world_cam, b.T_world_cam, atol=1e-12)


# ---- poses in every form

SECONDS = [ORIGIN_NS + k * STEP for k in range(N)]
BLOCKS = "".join(f"{k} {k} {k + 1}\n{lines_of(poses()[k : k + 1])}" for k in range(N))
FORMS = {
    "groundtruth.txt": tum_text("0123", poses()),
    "CameraTrajectory.txt": tum_text([f"{k}.000000" for k in range(N)], poses()),
    "livingRoom2.gt.freiburg": tum_text("0123", poses()),
    "poses.txt": "".join(f"{numbers_of(M[:3])}\n" for M in poses()),
    "traj.txt": "".join(f"{numbers_of(M)}\n" for M in poses()),
    "traj_w_c.txt": "".join(f"{numbers_of(M)}\n" for M in poses()).replace(" ", ", "),
    "trajectory.txt": "# four rows a frame\n" + lines_of(poses()),
    "traj0.log": BLOCKS,
}


@pytest.mark.parametrize("file", FORMS)
def test_poses_are_known_by_their_content(plain, content, file):
    folder = plain(files={file: FORMS[file]})
    frames, left_out = read(folder)
    assert_same(frames, content)
    assert not left_out
    log = opened(folder)
    assert (log.has_poses, log.world_up) == (True, "+z")
    assert any(file in note for note in log.notes)


@pytest.mark.parametrize("where", ["pose", "poses"])
def test_poses_of_one_file_a_frame(plain, content, where):
    files = {f"{where}/{k}.txt": lines_of(poses()[k : k + 1]) for k in range(N)}
    files[f"{where}/2.txt"] = "-inf -inf -inf -inf\n" * 4  # ScanNet: lost
    files[f"{where}/9.txt"] = files[f"{where}/1.txt"]
    frames, left_out = read(plain(files=files), "read.pose_gap_s=0.05")
    assert_same(frames, content, posed=[0, 1, 3])
    assert [(x.what, x.reason) for x in left_out if x.what.startswith(f"{where}/")] == [
        (f"{where}/9.txt", "no image has its number"),
        (f"{where}/2.txt", "pose is not finite"),
    ]


def test_the_world_is_the_first_camera_where_it_starts_with_it(plain):
    first = np.linalg.inv(poses()[0]) @ poses()
    log = opened(plain(files={"poses.txt": "".join(f"{numbers_of(M[:3])}\n" for M in first)}))
    assert log.world_up == "-y"
    assert "world's up -y: the axis nearest to the cameras' mean up" in log.notes


@given(st.integers(0, 2**32 - 1), st.floats(0, 4e-3))
def test_a_printed_rotation_becomes_the_nearest_one(seed, error):
    random = np.random.default_rng(seed)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.random(random_state=random).as_matrix(), random.normal(size=3)
    printed = T.copy()
    printed[:3, :3] += random.uniform(-error, error, (3, 3)) / 3
    pose = pose_of_matrix(printed)
    np.testing.assert_allclose(se3.from_quaternion(pose[:3], pose[3:]), T, atol=max(3 * error, 1e-12))
    mirrored = T @ np.diag([1.0, -1, 1, 1])
    assert "reflection" in pose_of_matrix(mirrored)
    assert "orthonormal" in pose_of_matrix(T @ np.diag([1.0, 1.02, 1, 1]))


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (np.full((4, 4), np.nan), "pose is not finite"),
        (np.diag([1, 1, 1e200, 1]), "pose holds more than 1e+09 m"),
        (np.diag([2.0, 2, 2, 1]), "pose's rotation is not orthonormal"),
        (np.diag([1.0, -1, 1, 1]), "pose's rotation is a reflection: its camera or world is left-handed"),
        (np.ones((4, 4)), "pose's last row is not 0 0 0 1"),
    ],
)
def test_a_matrix_that_is_no_pose_is_told(plain, content, bad, reason):
    T = poses()
    T[1] = bad
    frames, left_out = read(plain(files={"traj.txt": "".join(f"{numbers_of(M)}\n" for M in T)}), "read.pose_gap_s=0.05")
    assert_same(frames, content, posed=[0, 2, 3])
    assert (left_out[0].what, left_out[0].reason) == ("traj.txt: pose 1", reason)
    assert left_out[0].stamp_ns == nominal_ns(1)


def test_rows_of_poses_may_be_those_of_all_frames(plain, content):
    every = np.repeat(poses(), 3, axis=0)  # rows 0, 3, 6, 9 are of the images that were kept
    folder = plain(name=lambda k: f"{3 * k:06d}", files={"poses.txt": "".join(f"{numbers_of(M[:3])}\n" for M in every)})
    frames, _ = read(folder)
    assert_same(frames, content, stamps=[nominal_ns(3 * k) for k in range(N)])


def test_flags_reach_the_poses(plain, content):
    inverse = "".join(f"{numbers_of(np.linalg.inv(M))}\n" for M in poses())
    frames, _ = read(plain(files={"traj.txt": inverse}), "read.poses=world_to_camera")
    assert_same(frames, content)


# ---- times


@pytest.mark.parametrize("rgb", ["rgb", "color", "colour", "image", "images"])
@pytest.mark.parametrize("name", ["{:d}", "{:06d}", "frame{:05d}", "cam0_{:04d}", "{:04d}_left"])
def test_numbered_images_get_nominal_times(plain, content, rgb, name):
    folder = plain(rgb=rgb, name=name)
    frames, left_out = read(folder)
    assert_same(frames, content, posed=[])
    assert not left_out
    assert "stamps are nominal, 30 per second: speeds in m/s mean nothing" in opened(folder).notes


@pytest.mark.parametrize(
    ("name", "ns", "unit"),
    [
        (text_of, 1, "s"),
        (lambda ns: "rgb_" + text_of(ns), 1, "s"),
        (str, 1, "ns"),
        (lambda ns: str(ns // 1000), 1000, "us"),
        (lambda ns: str(ns // 10**6), 10**6, "ms"),
    ],
)
def test_names_that_are_times_are_stamps(plain, content, name, ns, unit):
    gt = tum_text([text_of(t) for t in SECONDS], poses())
    folder = plain(name=lambda k: name(SECONDS[k]), files={"groundtruth.txt": gt, "times.txt": "0\n"})
    frames, left_out = read(folder)
    assert_same(frames, content, stamps=[t // ns * ns for t in SECONDS])
    assert not left_out
    assert f"stamps are the images' names, in {unit}; times.txt is not read" in opened(folder).notes


def test_matrices_belong_to_images_named_by_time_in_order(plain, content):
    files = {"poses.txt": "".join(f"{numbers_of(M[:3])}\n" for M in poses())}
    assert_same(read(plain(name=lambda k: str(SECONDS[k]), files=files))[0], content, stamps=SECONDS)
    files = {f"pose/{text_of(t)}.txt": lines_of([M]) for t, M in zip(SECONDS, poses(), strict=True)}
    assert_same(read(plain("other", name=lambda k: text_of(SECONDS[k]), files=files))[0], content, stamps=SECONDS)


@pytest.mark.parametrize("list_", ["times.txt", "timestamps.txt"])
@pytest.mark.parametrize("posed_by", ["number", "time"])
def test_a_list_of_times(plain, content, list_, posed_by):
    keys = [text_of(t) for t in SECONDS] if posed_by == "time" else list("3456")
    files = {list_: "\n".join(map(text_of, SECONDS)), "groundtruth.txt": tum_text(keys, poses())}
    folder = plain(first=3, files=files)
    frames, left_out = read(folder)
    assert_same(frames, content, stamps=SECONDS)
    assert not left_out
    assert f"stamps from {list_}" in opened(folder).notes


def test_associations_of_times(plain, content):
    lines = [f"{text_of(t)} rgb/{k}.png {text_of(t + 1000)} ./depth/{k}.png" for k, t in enumerate(SECONDS)]
    folder = plain(files={"associations.txt": "\n".join([*lines[:3], "1 rgb/8.png 1 depth/8.png"])})
    frames, left_out = read(folder)
    assert [f.stamp_ns for f in frames] == [t + 1000 for t in SECONDS[:3]]
    assert sorted((x.what, x.reason) for x in left_out) == [
        ("depth/3.png", "not in associations.txt"),
        ("depth/8.png", "listed file is missing"),
        ("rgb/3.png", "not in associations.txt"),
        ("rgb/8.png", "listed file is missing"),
    ]


def test_images_without_a_partner_and_other_files_are_told(plain):
    folder = plain(files={"rgb/notes.md": "", "depth/7.png": png(np.ones((48, 64), np.uint16))})
    (folder / "depth/1.png").unlink()
    (folder / "depth/2.png").unlink()
    frames, left_out = read(folder)
    assert [f.index for f in frames] == [0, 3]
    assert [(x.what, x.reason) for x in left_out] == [
        ("rgb/notes.md", "not a numbered .png, .jpg, .jpeg"),
        ("rgb/1.png", "no depth image within 0.02 s"),
        ("rgb/2.png", "no depth image within 0.02 s"),
        ("depth/7.png", "no colour image within 0.02 s"),
    ]


# ---- depth and intrinsics


@pytest.mark.parametrize(
    ("scale", "sets", "units", "assumed"),
    [
        ("", [], 1000, True),
        ("depth_scale 4000\n", [], 4000, False),
        ("", ["read.depth_units_per_meter=2500"], 2500, False),
        (None, ["read.intrinsics=60,61,31.5,23.5"], 1000, True),
    ],
)
def test_millimetres_are_assumed_and_told(plain, scale, sets, units, assumed):
    camera = None if scale is None else "fx 60\nfy 61\ncx 31.5\ncy 23.5\n" + scale
    folder = plain(camera=camera)
    frames, _ = read(folder, *sets)
    assert frames[0].depth[0, 0] == pytest.approx(2000 / units)
    assert ("depth 1000 per metre, assumed: run doctor" in opened(folder, *sets).notes) is assumed


def test_a_name_of_tum_brings_its_camera_and_scale(plain):
    log = opened(plain("rgbd_dataset_freiburg2_xyz", camera=None))
    assert (log.camera.fx, log.units_per_meter) == (520.9, 5000)
    assert not any("assumed" in note for note in log.notes)


# ---- what is refused

MATRIX = f"{IDENTITY}\n" * N
REFUSED = {
    "two pose files": ({"poses.txt": MATRIX, "traj.txt": MATRIX}, "poses.txt and traj.txt could each hold the poses"),
    "file and folder": ({"poses.txt": MATRIX, "pose/0.txt": MATRIX}, "remove all but one"),
    "too few poses": ({"poses.txt": f"{IDENTITY}\n" * 2}, "2 rows for 4 images up to number 3; write one for each"),
    "no form": ({"poses.txt": "1 2 3 4 5\n"}, "poses.txt:1: poses in no known form; write 8 numbers a row"),
    "mixed": ({"poses.txt": MATRIX + "0 0 0 0 0 0 0 0\n"}, "poses in no known form"),
    "empty": ({"poses.txt": "# nothing\n"}, "poses in no known form"),
    "no numbers": ({"poses.txt": MATRIX.replace("0", "o")}, "could not convert"),
    "no text": ({"poses.txt": b"\xff\x00\x89PNG"}, "cannot be read"),
    "times of numbered": ({"groundtruth.txt": tum_text(map(text_of, SECONDS), poses())}, "list the images' times in"),
    "times in ns": ({"groundtruth.txt": tum_text(map(str, SECONDS), poses())}, "stamps of 19 digits; write seconds"),
    "poses by time": ({"pose/1305031237.5.txt": lines_of(poses()[:1])}, "poses are named by time where images are"),
    "two time lists": ({"times.txt": "0", "timestamps.txt": "0"}, "both times.txt and timestamps.txt could time"),
    "too few times": ({"times.txt": "0\n1\n"}, "times.txt: 2 rows for 4 images"),
    "times fall": ({"times.txt": "0\n2\n1\n3\n"}, "times do not ascend"),
    "no times": ({"times.txt": "0\none\n2\n3\n"}, "'one' is no time in seconds"),
    "no list": ({"times.txt": "0 0\n1 1\n"}, "write a time in seconds a row, or 'time file time file'"),
    "nothing listed": ({"associations.txt": "0 a.png 0 b.png\n"}, "lists no colour or no depth image"),
    "two colours": ({"image/0.png": ""}, "both rgb/ and image/ could be the colour images; keep one"),
    "one number twice": ({"rgb/01.png": ""}, "rgb/01.png and rgb/1.png have one number; keep one"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_unclear_is_refused(plain, case):
    files, told = REFUSED[case]
    assert told in refused(plain(files=files))


def test_numbers_that_do_not_say_what_belongs_together(plain, content):
    folder = plain()
    (folder / "depth/0.png").rename(folder / "depth/4.png")
    assert "colour images are numbered 0 to 3, depth images 1 to 4, so it is not clear" in refused(folder)
    shutil.rmtree(folder / "depth")
    shutil.copytree(content / "depth", folder / "depth")
    for k in range(N):
        (folder / f"depth/{k}.png").rename(folder / f"depth/{text_of(SECONDS[k])}.png")
    assert "named by time, those of the other by number" in refused(folder)


def test_folders_without_images_or_camera(plain):
    assert "no intrinsics" in refused(plain(camera=None))
    folder = plain("empty")
    shutil.rmtree(folder / "depth")
    (folder / "depth").mkdir()
    (folder / "depth/0.exr").touch()
    assert "depth: holds no numbered .png, .pgm" in refused(folder)
    names = [str(10**15 + 10**14 * k) for k in range(N)]
    assert "is no frame time in ns, us or ms" in refused(plain("slow", name=lambda k: names[k]))


# ---- ICL-NUIM


@pytest.mark.parametrize("name", ["living_room_traj2_frei_png", "office_room_traj0_loop", "traj1_frei_png"])
def test_icl_has_its_camera_scale_and_mirror(plain, name):
    T = poses()
    files = {
        "associations.txt": "".join(f"{k} depth/{k}.png {k} rgb/{k}.png\n" for k in range(1, N + 1)),
        "x.gt.freiburg": tum_text("1234", T),
    }
    folder = plain(name, first=1, camera=None, files=files)
    assert Icl().recognises(folder)
    log = opened(folder, reader=Icl())
    assert (log.camera.fx, log.camera.fy, log.units_per_meter, log.world_up) == (481.2, 480, 5000, "-y")
    assert any("not checked" in note for note in log.notes)
    frames, left_out = read(folder, "read.intrinsics=60,61,31.5,23.5", reader=Icl())
    mirror = np.diag([1.0, -1, 1, 1])
    assert [f.stamp_ns for f in frames] == [nominal_ns(k) for k in range(1, N + 1)]
    for frame, M in zip(frames, T, strict=True):
        np.testing.assert_allclose(frame.T_world_cam, mirror @ M @ mirror, atol=1e-12)
        assert frame.depth[0, 0] == pytest.approx(0.4)
    assert not left_out


def test_icl_with_lists_of_tum(tum_folder):
    gt = rows([ORIGIN_NS, ORIGIN_NS + STEP], ["1 2 3 0 0 0 1"] * 2)
    folder = tum_folder("living_room_traj0_frei_png", camera=None, groundtruth=gt, frames=2)
    assert Icl().recognises(folder)
    frames, _ = read(folder, "read.intrinsics=60,60,31.5,23.5", reader=Icl())
    np.testing.assert_array_equal(frames[0].T_world_cam[:3, 3], [1, -2, 3])


# ---- 7-Scenes

INFO = (
    "m_versionNumber = 4\nm_sensorName = StructureSensor\nm_colorWidth = 64\nm_colorHeight = 48\nm_depthShift = 1000\n"
)
INFO += "m_calibrationColorIntrinsic = 60 0 31.5 0 0 61 23.5 0 0 0 1 0 0 0 0 1\n"
OTHER_DEPTH = "m_calibrationDepthIntrinsic = 65 0 31.5 0 0 61 23.5 0 0 0 1 0 0 0 0 1\n"


@pytest.fixture
def scene(content, tmp_path):
    """``scene(files=...)``: the content named as 7-Scenes names it."""

    def write(where="seq-01", *, files=(("camera.txt", CAMERA),)):
        folder = tmp_path / where
        folder.mkdir(parents=True)
        for k in range(N):
            for kind, source in (("color", "rgb"), ("depth", "depth")):
                shutil.copy(content / source / f"{k}.png", folder / f"frame-{k:06d}.{kind}.png")
            (folder / f"frame-{k:06d}.pose.txt").write_text(lines_of(poses()[k : k + 1]).replace(" ", "\t"))
        for file, text in dict(files).items():
            (folder / file).write_bytes(text.encode() if isinstance(text, str) else text)
        return folder

    return write


@pytest.mark.parametrize("files", [{"camera.txt": CAMERA}, {"_info.txt": INFO}, {"info.txt": INFO}])
def test_seven_scenes(scene, content, files):
    folder = scene(files=files)
    assert SevenScenes().recognises(folder)
    frames, left_out = read(folder, reader=SevenScenes())
    assert_same(frames, content)
    assert not left_out
    assert (
        "stored depth 65535 (65.535 m) is unseen: beyond read.depth_max_m" in opened(folder, reader=SevenScenes()).notes
    )


def test_65535_of_seven_scenes_is_unseen(scene):
    depth = np.full((48, 64), 1500, np.uint16)
    depth[:10] = 65535
    folder = scene(files={"camera.txt": CAMERA, "frame-000000.depth.png": png(depth)})
    frames, _ = read(folder, reader=SevenScenes())
    assert np.isnan(frames[0].depth[:10]).all()
    assert (frames[0].depth[10:] == np.float32(1.5)).all()
    far = opened(folder, "read.depth_max_m=99", reader=SevenScenes())
    assert any("keep read.depth_max_m below" in note for note in far.notes)


def test_what_a_scene_lacks_is_told(scene, content):
    folder = scene(files={"camera.txt": CAMERA, "frame-000001.pose.txt": "lost", "frame-000009.pose.txt": "lost"})
    (folder / "frame-000003.pose.txt").unlink()
    frames, left_out = read(folder, "read.pose_gap_s=0.05", reader=SevenScenes())
    assert_same(frames, content, posed=[0, 2])
    assert [(x.what, x.reason) for x in left_out] == [
        ("frame-000009.pose.txt", "no image has its number"),
        ("frame-000001.pose.txt", "pose is not four rows of four numbers"),
        ("pose of frame 1", "no two poses around it within 0.05 s"),
        ("pose of frame 3", "no two poses around it within 0.05 s"),
    ]


@pytest.mark.parametrize(
    ("files", "told"),
    [
        ({}, "(7-Scenes names 585,585,320,240 for its depth camera"),
        ({"_info.txt": "m_colorWidth = 64\n"}, "no row 'm_calibrationColorIntrinsic = '"),
        ({"_info.txt": b"\xff\x00"}, "no row 'm_calibrationColorIntrinsic = '"),
        ({"_info.txt": INFO + OTHER_DEPTH}, "depth is calibrated apart from colour (fx 65, not 60 px)"),
    ],
)
def test_a_scene_that_cannot_be_opened(scene, content, files, told):
    folder = scene(files=files)
    assert told in refused(folder, reader=SevenScenes())
    frames, _ = read(folder, "read.intrinsics=60,61,31.5,23.5", reader=SevenScenes())
    assert_same(frames, content)


def test_record3d_is_refused_with_a_remedy(tmp_path):
    (tmp_path / "a/EXR_RGBD").mkdir(parents=True)
    (tmp_path / "b/rgbd").mkdir(parents=True)
    (tmp_path / "b/metadata").touch()
    (tmp_path / "c.r3d").touch()
    for path in (tmp_path / "a", tmp_path / "b", tmp_path / "c.r3d"):
        assert SevenScenes().recognises(path)
        assert "write depth/N.png, 16 bit in mm" in refused(path, reader=SevenScenes())


# ---- among the other readers


def test_each_layout_has_one_reader(content, plain, scene, tum_folder):
    icl = plain("living_room_traj1_frei_png")
    assert [recognise(x).name for x in (content, plain(), scene(), icl)] == ["tum", "folder", "7-scenes", "icl"]
    lists = tum_folder("living_room_traj0_frei_png", frames=2)
    assert recognise(lists).name == "icl"


def test_a_folder_of_sequences_names_them(scene):
    folder = scene("chess/seq-01").parent
    scene("chess/seq-02")
    (folder / "TrainSplit.txt").write_text("sequence1\n")
    with pytest.raises(InputError, match=r"it holds logs, take one: seq-01, seq-02$"):
        recognise(folder)


# ---- a reader of one's own


@pytest.fixture
def arrays(content, tmp_path):
    frames, _ = read(content, reader=Tum())
    np.savez(
        tmp_path / "own.npz",
        rgb=np.stack([f.rgb for f in frames]),
        depth=np.stack([f.depth for f in frames]),
        K=frames[0].K,
        stamps_ns=np.array([f.stamp_ns for f in frames]),
        poses=np.stack([f.T_world_cam for f in frames]),
    )
    return own_reader.Arrays(tmp_path / "own.npz")


def test_a_log_of_ones_own_gives_the_same_frames(arrays, content):
    frames = list(arrays.frames(0, EVER))
    for a, b in zip(frames, read(content, reader=Tum())[0], strict=True):
        assert (a.stamp_ns, a.index) == (b.stamp_ns, b.index)
        for x, y in ((a.rgb, b.rgb), (a.depth, b.depth), (a.K, b.K), (a.T_world_cam, b.T_world_cam)):
            np.testing.assert_array_equal(x, y)
    assert arrays.count(STEP, 3 * STEP) == len(list(arrays.frames(STEP, 3 * STEP))) == 2


def test_a_log_of_ones_own_is_processed_as_any_other(arrays, content):
    settings = Settings.load(sets=["keyframes.gap=1"])
    own, tum = (vlmm_log.process(source, settings=settings) for source in (arrays, content))
    assert own.end.input_hash == tum.end.input_hash
    assert own.end.pairs == tum.end.pairs == N - 1
    assert own.run.source == "own.npz"


def test_a_colour_image_may_be_a_jpeg(plain):
    folder = plain()
    image = cv2.imread(str(folder / "rgb/1.png"))
    (folder / "rgb/1.JPG").write_bytes(cv2.imencode(".jpg", image)[1].tobytes())
    (folder / "rgb/1.png").unlink()
    frames, left_out = read(folder)
    assert frames[1].encoded_rgb.media_type == "image/jpeg"
    assert (len(frames), left_out) == (N, [])
