"""Data at the edge of what numbers hold: every run ends, with figures that are finite or told why they are not."""

import json

import cv2
import numpy as np
import pytest
from own_log import SIZE, K, OwnLog, at, own_frame, own_frames, posed, room_depth, texture
from small_room import write_masks

import vlmm_log
from tum_folder import rows, write_tum_folder
from vlmm_log import se3
from vlmm_log.readers.own import Own
from vlmm_log.readers.stamps import LATEST_NS
from vlmm_log.recording import open_recording
from vlmm_log.settings import Settings
from vlmm_log.sinks.memory import Memory
from vlmm_log.types import Ego, FlowField, Frame, InputError, Motion, Odometry, Skipped, Validity

D_M = "world/camera/image/residual/d_m"
REASONS = {v.value for v in Validity}


class Ran:
    """A run with all its outputs, after all that holds of any run was checked."""

    def __init__(self, source, folder, *sets, mcap=True, frames=None):
        folder.mkdir(parents=True, exist_ok=True)
        memory = Memory()
        outputs = {"rrd": folder / "a.rrd", "map": folder / "a.json"} | ({"mcap": folder / "a.mcap"} if mcap else {})
        settings = Settings.load(sets=["keyframes.gap=1", *sets])
        self.done = vlmm_log.process(source, sinks=[memory], settings=settings, queries=["what moved"], **outputs)
        seen = [result for _, result in memory.seen]
        self.motions, self.egos, self.flows, self.odometry = (
            [r for r in seen if isinstance(r, kind)] for kind in (Motion, Ego, FlowField, Odometry)
        )
        self.skipped = [r for r in seen if isinstance(r, Skipped)]
        self._checked(outputs, frames)

    @property
    def reliable(self):
        return [ego.reliable for ego in self.egos]

    def share(self, reason, pair=0):
        return float(np.mean(self.motions[pair].validity == reason))

    def _checked(self, outputs, frames):
        assert set(self.done.outputs) == set(outputs.values()) and self.done.end.complete
        for motion in self.motions:
            told_why(motion)
        for ego in self.egos:
            for field in (ego.T_second_first, ego.row_twist, ego.covariance, ego.correction):
                assert np.isfinite(field).all()
        assert all(np.isfinite(flow.forward).all() for flow in self.flows)
        assert all(np.isfinite(o.T_world_first).all() and np.isfinite(o.T_world_second).all() for o in self.odometry)
        json.loads(outputs["map"].read_text(), parse_constant=refused)
        for path in self.done.outputs[:-1]:
            recording = open_recording(path)
            assert len(stamps_in(recording)) == self.done.end.pairs and not recording.losses
        assert self.done.summary.unreliable_pairs == self.reliable.count(False)
        unusable = sum(s.what.startswith("frame ") for s in self.skipped)
        if frames is not None:
            assert self.done.end.frames + unusable == frames
        assert sum(self.done.summary.skipped.values()) >= len(self.skipped)
        assert self.done.end.pairs + sum(s.what.startswith("pair of") for s in self.skipped) >= self.done.end.frames


def stamps_in(recording):
    return [e.stamp_ns for e in recording.entries([D_M]) if e.stamp_ns is not None]


def refused(constant):
    raise AssertionError(f"{constant} in a map")


def told_why(motion):
    """A pixel has finite figures, or a reason and none."""
    assert set(np.unique(motion.validity)) <= REASONS
    valid = motion.validity == Validity.VALID
    covariances = motion.covariances(1)
    for field in (motion.d_m, motion.p_stat, covariances.sigma_z, *motion.residual, *covariances.upper):
        assert np.isfinite(field[valid]).all()
        assert np.isnan(field[~valid]).all()
    assert (motion.d_m[valid] >= 0).all()
    assert ((motion.p_stat[valid] >= 0) & (motion.p_stat[valid] <= 1)).all()


SEGMENTERS = ["geometric", "masks"]


