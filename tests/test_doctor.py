"""doctor: what each check measures on known truth, then whole examinations of logs with one fault."""

import json
import os
import shutil
from collections import Counter
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import render_room
from faults import FAULTS, linked
from vlmm_log import se3
from vlmm_log.checks.camera import plausible, scaled
from vlmm_log.checks.depth_scale import KINECT_STEP, kinect_units, units_by_steps
from vlmm_log.checks.edges import FLIPS, HALF, align
from vlmm_log.checks.lists import _unusable, nearest_s
from vlmm_log.checks.motion_pairs import carried
from vlmm_log.checks.probe import PLACES, Probe, places
from vlmm_log.checks.registration import peak
from vlmm_log.checks.report import Diagnosis, Evidence, Finding, sets_of
from vlmm_log.checks.rigid import error_px, fit
from vlmm_log.checks.timeline import Timeline
from vlmm_log.diagnosis import doctor
from vlmm_log.readers.intrinsics import PRESETS
from vlmm_log.readers.stamps import SET_BACK, SORTED_IN, TOO_LATE
from vlmm_log.settings import Settings
from vlmm_log.types import Frame, InputError

DATA = Path(os.environ.get("VLMM_LOG_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
SLICE = DATA / "rgbd_dataset_freiburg1_rpy_225_345"
FAULT = {fault.name: fault for fault in FAULTS}
K = PRESETS["kinect"].K
seeds = st.integers(0, 2**32 - 1)


# ---- motion


def matches(rng, T, noise_px=0.0, movers=0.0):
    """A probe of random points seen before and after a motion; a share of them moves by itself."""
    n = 400
    x_a = rng.uniform([20, 20], [620, 460], (n, 2))
    z_a = rng.uniform(0.8, 4.0, n)
    rays = np.column_stack([(x_a - K[:2, 2]) / np.diag(K)[:2], np.ones(n)])
    at = (rays * z_a[:, None]) @ T[:3, :3].T + T[:3, 3]
    at[: int(movers * n)] += [0.3, 0.1, 0.0]
    x_b = at[:, :2] / at[:, 2:] * np.diag(K)[:2] + K[:2, 2] + rng.normal(0, noise_px, (n, 2))
    return Probe(0, 0, 10**8, (480, 640), x_a, x_b, z_a, at[:, 2] * (1 + rng.normal(0, 0.002 * noise_px, n)))


@given(seeds)
@settings(max_examples=20)
def test_the_motion_of_a_pair_is_found_beside_movers(seed):
    rng = np.random.default_rng(seed)
    T = se3.exp(rng.normal(0, 0.05, 6))
    probe = matches(rng, T, noise_px=0.3, movers=0.25)
    found = fit(probe, K, np.eye(4))
    assert np.abs(se3.log(found @ se3.inverse(T))).max() < 0.003
    assert error_px(probe, found, K) < 1.0
    assert error_px(probe, np.eye(4), K) > 3 * error_px(probe, found, K)


@given(seeds)
def test_a_mounting_is_told_by_motions_about_several_axes(seed):
    rng = np.random.default_rng(seed)
    X = se3.exp(np.concatenate([rng.normal(0, 0.6, 3), rng.normal(0, 0.1, 3)]))
    cameras = [se3.exp(twist) for twist in rng.normal(0, 0.3, (12, 6))]
    mountings = carried([(A, X @ A @ se3.inverse(X)) for A in cameras])
    assert mountings is not None
    turned, displaced = mountings
    assert np.allclose(turned[:3, :3], X[:3, :3], atol=1e-6)
    assert np.abs(displaced[:3, 3] - X[:3, 3]).max() < 0.02  # the prior pulls a little


def test_a_mounting_is_not_told_by_turns_about_one_axis():
    cameras = [se3.exp(np.array([angle, 0, 0, 0, 0, 0])) for angle in (0.1, 0.2, -0.3, 0.4, 0.15, -0.2)]
    assert carried([(A, A) for A in cameras]) is None


@given(st.floats(-3.4, 3.4), st.floats(0.1, 3))
def test_the_top_of_a_parabola_lies_between_its_samples(top, bend):
    places_ = [float(x) for x in range(-5, 6)]
    assert peak(places_, -bend * (np.array(places_) - top) ** 2) == pytest.approx(top, abs=1e-6)
    assert peak(places_, np.array(places_)) == 5  # at the end it is the end


# ---- depth


@given(st.sampled_from([1000.0, 5000.0, 10000.0]), seeds)
@settings(max_examples=20)
def test_the_steps_of_structured_light_tell_its_units(units, seed):
    depth = np.random.default_rng(seed).uniform(0.8, 5.0, 200_000)
    disparity = np.rint(1 / (KINECT_STEP * depth))
    stored = np.rint(units / (KINECT_STEP * disparity)).astype(np.int64)
    found = kinect_units(np.bincount(stored[stored < 65536], minlength=65536))
    assert found is not None
    assert found == pytest.approx(units, rel=0.15)


@pytest.mark.parametrize(
    ("steps_per_m", "nearest", "size", "told"),
    [
        (1 / KINECT_STEP, 0.8, (480, 640), 1000),
        (32 * 1004 * 0.055, 0.6, (720, 1280), None),  # D415: focal length px, baseline m, steps of 1/32 px
        (32 * 1004 * 0.055, 0.6, (480, 640), None),  # aligned to a smaller colour image
        (32 * 1004 * 0.055, 2.5, (720, 1280), None),
        (32 * 640 * 0.095, 0.6, (720, 1280), None),  # D455
    ],
)
def test_stereo_is_no_kinect_at_five_times_the_units(steps_per_m, nearest, size, told):
    depth = np.random.default_rng(0).uniform(nearest, 6.0, 200_000)
    stored = np.rint(1000 * steps_per_m / np.rint(steps_per_m / depth)).astype(np.int64)
    samples = SimpleNamespace(stored=np.bincount(stored, minlength=65536), probes=[SimpleNamespace(size=size)])
    found, known = units_by_steps(SimpleNamespace(samples=samples, log=SimpleNamespace(units_per_meter=1000.0)))
    assert known == told
    assert told is not None or np.isnan(found)


@pytest.mark.parametrize("step", [1, 5, 20])
def test_even_steps_are_no_ruler(step):
    stored = np.random.default_rng(0).integers(800, 20_000, 200_000) // step * step
    assert kinect_units(np.bincount(stored, minlength=65536)) is None


def blobs():
    """An image of discs and the depth that belongs to it."""
    rng = np.random.default_rng(3)
    depth, grey = np.full((240, 320), 3.0, np.float32), np.full((240, 320), 60, np.uint8)
    for x, y, r in rng.uniform([40, 40, 8], [280, 200, 22], (14, 3)).astype(int).tolist():
        cv2.circle(depth, (x, y), r, float(rng.uniform(1, 2)), -1)
        cv2.circle(grey, (x, y), r, int(rng.integers(110, 250)), -1)
    return Frame(0, 0, np.repeat(grey[..., None], 3, axis=2), depth, K, None)


@pytest.mark.parametrize(("dx", "dy"), [(0, 0), (8, 0), (-6, 10), (0, -12)])
def test_edges_tell_how_far_depth_is_off_colour(dx, dy):
    frame = blobs()
    off = np.roll(frame.depth, (dy, dx), axis=(0, 1))
    found = align(replace(frame, depth=off), {0: (0.0, off)})
    row, column = np.unravel_index(int(np.argmax(found.shifts[0])), found.shifts[0].shape)
    assert (2 * (column - HALF), 2 * (row - HALF)) == (-dx, -dy)  # depth is to be moved back
    assert found.shifts[0].max() > 2 * max(found.flipped.values())


@pytest.mark.parametrize("name", FLIPS)
def test_edges_tell_how_depth_is_mirrored(name):
    frame = blobs()
    off = np.ascontiguousarray(cv2.flip(frame.depth, FLIPS[name]))
    found = align(replace(frame, depth=off), {0: (0.0, off)})
    assert max(found.flipped, key=lambda n: found.flipped[n]) == name
    assert found.flipped[name] > 2 * found.shifts[0].max()


def test_depth_without_an_edge_says_nothing():
    frame = replace(blobs(), depth=np.full((240, 320), 2.0, np.float32))
    assert np.isnan(align(frame, {0: (0.0, frame.depth)}).shifts).all()


# ---- lists and cameras


@given(st.integers(2, 100_000))
def test_places_are_few_and_spread_over_any_log(count):
    stamps = np.arange(count, dtype=np.int64) * 33_000_000
    at = places(Timeline(stamps, stamps, np.stack([np.arange(count)] * 2, axis=1), 0, Counter()))
    assert 1 <= len(at) <= PLACES
    assert at[0] == 0 and at[-1] < count - 1
    assert np.diff(at).max(initial=0) <= count / 4 + 1


def test_nearest_stamps():
    rgb, depth = np.array([0, 100, 205]) * 10**6, np.array([10, 95, 300]) * 10**6
    assert nearest_s(rgb, depth) == pytest.approx([0.01, -0.005, 0.095])


@pytest.mark.parametrize("name", PRESETS)
def test_known_cameras_are_plausible_and_those_of_another_resolution_are_not(name):
    camera = PRESETS[name]
    assert plausible(camera, 640, 480)
    for k in (0.5, 2.0):
        assert not plausible(scaled(camera, k), 640, 480)
        assert np.allclose(scaled(scaled(camera, k), 1 / k).K, camera.K)


# ---- reports


def test_a_remedy_is_what_the_command_line_takes():
    assert sets_of("--set read.poses=world_to_camera --intrinsics bonn") == (
        "read.poses=world_to_camera",
        "read.intrinsics=bonn",
    )
    assert sets_of("mirror the depth images") == ()


def test_a_report_is_json_without_what_is_not_known():
    finding = Finding("depth scale", "read as 5000", "--set read.depth_units_per_meter=1000", {"median_m": 0.3})
    report = Diagnosis("log", (finding,), (Evidence("poses", "none", {"offset_s": float("nan")}),)).report()
    assert json.loads(json.dumps(report, allow_nan=False)) == report
    assert report["remedies"] == finding.remedy
    assert report["evidence"] == [{"check": "poses", "message": "none", "figures": {}}]


# ---- whole logs


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    """Less than half a second of the rendered room, with poses."""
    folder = tmp_path_factory.mktemp("doctor") / "room"
    render_room.write_tum(folder, 11)
    return folder


@pytest.fixture
def broken(room, tmp_path):
    """``broken(fault)`` makes it in a copy of the room."""

    def make(fault):
        folder = linked(room, tmp_path / "log")
        fault.make(folder)
        return folder

    return make


def test_a_log_in_order_gives_evidence_and_no_finding(room):
    told = []
    diagnosis = doctor(room, progress=lambda done, expected: told.append((done, expected)))
    assert diagnosis.findings == ()
    checks = {e.check for e in diagnosis.evidence}
    assert {"depth scale", "pose convention", "pose clock", "registration", "camera"} <= checks
    assert told and told[-1][0] == told[-1][1]


def test_positions_in_millimetres_are_found(broken):
    (finding,) = doctor(broken(FAULT["positions in mm"])).findings
    assert FAULT["positions in mm"].mended_by(finding.remedy), finding


def test_inverted_poses_are_found_and_under_the_remedy_the_log_is_in_order(broken):
    folder = broken(FAULT["poses inverted"])
    diagnosis = doctor(folder)
    assert diagnosis.remedies == "--set read.poses=world_to_camera"
    assert doctor(folder, settings=Settings.load(sets=sets_of(diagnosis.remedies))).findings == ()


OF_LISTS = ["poses of another clock", "every third depth image missing"]


@pytest.mark.parametrize("name", OF_LISTS)
def test_what_only_the_user_can_mend_is_told_in_a_sentence(broken, name):
    findings = doctor(broken(FAULT[name])).findings
    assert any(f.check in FAULT[name].check and FAULT[name].mended_by(f.remedy) for f in findings), findings


def test_depth_that_meets_no_colour_image_is_brought_to_it(tum_folder):
    folder = tum_folder(frames=8, step_ns=500_000_000, offset_ns=120_000_000, shift_px=3)
    found = [f for f in doctor(folder).findings if f.check == "synchronisation"]
    assert [f.remedy for f in found] == ["--set read.depth_offset_s=0.120"]


def test_images_too_far_apart_cannot_be_examined(tum_folder):
    with pytest.raises(InputError, match="no colour image within"):
        doctor(tum_folder(frames=3, offset_ns=10**10))


def test_images_of_another_size_than_their_camera_are_told(tum_folder):
    camera = "fx 60\nfy 60\ncx 31.5\ncy 23.5\nwidth 320\nheight 240\n"
    findings = {f.check: f.message for f in doctor(tum_folder(camera=camera)).findings}
    assert "64x48" in findings["frames"] and "320x240" in findings["frames"]


def test_images_in_another_order_than_their_stamps_are_told_as_what_they_are():
    left_out = {SORTED_IN: 3, SET_BACK: 1, f"{TOO_LATE}: by over 2 s": 2, "image is cut off": 1}
    stamps = np.arange(10)
    timeline = SimpleNamespace(left_out={}, rgb_ns=stamps, depth_ns=stamps)
    samples = SimpleNamespace(left_out=left_out, seen=range(8))
    told = list(_unusable(SimpleNamespace(timeline=timeline, samples=samples, log=SimpleNamespace(poses=None))))
    found = {t.message.split(": ", 1)[1]: getattr(t, "remedy", None) for t in told}
    assert found == {
        SORTED_IN: None,
        SET_BACK: None,
        f"{TOO_LATE}: by over 2 s": "write the bag again with its images in the order of their stamps",
        "image is cut off": "mend or replace these images, or give the camera that they are from with --intrinsics",
    }


def test_the_real_slice_is_in_order_and_late_poses_are_told(tmp_path):
    if not SLICE.exists():
        pytest.skip(f"{SLICE} is not here; VLMM_LOG_DATA can name the folder that holds it")
    window = Settings.load(sets=["read.start_s=0.5", "read.stop_s=1.5"])
    assert doctor(SLICE, settings=window).findings == ()
    shutil.copytree(SLICE, tmp_path / SLICE.name)
    FAULT["poses 100 ms late"].make(tmp_path / SLICE.name)
    (finding,) = doctor(tmp_path / SLICE.name, settings=window).findings
    assert FAULT["poses 100 ms late"].mended_by(finding.remedy), finding
