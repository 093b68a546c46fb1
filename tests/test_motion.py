"""The motion channel: against its textbook form, and against what statistics demands of it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

import textbook
from vlmm_log import se3
from vlmm_log.models.segmenters import no_segments
from vlmm_log.pipeline import flow_kernels, kernels
from vlmm_log.pipeline.ego import refine_ego
from vlmm_log.pipeline.motion import measure_motion
from vlmm_log.settings import EgoSettings
from vlmm_log.types import Ego, Validity
from worlds import PLAIN, random_matches, room_pair

MOTIONS = {
    "still": np.zeros(6),
    "sideways": np.array([0, 0, 0, 0.05, 0.01, 0]),
    "ahead and turning": np.array([0.01, -0.03, 0.02, 0.0, 0.01, 0.06]),
    "fast roll": np.array([0, 0, 0.12, 0, 0, 0]),
}


def given_ego(twist=(0,) * 6, row_twist=(0.0,) * 6):
    return Ego(se3.exp(np.array(twist)), np.array(row_twist), np.zeros((6, 6)), np.zeros(6), 1.0, 1.0, 999, True)


@pytest.mark.parametrize("profile", ["default", "paper", "uncertain pose", "no poses"])
@pytest.mark.parametrize("seed", range(3))
def test_kernel_agrees_with_the_textbook_form(profile, seed):
    rng = np.random.default_rng(seed)
    named = "paper" if profile == "paper" else "default"
    matches = random_matches(rng, poses=profile != "no poses", profile=named)
    ego = given_ego(rng.normal(0, 0.02, 6), np.zeros(6) if profile == "paper" else rng.normal(0, 0.01, 6))
    if profile == "uncertain pose":  # an uncertain pose
        ego = replace(ego, covariance=np.diag([1e-4, 2e-4, 3e-4, 1e-4, 1e-4, 4e-4]))
    ours, book = measure_motion(matches, ego), textbook.motion(matches, ego)

    disagree = ours.validity != book["gate"]
    assert disagree.mean() < 1e-3  # float32 may round a pixel across a threshold
    valid = (ours.validity == Validity.VALID) & ~disagree
    assert valid.mean() > 0.3
    error = np.abs(ours.d_m - book["d_m"])[valid] / book["d_m"][valid]
    assert np.median(error) < 1e-5
    assert np.quantile(error, 0.999) < 1e-3
    assert np.abs(ours.residual - book["residual"])[:, valid].max() < 1e-4
    assert np.isnan(ours.d_m[ours.validity != Validity.VALID]).all()
    assert np.abs(ours.p_stat[valid] - book["p_stat"][valid]).max() < 1e-4


@pytest.mark.parametrize("stride", [1, 3, 4])
def test_covariance_agrees_with_the_textbook_form(stride):
    matches = random_matches(np.random.default_rng(5))
    ego = given_ego([0.01, 0.02, -0.01, 0.02, 0, 0.01])
    thin, book = measure_motion(matches, ego).covariances(stride), textbook.motion(matches, ego)
    upper = book["sigma"][::stride, ::stride][..., [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    valid = ~np.isnan(thin.sigma_z)
    assert valid.mean() > 0.3
    scale = np.trace(book["sigma"][::stride, ::stride][valid], axis1=-2, axis2=-1)[:, None]
    assert (np.abs(np.moveaxis(thin.upper, 0, -1)[valid] - upper[valid]) / scale).max() < 1e-4
    np.testing.assert_allclose(thin.sigma_z[valid], book["along"][::stride, ::stride][valid], rtol=1e-4)


def test_round_trip_agrees_with_the_textbook_form():
    rng = np.random.default_rng(2)
    forward = rng.normal(0, 9, (50, 70, 2)).astype(np.float32)
    backward = rng.normal(0, 9, (50, 70, 2)).astype(np.float32)
    ours = np.empty((50, 70), np.float32)
    flow_kernels.round_trip(forward, backward, ours)
    book = textbook.round_trip(forward.astype(float), backward.astype(float))
    np.testing.assert_array_equal(np.isnan(ours), np.isnan(book))
    np.testing.assert_allclose(ours[~np.isnan(ours)], book[~np.isnan(book)], rtol=1e-3, atol=1e-3)


def test_p_stat_table_is_the_chi_square_tail():
    d2 = np.linspace(0, kernels.P_TABLE_MAX, kernels.P_TABLE_SIZE)
    np.testing.assert_allclose(kernels.p_stat_table(), stats.chi2.sf(d2, 3), atol=1e-6)


@pytest.mark.parametrize("name", MOTIONS)
def test_a_still_noisy_world_gives_chi_square_under_any_camera_motion(name):
    matches, _ = room_pair(
        MOTIONS[name], np.random.default_rng(11), sets=(*PLAIN, "gate.depth_band=0", "gate.occlusion_sigma=0")
    )
    s = EgoSettings(model="rigid")
    motion = measure_motion(matches, refine_ego(matches, no_segments(matches.pair.first), s, np.random.default_rng(0)))
    smooth = matches.inputs.range_second < 0.15  # across a depth edge a noisy match reads the other surface
    sample = motion.d_m[::9, ::9][(motion.validity == Validity.VALID)[::9, ::9] & smooth[::9, ::9]]
    assert sample.size > 2000
    assert stats.kstest(sample.astype(float) ** 2, stats.chi2(3).cdf).pvalue > 0.01
    assert abs(motion.static_d_m2_median / stats.chi2(3).median() - 1) < 0.08


@pytest.mark.parametrize("k", [0.5, 10])
@pytest.mark.parametrize("profile", ["default", "paper"])
def test_k_times_the_noise_gives_a_kth_of_d_m(k, profile):
    gate = ["gate.occlusion_sigma=0"]
    one = random_matches(np.random.default_rng(8), sets=gate, profile=profile)
    scaled = random_matches(np.random.default_rng(8), sets=[*gate, f"noise.scale={k}"], profile=profile)
    ego = given_ego()
    a, b = measure_motion(one, ego).d_m, measure_motion(scaled, ego).d_m
    seen = np.nan_to_num(a) > 0.1
    assert seen.mean() > 0.2
    np.testing.assert_allclose(a[seen] / b[seen], k, rtol=1e-3)


@pytest.mark.parametrize("poses", [True, False])
def test_moving_things_stand_out(poses):
    matches, labels = room_pair(MOTIONS["sideways"], np.random.default_rng(3), elapsed_s=0.1, poses=poses)
    motion = measure_motion(
        matches, refine_ego(matches, no_segments(matches.pair.first), EgoSettings(), np.random.default_rng(0))
    )
    valid = motion.validity == Validity.VALID
    flagged = np.nan_to_num(motion.d_m) > motion.tau_px
    for mover in (1, 3):
        assert flagged[valid & (labels == mover)].mean() > 0.95
    assert flagged[valid & (labels == 0)].mean() < 0.08
    assert flagged[valid & (labels == 2)].mean() < 0.12


def test_an_approaching_mover_is_not_called_occluded_and_a_hidden_wall_is():
    matches, labels = room_pair(MOTIONS["still"], elapsed_s=0.5)
    motion = measure_motion(matches, given_ego())
    ball = labels == 1  # it comes nearer by 7 cm
    assert (motion.validity[ball] == Validity.OCCLUDED).mean() < 0.05
    # the wall's exact flow is zero: where the sliding box now stands before it, its match lies on the box
    covered = (labels == 0) & (matches.pair.second.depth < matches.pair.first.depth - 0.35)
    assert covered.sum() > 1000
    assert (motion.validity[covered] == Validity.OCCLUDED).mean() > 0.95


def test_alpha_sets_the_threshold():
    matches, _ = room_pair(
        MOTIONS["still"], np.random.default_rng(1), sets=(*PLAIN, "gate.depth_band=0", "noise.alpha=0.2")
    )
    motion = measure_motion(matches, given_ego())
    assert motion.tau_px == pytest.approx(stats.chi2(3).isf(0.2) ** 0.5)
    assert motion.flagged_share == pytest.approx(0.2, abs=0.02)