def segmenter(name, folder, frames):
    """The settings that choose it: masks of a box, and of a strip that goes with no name."""
    if name == "geometric":
        return ()
    image = np.zeros(frames[0].depth.shape, np.uint8)
    H, W = image.shape
    image[H // 3 : 2 * H // 3, W // 3 : 2 * W // 3], image[: H // 4] = 1, 2
    write_masks(folder / "masks", {f.index: image for f in frames})
    return (f"objects.segmenter=masks:{folder / 'masks'}",)


def process(frames, folder, *sets, kind="geometric", **options):
    return Ran(OwnLog(frames), folder / "out", *segmenter(kind, folder, frames), *sets, frames=len(frames), **options)


# ---- depth


def patched(value, where, frames=(0, 1, 2)):
    """Three frames, in some of which depth has a value in a patch, at every sixth pixel, or everywhere."""
    places = {"patch": np.s_[10:50, 10:80], "grid": np.s_[::2, ::3], "all": np.s_[:]}
    made = []
    for k in range(3):
        depth = room_depth()
        depth[places[where]] = value if k in frames else depth[places[where]]
        made.append(own_frame(k, depth=depth))
    return made


UNSEEN = [np.nan, np.inf, -np.inf, 0.0, -0.0, -1.0, 1e-45, 3e38]


@pytest.mark.parametrize("value", UNSEEN)
def test_what_is_no_depth_is_unseen_wherever_it_comes_from(tmp_path, value):
    frames = patched(value, "patch")
    ran = process(frames, tmp_path)
    patch = ran.motions[0].validity[10:50, 10:80]
    assert (patch == Validity.NO_DEPTH).all()
    assert ran.reliable == [True, True] and ran.share(Validity.VALID) > 0.8
    assert len(ran.done.map.world.elements) == 2


@pytest.mark.parametrize("kind", SEGMENTERS)
@pytest.mark.parametrize(
    ("frames", "reliable"), [((0,), [False, True]), ((1,), [False, False]), ((0, 1, 2), [False, False])]
)
def test_frames_without_any_depth_are_unreliable_and_say_why(tmp_path, frames, reliable, kind):
    ran = process(patched(np.nan, "all", frames), tmp_path, kind=kind)
    assert ran.reliable == reliable
    for pair, is_reliable in enumerate(reliable):
        assert is_reliable or not ran.motions[pair].valid_share
        assert is_reliable or set(np.unique(ran.motions[pair].validity)) <= {Validity.NO_DEPTH, Validity.OUT_OF_VIEW}
    evidence = ran.done.map.world.evidence.values()
    assert {int(k) for e in evidence for k in e.observations["index"]} == {k for k in (0, 1) if reliable[k]}
    if kind == "geometric":
        assert ran.done.summary.skipped["geometric: no surface in the depth image"] == sum(k < 2 for k in frames)


def test_depth_of_all_kinds_at_once(tmp_path):
    rng = np.random.default_rng(0)
    frames = []
    for k in range(3):
        depth = rng.choice(np.array([2, 2, 2, *UNSEEN, 1e8], np.float32), SIZE)
        frames.append(own_frame(k, depth=depth))
    assert 0 < process(frames, tmp_path).share(Validity.VALID) < 0.3


@pytest.mark.parametrize("where", ["patch", "grid", "all"])
def test_depth_too_far_to_be_weighed_is_told_and_spoils_no_other(tmp_path, where):
    ran = process(patched(1e6, where), tmp_path)
    far = ran.motions[0].validity == Validity.OUT_OF_RANGE
    assert far.any()
    if where == "patch":  # the grid leaves few of the matches
        assert ran.reliable == [True, True]
        assert not far[60:, 90:].any() and (ran.motions[0].d_m[60:110, 90:150] < 3).mean() > 0.9
    if where == "all":
        assert ran.reliable == [False, False]


def test_depth_beyond_what_16_bits_of_millimetres_hold_is_recorded_as_it_is(tmp_path):
    depth = room_depth()
    depth[0, :4] = 65.535, 65.6, 400.0, np.nan
    ran = process(own_frames(2, depth=depth), tmp_path)
    for path in ran.done.outputs[:2]:
        entries = open_recording(path).entries(["world/camera/image/depth"])
        (entry,) = (e for e in entries if hasattr(e.value, "stored"))  # beside how it is drawn
        np.testing.assert_array_equal(np.asarray(entry.value.stored)[0], depth[0])


# ---- scenes


def pair_of_plane(twist):
    """A textured wall 2 m ahead, from two cameras: colour and depth are exact but for interpolation."""
    T = se3.exp(np.asarray(twist, float))  # second camera in the first
    first = texture((180, 240))
    camera = np.array([[200.0, 0, 119.5], [0, 200, 89.5], [0, 0, 1]])
    v, u = np.mgrid[0:180, 0:240].astype(float)
    rays = np.stack([u, v, np.ones_like(u)], -1) @ np.linalg.inv(camera).T
    depth = (2.0 - T[2, 3]) / (rays @ T[:3, :3].T)[..., 2]
    seen = (rays * depth[..., None]) @ T[:3, :3].T + T[:3, 3]
    place = (seen / seen[..., 2:]) @ camera.T
    second = cv2.remap(first, place[..., :2].astype(np.float32), None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    wall = np.full((180, 240), 2.0, np.float32)
    frames = [own_frame(0, rgb=first, depth=wall, K=camera, T=None)]
    return [*frames, own_frame(1, rgb=second, depth=depth.astype(np.float32), K=camera, T=None)], se3.inverse(T)


@pytest.mark.parametrize(
    "twist",
    [(0, 0, 0, 0, 0, 0), (0.01, -0.02, 0.03, 0, 0, 0), (0, 0, 0, 0.04, -0.02, 0.05)],
    ids=["at rest", "pure rotation", "plane"],
)
def test_degenerate_geometry_has_its_camera_and_nothing_moves(tmp_path, twist):
    frames, T_second_first = pair_of_plane(twist)
    ran = process(frames, tmp_path, "ego.model=rigid")
    assert ran.reliable == [True]
    miss = se3.log(ran.egos[0].T_second_first @ se3.inverse(T_second_first))
    assert np.abs(miss).max() < 0.01
    assert ran.share(Validity.VALID) > 0.85 and ran.motions[0].flagged_share < 0.05


@pytest.mark.parametrize("shade", [0, 127, 255])
def test_without_texture_a_still_view_is_still(tmp_path, shade):
    ran = process(own_frames(rgb=np.full((*SIZE, 3), shade, np.uint8)), tmp_path)
    assert ran.share(Validity.VALID) == 1.0 and ran.motions[0].flagged_share == 0.0


def test_a_mover_that_fills_the_view_passes_for_the_world_or_is_unreliable(tmp_path):
    sliding = process(own_frames(depth=np.full(SIZE, 2.0, np.float32)), tmp_path / "a")
    assert sliding.reliable == [True, True]  # README, honest limits; but the correction of the poses tells
    assert sliding.egos[0].correction[3] == pytest.approx(2.0 / K[0, 0], abs=0.003)
    nearing = [own_frame(k, rgb=texture(), depth=np.full(SIZE, 2 - 0.3 * k, np.float32)) for k in range(3)]
    ran = process(nearing, tmp_path / "b")  # grows nearer, but no larger: nothing rigid
    assert ran.reliable == [False, False] and not ran.done.map.world.elements


@pytest.mark.parametrize("size", [(32, 32), (32, 1000), (33, 47)])
def test_the_smallest_images(tmp_path, size):
    assert len(process(own_frames(size=size), tmp_path).motions) == 2


def test_a_pair_in_4k(tmp_path):
    """About 6 s."""
    camera = np.array([[2000.0, 0, 1919.5], [0, 2000, 1079.5], [0, 0, 1]])
    ran = process(own_frames(2, size=(2160, 3840), K=camera), tmp_path, mcap=False)
    assert ran.reliable == [True] and ran.share(Validity.VALID) > 0.9


# ---- frames that cannot be used


def spoilt(**changes):
    """Three good frames, and one that is not between them."""
    frames = own_frames(4)
    return [own_frame(1, **changes) if k == 1 else f for k, f in enumerate(frames)]


def camera(fx, fy, cx, cy):
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])


