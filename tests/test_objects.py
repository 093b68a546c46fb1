"""Aggregation: the kernels against the naive form, and what must hold of any mask."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import textbook
from vlmm_log import se3
from vlmm_log.models.segmenters import no_segments
from vlmm_log.pipeline import object_kernels as ok
from vlmm_log.pipeline.ego import refine_ego
from vlmm_log.pipeline.motion import measure_motion
from vlmm_log.pipeline.objects import aggregate
from vlmm_log.pipeline.odometry import locate
from vlmm_log.settings import EgoSettings, ObjectSettings
from vlmm_log.types import Ego, Frame, FramePair, Motion, Segments
from worlds import random_matches, room_pair


def segments_of(labels, names=None):
    n = int(labels.max(initial=0)) if names is None else len(names)
    return Segments(labels.astype(np.int32), tuple(names or [""] * n), np.ones(n, np.float32), np.full(n, -1, np.int64))


def blobs(rng, shape, n):
    """Labels of random rectangles, some hidden wholly by later ones, and one that has no pixel."""
    labels = np.zeros(shape, np.int32)
    for k in range(n - 1):
        v, u = rng.integers(0, shape[0]), rng.integers(0, shape[1])
        labels[v : v + rng.integers(1, 60), u : u + rng.integers(1, 60)] = k + 1
    return segments_of(labels, [""] * n)


def fake_ego(rng, reliable=True):
    T = se3.exp(rng.normal(0, 0.02, 6))
    return Ego(T, np.zeros(6), np.eye(6) * 1e-8, np.zeros(6), 0.9, 1.0, 1000, reliable)


def aggregated(matches, segments, ego, s):
    motion = measure_motion(matches, ego)
    odometry = locate(matches.pair, ego, None)
    return motion, aggregate(matches.pair, segments, motion, ego, odometry, s)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("coherence", ["flagged", "all"])
@pytest.mark.parametrize("poses", [True, False])
def test_kernels_equal_the_naive_form(seed, coherence, poses):
    rng = np.random.default_rng(seed)
    matches = random_matches(rng, poses=poses)
    segments = blobs(rng, matches.pair.first.depth.shape, 12)
    s = ObjectSettings(coherence=coherence, quantile=(0.75, 0.0, 1.0, 0.33)[seed])
    ego = fake_ego(rng)
    motion, seen = aggregated(matches, segments, ego, s)
    odometry = locate(matches.pair, ego, None)
    R, t = odometry.T_world_first[:3, :3], odometry.T_world_first[:3, 3]
    axes = np.eye(3) if poses else odometry.T_world_second[:3, :3]
    naive = textbook.aggregate(matches.pair, segments, motion, s)
    for k, (row, box, truth) in enumerate(zip(seen.rows, seen.boxes, naive, strict=True)):
        for name in ("pixels", "scored"):
            assert row[name] == truth[name]
        v, u = np.nonzero(segments.labels == k + 1)
        if v.size:
            assert box.tolist() == [u.min(), v.min(), u.max(), v.max()]
        else:
            assert box[2] < box[0]
        for name in ("o", "phi", "gamma", "gamma_all", "kappa", "part"):
            assert row[name] == pytest.approx(truth[name], rel=1e-4, abs=1e-6, nan_ok=True), name
        assert row["drift"] == pytest.approx(axes @ truth["drift"], rel=1e-4, abs=1e-6)
        if "mean" in truth:
            near = 1e-4 if truth["pixels"] < 2 * ok.SAMPLE else 5e-3  # m; large masks are sampled
            assert row["position"] == pytest.approx(R @ truth["mean"] + t, abs=near)
            C = R @ truth["cov"] @ R.T
            assert row["extent"] == pytest.approx(C[np.triu_indices(3)], abs=near)
        else:
            assert np.isnan(row["position"]).all()


@given(st.lists(st.lists(st.floats(0, 50, width=32), max_size=40), max_size=6), st.floats(0, 1))
def test_quantiles_are_numpys(runs, share):
    values = np.array([x for run in runs for x in run], np.float32)
    ends = np.cumsum([len(run) for run in runs], dtype=np.int64)
    starts = ends - np.array([len(run) for run in runs], np.int64)
    out = np.empty(len(runs), np.float32)
    ok.quantiles(values, starts, ends, np.float32(share), out)
    for run, q in zip(runs, out, strict=True):
        expected = np.quantile(np.array(run, np.float64), np.float64(np.float32(share))) if run else np.nan
        assert q == pytest.approx(expected, rel=1e-5, abs=1e-6, nan_ok=True)


@pytest.mark.parametrize("run", [[0, 1e-44], [1e-38, 0, 2e-38], [0, 3e38], [1, np.inf, 2], [5, 5, 5], [np.inf]])
def test_quantiles_of_extreme_values(run):
    out = np.empty(1, np.float32)
    ok.quantiles(np.array(run, np.float32), np.array([0]), np.array([len(run)]), np.float32(0.5), out)
    assert out[0] == pytest.approx(np.median(np.array(run, np.float64)), rel=1e-5)


def test_a_moving_box_is_coherent_and_the_still_rest_is_not():
    matches, labels = room_pair([0.02, -0.01, 0.01, 0.03, 0.0, 0.02], np.random.default_rng(1), elapsed_s=0.15)
    names = sorted(set(np.unique(labels)) - {0})
    compact = np.searchsorted(names, labels) + 1
    compact[labels == 0] = 0
    ego = refine_ego(matches, no_segments(matches.pair.first), EgoSettings(), np.random.default_rng(0))
    _, seen = aggregated(matches, segments_of(compact), ego, ObjectSettings())
    moving = seen.rows["o"] > 6
    assert moving.any() and not moving.all()
    assert (seen.rows["kappa"][moving] > 0.9).all()
    assert (seen.rows["part"][moving] > 0.4).all()  # tiles along borders do not count
    assert (seen.rows["kappa"][~moving] < 0.15).all()
    assert (seen.rows["part"][~moving] < 0.02).all()


def test_a_zero_residual_has_no_direction():
    matches = random_matches(np.random.default_rng(0))
    motion = measure_motion(matches, fake_ego(np.random.default_rng(0)))
    zero = type(motion)(
        np.zeros_like(motion.residual), np.full_like(motion.d_m, 9.0), motion.p_stat, motion.validity, 2.8, None
    )
    segments = segments_of(np.ones(motion.d_m.shape, np.int32))
    ego = fake_ego(np.random.default_rng(0))
    seen = aggregate(matches.pair, segments, zero, ego, locate(matches.pair, ego, None), ObjectSettings())
    assert (seen.rows["phi"][0], seen.rows["gamma"][0], seen.rows["kappa"][0]) == (1.0, 0.0, 0.0)


def test_too_few_scored_pixels_or_an_unreliable_pair_is_no_observation():
    rng = np.random.default_rng(3)
    matches = random_matches(rng)
    segments = blobs(rng, matches.pair.first.depth.shape, 12)
    _, seen = aggregated(matches, segments, fake_ego(rng), ObjectSettings(min_scored=200))
    assert (seen.observed == (seen.rows["scored"] >= 200)).all()
    assert seen.observed.any() and not seen.observed.all()
    _, unreliable = aggregated(matches, segments, fake_ego(rng, reliable=False), ObjectSettings(min_scored=200))
    assert not unreliable.observed.any()


def test_no_instance_gives_no_row():
    matches = random_matches(np.random.default_rng(0))
    nothing = segments_of(np.zeros(matches.pair.first.depth.shape, np.int32))
    _, seen = aggregated(matches, nothing, fake_ego(np.random.default_rng(0)), ObjectSettings())
    assert seen.rows.size == 0


def test_a_strip_of_background_does_not_move_an_instances_position():
    matches = random_matches(np.random.default_rng(0), poses=False)
    pair = matches.pair
    depth = np.full(pair.first.depth.shape, 4.0, np.float32)
    depth[20:60, 20:60] = 1.0
    first = type(pair.first)(0, 0, pair.first.rgb, depth, pair.first.K)
    pair = type(pair)(first, pair.second)
    labels = np.zeros(depth.shape, np.int32)
    labels[20:60, 18:62] = 1  # two columns too wide on either side
    motion = measure_motion(matches, fake_ego(np.random.default_rng(0)))
    ego = fake_ego(np.random.default_rng(0))
    seen = aggregate(pair, segments_of(labels), motion, ego, locate(pair, ego, None), ObjectSettings())
    assert seen.rows["position"][0, 2] == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("width", [255, 256, 300, 313, 344, 375, 512])
@pytest.mark.parametrize("height", [200, 342, 375])
def test_the_place_of_a_large_mask_does_not_depend_on_its_width(width, height):
    """Depths are sampled: a mask whose width is a multiple of the sampling step must not see a few columns only."""
    H, W = 480, 640
    depth = np.full((H, W), 2.0, np.float32)
    labels = np.zeros((H, W), np.int32)
    labels[50 : 50 + height, 60 : 60 + width] = 1
    K = np.array([[525.0, 0, 319.5], [0, 525.0, 239.5], [0, 0, 1]])
    image = np.zeros((H, W, 3), np.uint8)
    pair = FramePair(Frame(0, 0, image, depth, K), Frame(10**8, 1, image, depth, K))
    ego = fake_ego(np.random.default_rng(0))
    unscored = np.full((H, W), np.nan, np.float32)
    motion = Motion(np.stack([unscored] * 3), unscored, unscored, np.ones((H, W), np.uint8), 2.8, None)
    seen = aggregate(pair, segments_of(labels), motion, ego, locate(pair, ego, None), ObjectSettings())
    truth = textbook.aggregate(pair, segments_of(labels), motion, ObjectSettings())[0]
    assert seen.rows["position"][0] == pytest.approx(truth["mean"], abs=0.01)
    spread = truth["cov"][np.triu_indices(3)]
    assert seen.rows["extent"][0] == pytest.approx(spread, abs=0.03 * spread.max())
