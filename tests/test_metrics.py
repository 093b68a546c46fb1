"""Metrics against scikit-learn, brute force and hand-worked examples."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sklearn.isotonic import IsotonicRegression
from sklearn.metrics import average_precision_score, f1_score

from vlmm_log.evaluation.counts import Counts, bin_floor, bins, count
from vlmm_log.evaluation.isotonic import element_curve, fitted, pixel_curve
from vlmm_log.evaluation.metrics import (
    average_precision,
    decision,
    element_average_precision,
    full_frame_ap,
    idf1,
    interval,
    macro_f1,
    reliability,
    scored_ap,
)
from vlmm_log.evaluation.noise_fit import NoiseFit
from vlmm_log.evaluation.outcome import judgement, outcome
from vlmm_log.evaluation.trial import Seen
from vlmm_log.evaluation.truth import IGNORE, MOVING, STATIC, PairTruth
from vlmm_log.types import Frame, FramePair, Motion, Outcome

NAN = float("nan")
SHAPE = (60, 80)
NOWHERE = np.zeros(SHAPE, bool)


def frame(rng, *, levels=None, lost=0.1, moving=0.2):
    """Scores (H, W) with NaN, truth, far: movers score higher. ``levels``: few distinct scores, 0 among them."""
    motion = rng.choice(np.array([STATIC, IGNORE, MOVING], np.uint8), SHAPE, p=[0.9 - moving, 0.1, moving])
    score = (rng.gamma(2.0, 0.7, SHAPE) + 1.5 * (motion == MOVING) * rng.random(SHAPE)).astype(np.float32)
    if levels is not None:
        score = np.floor(np.minimum(score, levels - 1)).astype(np.float32)
    score[rng.random(SHAPE) < lost] = NAN
    return score, PairTruth(motion), rng.random(SHAPE) < 0.3


def counted(frames, threshold=2.0):
    return Counts([count(score, threshold, truth, far) for score, truth, far in frames])


def raw(frames):
    """Labels and scores of all pixels that are judged; what was not scored has score 0."""
    known = [truth.motion != IGNORE for _, truth, _ in frames]
    y = np.concatenate([truth.motion[k] == MOVING for (_, truth, _), k in zip(frames, known, strict=True)])
    scores = np.concatenate([score[k] for (score, _, _), k in zip(frames, known, strict=True)])
    return y, scores


# ---- average precision


@given(st.lists(st.tuples(st.booleans(), st.integers(0, 6)), min_size=1, max_size=40))
def test_average_precision_is_scikit_learn_s_with_ties(rows):
    yes, scores = np.array([y for y, _ in rows]), np.array([s for _, s in rows], float)
    found = element_average_precision(yes, scores)
    table = [np.bincount(scores[m].astype(int), minlength=7).astype(float) for m in (yes, ~yes)]
    if yes.any():
        expected = average_precision_score(yes, scores)
        assert found == pytest.approx(expected)
        assert average_precision(*table) == pytest.approx(expected)  # bins that hold nothing change nothing
    else:
        assert np.isnan(found)
        assert np.isnan(average_precision(*table))


def test_average_precision_of_nothing_is_unknown():
    assert np.isnan(average_precision(np.zeros(0), np.zeros(0)))
    assert np.isnan(element_average_precision(np.zeros(0, bool), np.zeros(0)))
    assert element_average_precision(np.array([True]), np.array([-1e9])) == 1.0


@given(st.lists(st.floats(0, 2.0**100, width=32), min_size=1, max_size=50))
def test_bins_rise_with_the_score_and_are_narrow(values):
    scores = np.sort(np.array([*values, 0.0, -0.0], np.float32))
    at = bins(scores)
    assert (np.diff(at.astype(int)) >= 0).all()
    floor = bin_floor(at.astype(np.int64)).astype(float)
    assert (floor <= scores).all()
    wide = scores > 1e-30
    assert (scores[wide] <= floor[wide] * (1 + 1 / 128)).all()
    assert bins(np.array([-0.0], np.float32))[0] == 0


@pytest.mark.parametrize("seed", range(4))
def test_binned_average_precision_is_near_that_of_the_raw_pixels(seed):
    frames = [frame(np.random.default_rng([seed, k])) for k in range(3)]
    y, scores = raw(frames)
    s = counted(frames).summed()
    assert full_frame_ap(s) == pytest.approx(average_precision_score(y, np.nan_to_num(scores)), abs=0.003)
    known = np.isfinite(scores)
    assert scored_ap(s) == pytest.approx(average_precision_score(y[known], scores[known]), abs=0.003)
    assert s.pixels == y.size
    assert s.prevalence == pytest.approx(y.mean())
    assert s.coverage == pytest.approx(known.mean())


@pytest.mark.parametrize("seed", range(4))
def test_few_distinct_scores_are_judged_exactly_and_unscored_ones_tie_with_zero(seed):
    frames = [frame(np.random.default_rng([seed, k]), levels=4, lost=0.4) for k in range(2)]
    y, scores = raw(frames)
    s = counted(frames).summed()
    assert full_frame_ap(s) == pytest.approx(average_precision_score(y, np.nan_to_num(scores)), abs=1e-12)
    known = np.isfinite(scores)
    assert scored_ap(s) == pytest.approx(average_precision_score(y[known], scores[known]), abs=1e-12)


def test_what_is_ignored_decides_nothing():
    score, truth, far = frame(np.random.default_rng(0))
    other = np.where(truth.motion == IGNORE, np.float32(99), score)
    a, b = (counted([(x, truth, far)]).summed() for x in (score, other))
    assert full_frame_ap(a) == full_frame_ap(b)
    assert (a.recall, a.precision, a.static_flags, a.far_flags) == (b.recall, b.precision, b.static_flags, b.far_flags)
    assert a.ignored == np.count_nonzero(truth.motion == IGNORE)


def test_nothing_scored_and_nothing_judged():
    lost = np.full(SHAPE, NAN, np.float32)
    _, truth, far = frame(np.random.default_rng(0))
    s = counted([(lost, truth, far)]).summed()
    assert full_frame_ap(s) == pytest.approx(s.prevalence)  # one step: all tie
    assert s.recall == 0 and s.coverage == 0
    assert np.isnan([s.precision, s.static_flags, s.far_flags, scored_ap(s)]).all()
    ignored = counted([(lost, PairTruth(np.full(SHAPE, IGNORE, np.uint8)), far)]).summed()
    assert np.isnan([full_frame_ap(ignored), ignored.recall, ignored.prevalence, ignored.coverage]).all()


# ---- flags


def test_flags_by_hand():
    score = np.array([[3, 1, NAN, 5], [2.5, 1, NAN, 9]], np.float32)
    motion = np.array([[255, 255, 255, 0], [0, 0, 0, 128]], np.uint8)
    far = np.array([[True, True, True, True], [False, True, True, True]])
    truth = PairTruth(motion)
    one = count(score, 2.0, truth, far)
    s = Counts([one]).summed()
    assert (s.moving_lost, s.static_lost, s.ignored) == (1, 1, 1)
    assert (s.recall, s.precision) == (1 / 3, 1 / 3)
    assert (s.static_flags, s.far_flags) == (2 / 3, 1 / 2)
    assert (s.prevalence, s.coverage) == (3 / 7, 5 / 7)
    o = Outcome
    assert outcome(score, 2.0, truth).tolist() == [
        [o.HIT, o.MISS, o.LOST, o.FALSE_FLAG],
        [o.FALSE_FLAG, o.QUIET, o.QUIET, o.IGNORED],
    ]
    figures = judgement(score, 2.0, truth, one).figures
    assert figures["recall"] == 1 / 3 and figures["far_flags"] == 1 / 2
    assert set(judgement(score, 2.0, truth, count(score, 2.0, truth, ~far)).figures) >= {"ap", "recall"}


def test_a_score_at_the_threshold_is_no_flag():
    score, motion = np.full((1, 2), 2.0, np.float32), np.array([[255, 0]], np.uint8)
    s = Counts([count(score, 2.0, PairTruth(motion), np.ones((1, 2), bool))]).summed()
    assert (s.recall, s.static_flags) == (0, 0)


@pytest.mark.parametrize("levels", [None, 5])
@pytest.mark.parametrize("recall", [0.0, 0.01, 0.3, 0.6, 0.8, 0.89, 0.999, 1.0])
def test_far_flags_at_equal_recall_by_brute_force(levels, recall):
    frames = [frame(np.random.default_rng([7, k]), levels=levels) for k in range(2)]
    moving = np.concatenate([score[truth.motion == MOVING] for score, truth, _ in frames])
    far = np.concatenate([score[(truth.motion == STATIC) & at] for score, truth, at in frames])
    far = far[np.isfinite(far)]
    found = counted(frames).summed().far_flags_at(recall)
    enough = [t for t in np.unique(moving[np.isfinite(moving)]) if (moving >= t).sum() >= recall * moving.size - 1e-9]
    if recall == 0:
        assert found == 0
    elif not enough:
        assert np.isnan(found)
    else:
        assert found == pytest.approx((far >= max(enough)).mean(), abs=1e-12 if levels else 0.01)


def test_far_flags_without_movers_or_far_pixels_are_unknown():
    score, truth, far = frame(np.random.default_rng(0))
    assert np.isnan(counted([(score, truth, NOWHERE)]).summed().far_flags_at(0.5))
    still = PairTruth(np.zeros(SHAPE, np.uint8))
    assert np.isnan(counted([(score, still, far)]).summed().far_flags_at(NAN))


@given(st.lists(st.integers(0, 3), min_size=3, max_size=3))
def test_frames_can_be_counted_several_times(weights):
    frames = [frame(np.random.default_rng(k)) for k in range(3)]
    several = [f for f, n in zip(frames, weights, strict=True) for _ in range(n)]
    a, b = counted(frames).summed(np.array(weights)), counted(several).summed()
    for name in vars(a):
        assert np.array_equal(getattr(a, name), getattr(b, name))


# ---- calibration


def test_calibration_error_by_hand():
    # 0.95 is right in 3 of 4, 0.1 in 0 of 4, 0.5 in 2 of 2: |.95 - .75| 4/10 + |.1 - 0| 4/10 + |.5 - 1| 2/10
    r = reliability(np.array([0.95, 0.1, 0.5]), np.array([3.0, 0.0, 2.0]), np.array([1.0, 4.0, 0.0]))
    assert r.ece == pytest.approx(0.08 + 0.04 + 0.1)
    assert len(r.weight) == 15 and sum(r.weight) == pytest.approx(1)
    assert r.frequency[14] == 0.75 and r.confidence[1] == pytest.approx(0.1)
    assert np.isnan(r.confidence[0])
    assert np.isnan(reliability(np.zeros(0), np.zeros(0), np.zeros(0)).ece)


@given(st.lists(st.tuples(st.floats(0, 1), st.integers(0, 5), st.integers(0, 5)), min_size=1, max_size=60))
def test_calibration_error_by_brute_force(rows):
    p, positives, negatives = (np.array(x, float) for x in zip(*rows, strict=True))
    total = (positives + negatives).sum()
    place = np.minimum(np.floor(p * 15), 14)
    gaps = 0.0
    for k in range(15):
        mass, held = (positives + negatives) * (place == k), positives * (place == k)
        if mass.sum():
            gaps += mass.sum() / total * abs((mass * p).sum() / mass.sum() - held.sum() / mass.sum())
    found = reliability(p, positives, negatives).ece
    assert np.isnan(found) if not total else found == pytest.approx(gaps, abs=1e-9)


# ---- intervals


def test_intervals_hold_the_figure_and_come_again():
    frames = [frame(np.random.default_rng([3, k]), moving=0.05 + 0.02 * k) for k in range(12)]
    counts = counted(frames)
    low, high = interval(counts, full_frame_ap, np.random.default_rng(0))
    assert low < full_frame_ap(counts.summed()) < high
    assert [low, high] == interval(counts, full_frame_ap, np.random.default_rng(0))
    assert np.isnan(interval(counted(frames[:1]), full_frame_ap, np.random.default_rng(0))).all()


def test_intervals_cover():
    hits, rng = 0, np.random.default_rng(0)
    shares = rng.beta(2, 8, 4000)
    for k in range(60):
        frames = []
        for share in rng.choice(shares, 25):
            motion = np.full((1, 100), MOVING, np.uint8)
            score = np.where(rng.random((1, 100)) < share, np.float32(3), np.float32(1))
            frames.append((score, PairTruth(motion), np.zeros((1, 100), bool)))
        low, high = interval(counted(frames), lambda s: s.recall, np.random.default_rng(k))
        hits += low <= shares.mean() <= high
    assert hits >= 0.8 * 60


def test_without_movers_there_is_no_interval():
    still = [
        (score, PairTruth(np.zeros(SHAPE, np.uint8)), far) for score, _, far in [frame(np.random.default_rng(0))] * 3
    ]
    assert np.isnan(interval(counted(still), full_frame_ap, np.random.default_rng(0))).all()  # and no warning


# ---- decisions, identities


@given(st.lists(st.tuples(st.integers(0, 2), st.sampled_from([0, 1, 2, 255])), min_size=1, max_size=30))
def test_macro_f1_is_scikit_learn_s(rows):
    truth, said = zip(*rows, strict=True)
    expected = f1_score(truth, said, labels=[0, 1, 2], average="macro", zero_division=1.0)
    assert macro_f1(truth, said, 3) == pytest.approx(expected)


def test_decisions_by_hand():
    truth, said = np.array([1, 1, 1, 0, 0], bool), np.array([1, 0, 0, 1, 0], bool)
    d = decision(truth, said)
    assert (d.precision, d.recall, d.f1) == (1 / 2, 1 / 3, 2 / 5)
    nothing = np.zeros(3, bool)
    assert vars(decision(nothing, nothing)) == {"precision": 1.0, "recall": 1.0, "f1": 1.0}
    assert decision(nothing, ~nothing).f1 == 0


def test_idf1_by_hand():
    # Two things of 10 frames each that swap their identities after 6: 12 of 20 + 20 detections count twice.
    switch = np.array([[6, 4], [4, 6]])
    assert idf1(switch, 20, 20) == pytest.approx(24 / 40)
    assert idf1(np.diag([10, 10]), 20, 20) == 1
    assert idf1(np.array([[6, 4]]), 10, 10) == pytest.approx(12 / 20)  # one thing, two identities
    assert idf1(np.array([[6], [4]]), 10, 10) == pytest.approx(12 / 20)  # one identity, two things
    assert idf1(np.zeros((0, 0), np.int64), 10, 0) == 0
    assert np.isnan(idf1(np.zeros((0, 0), np.int64), 0, 0))


# ---- isotonic curves


@given(st.lists(st.tuples(st.integers(0, 12), st.booleans(), st.integers(1, 9)), min_size=2, max_size=40))
def test_curves_are_the_isotonic_fit(rows):
    x, y, w = (np.array(v, float) for v in zip(*rows, strict=True))
    curve = fitted(x / 3, y, w)
    expected = IsotonicRegression(y_min=0, y_max=1, out_of_bounds="clip").fit(x / 3, y, sample_weight=w)
    assert curve(x / 3) == pytest.approx(expected.predict(x / 3), abs=1e-6)
    grid = np.linspace(-1, 6, 50)
    assert (np.diff(curve(grid)) >= -1e-7).all()
    assert (np.diff(curve.x) > 0).all() and (curve.p >= 0).all() and (curve.p <= 1).all()


def test_pixel_curves_weigh_each_pixel():
    frames = [frame(np.random.default_rng(k), levels=6) for k in range(2)]
    y, scores = raw(frames)
    known = np.isfinite(scores)
    curve = pixel_curve(counted(frames).summed())
    expected = IsotonicRegression().fit(scores[known], y[known])
    assert curve(np.arange(6.0)) == pytest.approx(expected.predict(np.arange(6.0)), abs=1e-6)


def test_one_kind_alone_fits_no_curve():
    score, _, far = frame(np.random.default_rng(0))
    for value in (STATIC, MOVING, IGNORE):
        assert pixel_curve(counted([(score, PairTruth(np.full(SHAPE, value, np.uint8)), far)]).summed()) is None
    assert element_curve(np.array([1.0, 2.0]), np.array([True, True])) is None
    assert element_curve(np.zeros(0), np.zeros(0, bool)) is None
    two = element_curve(np.array([0.2, 1.4]), np.array([False, True]))
    assert two(np.array([0.0, 0.2, 1.4, 3.0])).tolist() == [0, 0, 1, 1]


# ---- the sensor's noise


def seen_with(depth, difference):
    """A pair whose residual along the second camera's axis, which points along the world's +x, is known."""
    H, W = depth.shape
    T = np.eye(4)
    T[:3, :3] = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    first = Frame(0, 0, np.zeros((H, W, 3), np.uint8), depth, np.eye(3), np.eye(4))
    second = Frame(10**8, 3, first.rgb, depth, np.eye(3), T)
    residual = np.stack([difference, 9 + 0 * difference, -9 + 0 * difference]).astype(np.float32)
    nothing = np.zeros((H, W), np.float32)
    motion = Motion(residual, nothing, nothing, np.zeros((H, W), np.uint8), 2.8, lambda stride: None)
    return Seen(FramePair(first, second), None, None, None, motion, None, None, None, None)


def test_the_sensor_s_noise_is_found_again():
    rng, fit = np.random.default_rng(0), NoiseFit()
    a, b, z0 = 0.0014, 0.0023, 0.4
    for _ in range(4):
        depth = rng.uniform(0.3, 5.5, (240, 320)).astype(np.float32)
        noise = rng.standard_normal((2, *depth.shape)) * (a + b * (depth - z0) ** 2)
        truth = rng.choice(np.array([STATIC, MOVING], np.uint8), depth.shape, p=[0.7, 0.3])
        difference = noise[0] - noise[1] + 0.5 * (truth == MOVING)  # what moves is left out
        fit.add(seen_with(depth, difference), PairTruth(truth))
    z, sigma = fit.sigma()
    assert sigma == pytest.approx(a + b * (z - z0) ** 2, rel=0.06)
    assert fit.model(z0) == pytest.approx((a, b), rel=0.08)
    assert NoiseFit().model(z0) is None