NO_CAMERA = "K is of no pinhole camera"
TINY = "frame's image is smaller than 32 px"
UNUSABLE = {
    "1x1": ({"size": (1, 1)}, TINY),
    "2x2": ({"size": (2, 2)}, TINY),
    "3x1000": ({"size": (1000, 3)}, TINY),
    "31 rows": ({"size": (31, 160)}, TINY),
    "another size": ({"size": (60, 80)}, "image size differs from the first frame's"),
    "grey": ({"rgb": np.zeros(SIZE, np.uint8)}, "colour is not (H, W, 3) of uint8"),
    "16 bits": ({"rgb": np.zeros((*SIZE, 3), np.uint16)}, "colour is not (H, W, 3) of uint8"),
    "millimetres": ({"depth": np.full(SIZE, 2000, np.uint16)}, "depth is not (H, W) of floats, as colour is"),
    "depth of a smaller image": ({"depth": room_depth((60, 80))}, "depth is not (H, W) of floats, as colour is"),
    "no focal length": ({"K": np.zeros((3, 3))}, NO_CAMERA),
    "mirrored": ({"K": camera(-150, 150, 79.5, 59.5)}, NO_CAMERA),
    "NaN in K": ({"K": camera(150, np.nan, 79.5, 59.5)}, NO_CAMERA),
    "inf in K": ({"K": camera(150, 150, np.inf, 59.5)}, NO_CAMERA),
    "too small a focal length": ({"K": camera(1e-30, 150, 79.5, 59.5)}, NO_CAMERA),
    "too large a focal length": ({"K": camera(150, 1e300, 79.5, 59.5)}, NO_CAMERA),
    "centre too far": ({"K": camera(150, 150, 1e30, 59.5)}, NO_CAMERA),
    "K of another shape": ({"K": np.eye(4)}, NO_CAMERA),
    "skew": ({"K": K + np.eye(3, k=1)}, NO_CAMERA),
    "too late": ({"stamp_ns": 2**63 + 5}, "stamp is beyond what nanoseconds in 64 bits hold"),
    "too early": ({"stamp_ns": -(2**63)}, "stamp is beyond what nanoseconds in 64 bits hold"),
}


