"""Ego-refinement: it finds the camera's motion, whatever the poses say and whoever moves."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vlmm_log import se3
from vlmm_log.models.segmenters import no_segments
from vlmm_log.pipeline.ego import _Grid, _quartile, refine_ego, row_transforms, total_weight
from vlmm_log.pipeline.matches import match
from vlmm_log.pipeline.motion import measure_motion
from vlmm_log.settings import EgoSettings, Settings
from vlmm_log.types import FlowField, Frame, FramePair, Segments
from worlds import PLAIN, room_pair

TWIST = np.array([0.01, -0.02, 0.015, 0.04, -0.01, 0.03])


def refine(matches, seed=0, **settings):
    return refine_ego(matches, no_segments(matches.pair.first), EgoSettings(**settings), np.random.default_rng(seed))


def error(ego, T):
    """Rotation in degrees, translation in mm."""
    twist = se3.log(ego.T_second_first @ se3.inverse(T))
    return np.rad2deg(np.linalg.norm(twist[:3])), 1e3 * np.linalg.norm(twist[3:])


def with_poses(matches, T_second_first):
    a, b = matches.pair.first, matches.pair.second
    T_a = np.eye(4)
    first = Frame(a.stamp_ns, a.index, a.rgb, a.depth, a.K, T_a)
    second = Frame(b.stamp_ns, b.index, b.rgb, b.depth, b.K, T_a @ se3.inverse(T_second_first))
    s = Settings.load(sets=PLAIN)
    return match(FramePair(first, second), matches.flow, s.gate, s.noise)


@pytest.fixture(scope="module")
def noisy():
    return room_pair(TWIST, np.random.default_rng(7), elapsed_s=0.1)[0]


@pytest.mark.parametrize("model", ["rigid", "row_linear"])
@pytest.mark.parametrize("poses", ["true", "none", "wrong"])
def test_finds_the_camera_whatever_the_poses_say(noisy, model, poses):
    truth = noisy.pair.relative_pose()
    wrong = se3.exp(np.array([0.02, -0.01, 0.012, 0.02, 0.02, -0.01]))  # 1.5 degrees, 3 cm
    prior = {"true": truth, "none": np.eye(4), "wrong": wrong @ truth}[poses]
    ego = refine(with_poses(noisy, prior), model=model)
    degrees, mm = error(ego, truth)
    assert degrees < 0.02
    assert mm < 1.5
    assert ego.reliable
    assert ego.spread == pytest.approx(1, abs=0.15)


def test_perturbed_or_no_poses_change_d_m_by_less_than_a_tenth(noisy):
    truth = noisy.pair.relative_pose()
    perturbed = se3.exp(np.array([0.02, -0.01, 0.012, 0.02, 0.02, -0.01])) @ truth
    d_m = [measure_motion(m, refine(m)).d_m for m in (with_poses(noisy, T) for T in (truth, perturbed, np.eye(4)))]
    for other in d_m[1:]:
        assert np.nanmedian(np.abs(other - d_m[0]) / d_m[0]) < 0.1


def test_metric_rigid_fit_is_kabsch_on_its_inliers(noisy):
    ego = refine(noisy, model="rigid", inlier="metric", iterations=100)
    grid = _Grid.gather(noisy, 4)
    a, b = grid.first.T.astype(float), grid.second.T.astype(float)
    T = ego.T_second_first
    inlier = np.linalg.norm(b - a @ T[:3, :3].T - T[:3, 3], axis=1) < 0.02
    np.testing.assert_allclose(se3.kabsch(a[inlier], b[inlier]), T, atol=5e-5)
    assert ego.inlier_share == pytest.approx(inlier.mean(), abs=1e-3)


def test_a_rolling_shutter_is_absorbed_by_the_row_twist():
    twist = np.array([0.02, -0.01, 0.015, 0.01, 0.0, 0.01])
    matches, _ = room_pair(TWIST, np.random.default_rng(4))
    first = matches.pair.first
    # Sway the first camera's points row by row: what a read-out during rotation does
    H, W = first.depth.shape
    T = matches.pair.relative_pose()
    v, u = np.mgrid[0:H, 0:W].astype(float)
    X = first.depth[..., None] * (np.stack([u, v, np.ones_like(u)], -1) @ np.linalg.inv(first.K).T)
    plain = X @ T[:3, :3].T + T[:3, 3]
    rows = se3.exp((np.arange(H) / H - 0.5)[:, None] * twist)
    swayed = np.einsum("vij,vuj->vui", rows[:, :3, :3], plain) + rows[:, None, :3, 3]

    def project(points):
        seen = points @ first.K.T
        return seen[..., :2] / seen[..., 2:]

    forward = (matches.flow.forward + project(swayed) - project(plain)).astype(np.float32)
    flow = FlowField(forward, -forward, np.zeros((H, W), np.float32))
    s = Settings.load(sets=PLAIN)
    rolling = match(matches.pair, flow, s.gate, s.noise)
    rigid, row_linear = refine(rolling, model="rigid"), refine(rolling, model="row_linear")
    assert np.abs(row_linear.row_twist - twist)[:3].max() < 0.004
    assert row_linear.inlier_share > rigid.inlier_share + 0.05
    still = refine(matches, model="row_linear")
    assert np.linalg.norm(still.row_twist[:3]) < 2e-3  # a global shutter shows none


def test_a_large_mover_does_not_take_the_fit():
    matches, labels = room_pair(TWIST, np.random.default_rng(9), elapsed_s=0.2)
    kept = np.arange(labels.shape[1]) % 10 < 4  # of the room, four columns in ten: the movers' share grows
    depth = np.where((labels == 0) & ~kept, np.nan, matches.pair.first.depth).astype(np.float32)
    a, b = matches.pair.first, matches.pair.second
    s = Settings.load(sets=PLAIN)
    first = Frame(a.stamp_ns, a.index, a.rgb, depth, a.K, a.T_world_cam)
    fewer = match(FramePair(first, b), matches.flow, s.gate, s.noise)
    degrees, mm = error(refine(fewer), matches.pair.relative_pose())
    assert degrees < 0.05
    assert mm < 4


def test_too_few_matches_are_told_and_the_log_is_trusted(noisy):
    first = noisy.pair.first
    depth = np.full_like(first.depth, np.nan)
    depth[100:120, 100:120] = first.depth[100:120, 100:120]
    few = Frame(first.stamp_ns, first.index, first.rgb, depth, first.K, first.T_world_cam)
    s = Settings.load(sets=PLAIN)
    matches = match(FramePair(few, noisy.pair.second), noisy.flow, s.gate, s.noise)
    ego = refine(matches)
    assert not ego.reliable
    np.testing.assert_allclose(ego.T_second_first, noisy.pair.relative_pose())


def test_off_trusts_the_poses_and_widens_sigma(noisy):
    s = Settings.load(sets=(*PLAIN, "ego.model=off"))
    off = match(noisy.pair, noisy.flow, s.gate, s.noise)
    ego = refine_ego(off, no_segments(off.pair.first), s.ego, np.random.default_rng(0))
    np.testing.assert_allclose(ego.T_second_first, noisy.pair.relative_pose())
    assert ego.reliable
    narrow = measure_motion(off, replace(ego, covariance=np.zeros((6, 6))))
    wide = measure_motion(off, ego)
    assert wide.static_d_m2_median < 0.5 * narrow.static_d_m2_median


def test_covariance_of_the_fit_matches_its_scatter():
    twists = []
    for seed in range(12):
        matches, _ = room_pair(TWIST, np.random.default_rng(100 + seed))
        ego = refine(matches, model="rigid")
        twists.append(se3.log(ego.T_second_first @ se3.inverse(matches.pair.relative_pose())))
    scatter = np.std(twists, axis=0)
    predicted = np.sqrt(np.diag(ego.covariance))
    assert (scatter / predicted < 3).all()
    assert (scatter / predicted > 1 / 3).all()


def test_same_seed_same_bytes(noisy):
    a, b = refine(noisy, seed=5), refine(noisy, seed=5)
    assert a.T_second_first.tobytes() == b.T_second_first.tobytes()
    assert a.row_twist.tobytes() == b.row_twist.tobytes()


@pytest.mark.parametrize("model", ["rigid", "row_linear"])
def test_a_large_mover_does_not_pass_for_the_world_once_it_is_an_instance(model):
    """A wall moves sideways before a still camera; a mask that covers most of it moves by itself."""
    H, W, z = 96, 128, 2.0
    K = np.array([[110.0, 0, 63.5], [0, 110.0, 47.5], [0, 0, 1]])
    rng = np.random.default_rng(0)
    depth = np.full((H, W), z, np.float32) + rng.normal(0, 0.002, (H, W)).astype(np.float32)
    rgb = rng.integers(0, 256, (H, W, 3), np.uint8)
    labels = np.zeros((H, W), np.int32)
    labels[:, :80] = 1
    forward = np.zeros((H, W, 2), np.float32)
    forward[:, :80, 0] = 6.0
    flow = FlowField(forward, -forward, np.zeros((H, W), np.float32))
    s = Settings.load(sets=[f"ego.model={model}", "noise.flow_spread=0"])
    matches = match(FramePair(Frame(0, 0, rgb, depth, K), Frame(1, 1, rgb, depth.copy(), K)), flow, s.gate, s.noise)
    segments = Segments(labels, ("person",), np.ones(1, np.float32), np.full(1, -1))

    def sideways(share):
        settings = replace(s.ego, instance_share=share)
        return refine_ego(matches, segments, settings, np.random.default_rng(0)).T_second_first[0, 3]

    assert sideways(1.0) == pytest.approx(6.0 * z / 110.0, abs=0.01)  # the majority
    assert sideways(0.08) == pytest.approx(0.0, abs=0.005)


@given(st.lists(st.integers(0, 5000), max_size=30), st.integers(0, 5000), st.floats(0.01, 1))
def test_no_instance_has_more_than_its_share_of_the_weight(counts, others, most):
    counts = np.array(counts, np.int64)
    total = total_weight(counts, others, most)
    capped = np.minimum(counts, most * total)
    if capped.sum() + others > 0 and (capped < counts).any():
        assert capped.sum() + others == pytest.approx(total)
        assert capped.max() <= most * total * (1 + 1e-9)
    elif counts.size and counts.max() > most * (counts.sum() + others) * (1 + 1e-9):
        assert len(counts) * most < 1 + 1e-9 or others == 0  # too few to share the weight: left as they are


def test_pieces_of_the_whole_view_are_left_alone():
    """A still wall of three quarters and three pieces of one mover: capped, the pieces would outvote the wall."""
    matches, labels = room_pair(TWIST, np.random.default_rng(0))
    pieces = (np.indices(labels.shape)[1] * 4 // labels.shape[1] + 1).astype(np.int32)
    parts = Segments(pieces, ("",) * 4, np.ones(4, np.float32), np.full(4, -1), partition=True)
    grid = _Grid.gather(matches, 4)
    assert (grid.balanced(parts, 0.08) == 1).all()
    things = replace(parts, partition=False)
    assert (grid.balanced(things, 0.08) == 1).all()  # four masks cannot have 8 % each
    assert grid.balanced(things, 0.3).min() < 1 or np.bincount(pieces.ravel()).max() <= 0.3 * pieces.size


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-6, 1e-3, 1.0, 3.0])
def test_transforms_of_rows_are_exponentials(size):
    rng = np.random.default_rng(4)
    T, twist, rows = se3.exp(rng.normal(size=6)), size * rng.normal(size=6), np.arange(0, 480, 7)
    book = se3.exp((rows / 480 - 0.5)[:, None] * twist) @ T
    np.testing.assert_allclose(row_transforms(T, twist, rows, 480), book, rtol=0, atol=1e-12)


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 6, 7, 1000, 1001, 1002, 1003])
def test_the_quartile_is_numpys(count):
    values = np.random.default_rng(count).random(count).astype(np.float32)
    assert _quartile(values) == pytest.approx(np.quantile(values, 0.25), rel=1e-6)