@pytest.mark.parametrize("name", UNUSABLE)
def test_a_frame_that_cannot_be_used_is_told_and_the_others_are(tmp_path, name):
    changes, reason = UNUSABLE[name]
    ran = process(spoilt(**changes), tmp_path, mcap=False)
    assert [(s.what, s.reason, s.index) for s in ran.skipped if s.what == "frame 1"] == [("frame 1", reason, 1)]
    assert ran.done.end.pairs == 2
    if name != "another size":  # than the first frame's
        with pytest.raises(InputError, match=r"own: no pair of frames could be processed") as e:
            vlmm_log.process(OwnLog(own_frames(3, **changes)))
        assert reason in str(e.value)


def test_a_small_folder_is_told_in_one_line(tmp_path):
    with pytest.raises(InputError, match=r"image is smaller than 32 px \(4x\)"):
        vlmm_log.process(write_tum_folder(tmp_path / "log", size=(3, 100)))


# ---- cameras


CAMERAS = {
    "fx 1e-9": camera(1e-9, 1e-9, 79.5, 59.5),
    "fx 1e9": camera(1e9, 1e9, 79.5, 59.5),
    "one of each": camera(1e-9, 1e9, 79.5, 59.5),
    "centre far outside": camera(150, 150, 1e6, -1e6),
    "and farther": camera(150, 150, -1e9, 1e9),
}


@pytest.mark.parametrize("kind", SEGMENTERS)
@pytest.mark.parametrize("name", CAMERAS)
def test_cameras_that_are_nearly_none(tmp_path, name, kind):
    process(own_frames(K=CAMERAS[name]), tmp_path, kind=kind)


def test_what_such_a_camera_leaves_to_weigh_is_not_called_still(tmp_path):
    """With fx = 1e9 px a pixel is 2 nm wide: covariances leave single precision, and d_M of 0 would be a lie."""
    ran = process(own_frames(K=CAMERAS["fx 1e9"]), tmp_path, "ego.pose_sigma_m=0", "ego.pose_sigma_rad=0")
    assert ran.reliable == [False, False]
    assert ran.share(Validity.OUT_OF_RANGE) > 0.9


@pytest.mark.parametrize(
    "row", ["fx 1e-30\nfy 60\ncx 31.5\ncy 23.5\n", "fx 60\nfy 60\ncx 1e30\ncy 23.5\n", "fx 60\nfy 1e12\ncx 1\ncy 1\n"]
)
def test_a_folder_s_camera_beyond_reckoning_is_refused(tmp_path, row):
    with pytest.raises(InputError, match="focal lengths must be positive and all values finite, 1e-09 to 1e"):
        vlmm_log.open_log(write_tum_folder(tmp_path / "log", camera=row))


# ---- poses


SHEARED = np.eye(3) + np.array([[0, 0.5, 0], [0, 0, 0.1], [0, 0, 0]])
NO_POSES = {
    "NaN": (np.full((4, 4), np.nan), "pose is not finite"),
    "inf": (at(x=np.inf), "pose is not finite"),
    "zeros": (np.zeros((4, 4)), "pose's last row is not 0 0 0 1"),
    "no rotation": (at(R=np.zeros((3, 3))), "pose's rotation is not orthonormal"),
    "scaled": (at(R=3 * np.eye(3)), "pose's rotation is not orthonormal"),
    "sheared": (at(R=SHEARED), "pose's rotation is not orthonormal"),
    "mirrored": (at(R=np.diag([1, 1, -1.0])), "pose's rotation is a reflection: its camera or world is left-handed"),
    "beyond": (at(x=1e30), "pose holds more than 1e+09 m"),
    "far beyond": (at(y=-1e300), "pose holds more than 1e+09 m"),
    "three rows": (np.eye(4)[:3], "pose is not four rows of four numbers"),
}


@pytest.mark.parametrize("name", NO_POSES)
def test_a_pose_that_is_none_is_told_and_its_frame_is_used_without(tmp_path, name):
    T, reason = NO_POSES[name]
    one = process(posed([np.eye(4), T, np.eye(4)]), tmp_path / "one")
    assert [(s.what, s.reason) for s in one.skipped if "pose" in s.what] == [("pose of frame 1", reason)]
    assert one.reliable == [True, True] and len(one.done.map.world.elements) == 2
    every = process(posed([T] * 3), tmp_path / "every")
    assert every.done.summary.skipped[reason] == 3 and every.done.end.pairs == 2
    assert every.done.summary.skipped["no pose yet: not in the map"] == 2


@pytest.mark.parametrize("step", [0.0, 10.0, 1e6])
def test_a_world_a_thousand_kilometres_off(tmp_path, step):
    ran = process(posed([at(1e6 + k * step, -1e6, 1e6) for k in range(3)]), tmp_path)
    assert ran.reliable == [True, True] and ran.share(Validity.VALID) > 0.9
    places = [e.position for e in ran.done.map.world.elements.values()]
    assert len(places) == 2 and np.abs(np.array(places) - [1e6, -1e6, 1e6]).max() < 2.2 + 3 * step


def test_poses_of_a_folder_that_are_none(tmp_path):
    stamps = [k * 50_000_000 + 1_305_031_236_900_000_000 for k in range(12)]
    listed = ["0 0 0 0 0 0 1"] * 12
    listed[3:7] = ["0 0 0 0 0 0 0", "1e30 0 0 0 0 0 1", "nan 0 0 0 0 0 1", "0 0 0 1e200 0 0 0"]
    folder = write_tum_folder(tmp_path / "log", groundtruth=rows(stamps, listed))
    ran = Ran(folder, tmp_path / "out", "read.pose_gap_s=1")
    told = ran.done.summary.skipped
    assert told["pose's quaternion is not of unit length"] == 1 and told["pose is not finite"] == 1
    assert told["pose holds more than 1e+09 m"] == 2


# ---- time


HOUR_NS = 3600 * 10**9


def test_hours_between_frames(tmp_path):
    frames = [own_frame(k, stamp_ns=10**18 + k * HOUR_NS) for k in range(3)]
    ran = process(frames, tmp_path)
    assert ran.reliable == [True, True] and ran.done.end.pairs == 2
    by_time = process(frames, tmp_path / "by_time", "keyframes.gap=3600s")
    assert by_time.done.end.pairs == 2
    with pytest.raises(InputError, match=r"no frame 1 s later \(3x\)"):
        vlmm_log.process(OwnLog(frames), settings=Settings.load(sets=["keyframes.gap=1s"]))


STAMPS = {
    "1938": -(10**18),
    "before 1970": -20_000_000,  # the run goes on after it
    "1970": 0,
    "2038": 2**31 * 10**9 - 20_000_000,
    "2040": 2_208_988_800 * 10**9,
    "the latest": LATEST_NS - 66_000_000,
    "the earliest": -LATEST_NS,
}


@pytest.mark.parametrize("name", STAMPS)
def test_stamps_far_from_today_come_through_to_the_nanosecond(tmp_path, name):
    stamps = [STAMPS[name] + k * 33_000_000 for k in range(3)]
    frames = [own_frame(k, stamp_ns=t) for k, t in enumerate(stamps)]
    ran = process(frames, tmp_path, mcap=False)
    assert stamps_in(open_recording(ran.done.outputs[0])) == stamps[:2]
    kept = vlmm_log.load_map(ran.done.outputs[1])
    assert kept.origin_ns == stamps[0]
    assert {int(t) for e in kept.world.evidence.values() for t in e.observations["first_ns"]} == set(stamps[:2])
    if name == "1970":
        assert process(frames, tmp_path / "mcap").done.end.pairs == 2
        return
    with pytest.raises(InputError, match="beyond what MCAP of ROS holds; write --rrd alone"):
        vlmm_log.process(OwnLog(frames), mcap=tmp_path / "b.mcap", settings=Settings.load(sets=["keyframes.gap=1"]))
    assert not (tmp_path / "b.mcap").exists()


@pytest.mark.parametrize("step", [0, -(10**8)])
def test_stamps_that_stand_still_or_run_backwards(tmp_path, step):
    frames = [own_frame(k, stamp_ns=10**18 + k * step) for k in range(3)]
    assert process(frames, tmp_path).reliable == [True, True]


def test_a_folder_of_before_1970(tmp_path):
    folder = write_tum_folder(tmp_path / "log", frames=3, offset_ns=0)
    for kind in ("rgb", "depth"):
        (folder / f"{kind}.txt").write_text("".join(f"{-5 + 0.1 * k:.9f} {kind}/{k}.png\n" for k in range(3)))
    ran = Ran(folder, tmp_path / "out", mcap=False)
    assert ran.done.map.origin_ns == -5_000_000_000 and ran.done.end.pairs == 2


# ---- the border


def test_good_frames_of_ones_own_pass_unchanged():
    depth = room_depth()
    depth[0, 0] = np.nan
    frames = own_frames(2, depth=depth)
    for a, b in zip(frames, Own(OwnLog(frames)).frames(0, 1), strict=True):
        assert isinstance(b, Frame) and (a.stamp_ns, a.index) == (b.stamp_ns, b.index)
        for x, y in ((a.rgb, b.rgb), (a.depth, b.depth), (a.K, b.K), (a.T_world_cam, b.T_world_cam)):
            np.testing.assert_array_equal(x, y)


@pytest.mark.parametrize("stamp", [2**70, -(2**70)])
def test_what_ones_own_log_left_out_keeps_its_reason(tmp_path, stamp):
    log = OwnLog([*own_frames(3), Skipped(stamp, "frame 3", "lens cap on", 3)])
    log.has_poses = True
    assert Ran(log, tmp_path / "out", mcap=False).done.summary.skipped["lens cap on"] == 1


NOISES = [
    ("noise.scale=1e12",),
    ("noise.scale=1e-6",),
    ("noise.sigma_z_a=0", "noise.sigma_z_b=0", "noise.sigma_px_first=0", "noise.sigma_px_second=0"),
    ("ego.model=off", "ego.pose_sigma_m=1e12"),
    ("ego.model=rigid", "ego.inlier=metric", "ego.inlier_m=1e-6"),
    ("log.dense=true",),
]


@pytest.mark.parametrize("sets", NOISES, ids=" ".join)
def test_settings_at_their_ends(tmp_path, sets):
    process(own_frames(), tmp_path, *sets)
    process(patched(1e6, "grid"), tmp_path / "far", *sets)
