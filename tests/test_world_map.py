"""The map: independent of order, merging exactly; fusion as printed."""

from itertools import permutations
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from known_maps import evidence, observations
from vlmm_log.background import Background, empty_background, merged
from vlmm_log.elements import (
    OBSERVATION,
    Evidence,
    MotionClass,
    Movability,
    Sightings,
    Tracked,
)
from vlmm_log.pipeline import world_map as wm
from vlmm_log.pipeline.fusion import attributes, classify, fuse, motion_intervals
from vlmm_log.settings import MapSettings, Settings
from vlmm_log.types import Segments

S = MapSettings()
NAMES = ("cup", "door", "chair")


def prior(label):
    return Movability({"cup": 0.9, "door": 0.4, "chair": 0.6}.get(label, 0.5), "test")


def tracked(rng, index, n=3):
    """What one pair shows of up to n elements."""
    ids = rng.permutation(n)[: rng.integers(0, n + 1)] + 1
    rows = np.zeros(len(ids), OBSERVATION)
    for name in ("o", "phi", "gamma", "kappa", "position", "extent"):
        rows[name] = rng.random(rows[name].shape).astype(np.float32)
    rows["pixels"] = rng.integers(100, 400, len(ids))
    rows["index"], rows["first_ns"], rows["second_ns"] = index, index * 10**8, index * 10**8 + 3 * 10**8
    names = tuple(NAMES[rng.integers(0, 3)] for _ in ids)
    segments = Segments(
        np.zeros((2, 2), np.int32), names, rng.random(len(ids)).astype(np.float32), ids.astype(np.int64)
    )
    sightings = Sightings(segments, rows, np.zeros((len(ids), 4), np.int32), rng.random(len(ids)) < 0.8)
    return Tracked(sightings, rng.random((len(ids), 4)).astype(np.float32), ids.astype(np.int64), np.ones(len(ids)))


def cloud(rng):
    cells = np.unique(rng.integers(-3, 3, (20, 3)), axis=0)
    return Background(0.05, cells.astype(np.int32), rng.integers(1, 9, (len(cells), 4)).astype(np.int64))


def built(pairs):
    world = wm.empty_map(S)
    for seen, background in pairs:
        world = fuse(wm.update(world, seen, background), prior, S)
    return world


def assert_same(a, b):
    assert a.evidence.keys() == b.evidence.keys()
    for i in a.evidence:
        x, y = a.evidence[i], b.evidence[i]
        assert x.observations.tobytes() == y.observations.tobytes()
        assert (dict(x.votes), x.feature_pixels, x.feature_index) == (dict(y.votes), y.feature_pixels, y.feature_index)
        assert x.feature.tobytes() == y.feature.tobytes()
    assert a.background.cells.tobytes() == b.background.cells.tobytes()
    assert a.background.sums.tobytes() == b.background.sums.tobytes()
    for name, value in vars(a.columns).items():
        other = getattr(b.columns, name)
        assert value.tobytes() == other.tobytes() if isinstance(value, np.ndarray) else value == other, name


def pairs_of(seed, count):
    rng = np.random.default_rng(seed)
    return [(tracked(rng, index), cloud(rng)) for index in range(count)]


@given(st.integers(0, 2**32), st.randoms(use_true_random=False))
def test_the_map_does_not_depend_on_the_order_of_pairs(seed, random):
    pairs = pairs_of(seed, 8)
    shuffled = random.sample(pairs, len(pairs))
    assert_same(built(pairs), built(shuffled))


@given(st.integers(0, 2**32), st.integers(0, 8))
def test_two_halves_with_the_same_identities_make_the_whole(seed, cut):
    pairs = pairs_of(seed, 8)
    a, b = built(pairs[:cut]), built(pairs[cut:])
    assert_same(fuse(wm.merge(a, b), prior, S), built(pairs))


def test_merging_is_associative_and_commutative():
    parts = [built(p) for p in (pairs_of(1, 9)[:3], pairs_of(1, 9)[3:5], pairs_of(1, 9)[5:])]
    whole = built(pairs_of(1, 9))
    for x, y, z in permutations(parts):
        assert_same(fuse(wm.merge(fuse(wm.merge(x, y), prior, S), z), prior, S), whole)
        assert_same(fuse(wm.merge(x, fuse(wm.merge(y, z), prior, S)), prior, S), whole)


def test_an_older_map_does_not_change_when_two_grow_from_it():
    pairs = pairs_of(2, 12)
    old = built(pairs[:6])
    before = {i: e.observations.tobytes() for i, e in old.evidence.items()}
    left, right = old, old
    for seen, background in pairs[6:9]:
        left = fuse(wm.update(left, seen, background), prior, S)
    for seen, background in pairs[9:]:
        right = fuse(wm.update(right, seen, background), prior, S)
    assert before == {i: e.observations.tobytes() for i, e in old.evidence.items()}
    assert_same(left, built(pairs[:9]))
    assert_same(right, built(pairs[:6] + pairs[9:]))


def test_observation_lists_grow_without_copies_of_all_before():
    """Room is doubled: a thousand rows need but a handful of moves."""
    seen = observations(1)
    places = set()
    for k in range(1, 1000):
        row = observations(1)
        row["first_ns"] += k
        seen = wm.merge_evidence(evidence(1, seen=seen), evidence(1, seen=row)).observations
        places.add(seen.__array_interface__["data"][0])
    assert len(seen) == 1000 and (np.diff(seen["first_ns"]) == 1).all()
    assert len(places) < 12


def test_the_feature_is_of_the_frame_with_most_pixels_the_earlier_of_equals():
    def one(index, pixels):
        seen = observations(1, pixels=pixels)
        seen["index"] = index
        seen["first_ns"] += index
        return Evidence(1, {"cup": 1000}, seen, np.array([index, 0], np.float32), pixels, index)

    parts = [one(3, 500), one(1, 500), one(2, 400), one(4, 100)]
    for order in permutations(parts):
        whole = order[0]
        for part in order[1:]:
            whole = wm.merge_evidence(whole, part)
        assert whole.feature[0] == 1 and whole.feature_index == 1 and whole.feature_pixels == 500


def test_small_elements_wait():
    world = wm.empty_map(S)
    rng = np.random.default_rng(0)
    for index, pixels in enumerate((100, 149, 150)):
        seen = tracked(rng, index)
        rows = observations(1, pixels=pixels)
        rows["index"], rows["first_ns"] = index, index
        segments = Segments(seen.sightings.segments.labels, ("cup",), np.ones(1, np.float32), np.ones(1, np.int64))
        sightings = Sightings(segments, rows, np.zeros((1, 4), np.int32), np.ones(1, np.bool_))
        one = Tracked(sightings, np.ones((1, 4), np.float32), np.ones(1, np.int64), np.ones(1, np.float32))
        world = fuse(wm.update(world, one, empty_background(S.voxel_m)), prior, S)
        assert (1 in world.elements) == (pixels >= 150)
    assert world.elements[1].evidence.observations.size == 3


def test_different_voxels_do_not_merge():
    with pytest.raises(ValueError, match="voxels"):
        merged([empty_background(0.05), empty_background(0.1)])


# ---- fusion


def test_the_rule_is_the_papers():
    s = MapSettings(tau_o=1.5, kappa_o=0.3, rho_tau=0.55)
    assert classify(1.6, 0.3, 0.9, s) == (MotionClass.MOVING, 0.3)
    assert classify(1.5, 1.0, 0.9, s) == (MotionClass.MOVABLE_STATIC, 0.9)  # o must exceed
    assert classify(9.0, 0.29, 0.2, s) == (MotionClass.STATIC, 0.8)  # unreliable motion defers to the prior
    assert classify(0.0, 0.0, 0.55, s) == (MotionClass.MOVABLE_STATIC, 0.55)


@given(*[st.floats(0, 5)] * 2, *[st.floats(0, 1)] * 4)
def test_more_evidence_never_makes_a_thing_less_mobile(o, more_o, kappa, more_kappa, rho, more_rho):
    low = classify(o, kappa, rho, S)[0]
    high = classify(o + more_o, max(kappa, more_kappa), max(rho, more_rho), S)[0]
    assert high >= low


def test_attributes_are_medians_and_the_score_remembers():
    o = np.array([1, 1, 1, 1, 12], np.float32)
    kappa = np.array([0, 0, 0, 0, 0.8], np.float32)
    e = attributes(evidence(1, "door", seen=observations(5, o=o, kappa=kappa)), prior, MapSettings(o_unit=2.0))
    assert (e.o, e.kappa, e.score) == (0.5, 0.0, pytest.approx(6.0))
    assert e.motion_class is MotionClass.STATIC and e.confidence == pytest.approx(0.6)
    assert not e.intervals.size  # one pair out of five is an outlier


def test_intervals_span_runs_of_moving_pairs():
    moved = np.array([0, 1, 1, 0, 1, 0, 1, 1, 1], bool)
    seen = observations(9)
    spans = motion_intervals(seen, moved, 2)
    first, second = seen["first_ns"], seen["second_ns"]
    assert spans.tolist() == [[first[1], second[2]], [first[6], second[8]]]
    assert len(motion_intervals(seen, moved, 1)) == 3
    assert not motion_intervals(seen[1:3], moved[1:3], 3).size  # two pairs are not three
    assert motion_intervals(seen, np.zeros(9, bool), 1).shape == (0, 2)


@given(st.lists(st.tuples(st.integers(0, 8), st.booleans()), min_size=1, max_size=30), st.integers(1, 4))
def test_intervals_are_those_of_a_walk_over_the_pairs(steps, pairs):
    """Pairs last 3 steps; two in a row that begin more than twice the usual step apart are two runs."""
    seen, moved = observations(len(steps)), np.array([m for _, m in steps])
    seen["first_ns"] = np.cumsum([step for step, _ in steps])
    seen["second_ns"] = seen["first_ns"] + 3
    usual = min((step for step, _ in steps[1:] if step), default=9)
    runs = [[]]
    for k, (step, moves) in enumerate(steps):
        if not moves or (k and step > max(2 * usual, 3)):
            runs.append([])
        if moves:
            runs[-1].append(k)
    spans = [[seen["first_ns"][r[0]], seen["second_ns"][r[-1]]] for r in runs if len(r) >= pairs]
    assert motion_intervals(seen, moved, pairs).tolist() == spans


def test_time_unseen_ends_an_interval():
    seen = observations(6)
    seen["first_ns"][3:] += 100 * 10**9
    seen["second_ns"][3:] += 100 * 10**9
    spans = motion_intervals(seen, np.ones(6, bool), 3)
    assert spans.tolist() == [[seen["first_ns"][k], seen["second_ns"][k + 2]] for k in (0, 3)]
    sparse = observations(4)
    sparse["first_ns"] = np.arange(4) * 10**9  # keyframes further apart than a pair is long
    sparse["second_ns"] = sparse["first_ns"] + 10**8
    assert len(motion_intervals(sparse, np.ones(4, bool), 4)) == 1


def test_a_part_that_moves_makes_an_interval_and_no_class():
    n = S.interval_pairs
    seen = observations(n + 3, part=[0, *[0.2] * n, 0, 0])
    e = attributes(evidence(1, "cup", seen=seen), prior, S)
    assert len(e.intervals) == 1 and e.motion_class is MotionClass.MOVABLE_STATIC
    paper = attributes(evidence(1, "cup", seen=seen), prior, Settings.load("paper").map)
    assert not paper.intervals.size


def test_speed_is_of_the_pairs_that_moved():
    drift = np.zeros((4, 3), np.float32)
    drift[2:] = (0.3, 0.0, 0.4)
    seen = observations(4, o=[1, 1, 9, 9], kappa=[0, 0, 1, 1], drift=drift)
    seconds = float((seen["second_ns"] - seen["first_ns"])[0]) / 1e9
    assert attributes(evidence(1, seen=seen), prior, S).speed == pytest.approx(0.5 / seconds)
    assert attributes(evidence(1, seen=seen[:2]), prior, S).speed == 0.0


def test_the_label_is_the_one_with_most_votes():
    e = Evidence(1, {"tv": 900, "laptop": 1800, "cup": 1800}, observations(1), np.zeros(2, np.float32), 400, 0)
    assert e.label == "cup"


def test_still_points_are_those_of_their_pixels():
    depth = np.random.default_rng(5).uniform(1, 3, (24, 40)).astype(np.float32)
    rgb = np.arange(24 * 40 * 3, dtype=np.uint8).reshape(24, 40, 3)
    K = np.array([[30.0, 0, 19], [0, 31, 11], [0, 0, 1]])
    first = SimpleNamespace(depth=depth, rgb=rgb, K=K)
    d_m = np.where(np.arange(40) < 20, 1.0, 9.0).astype(np.float32) * np.ones((24, 1), np.float32)
    d_m[8, 8] = np.nan
    still = wm.still_points(SimpleNamespace(first=first), SimpleNamespace(d_m=d_m, tau_px=3.0))
    expected = [(v, u) for v in (0, 8, 16) for u in (0, 8, 16) if (v, u) != (8, 8)]
    assert still.points.shape == (3, len(expected))
    for (v, u), point, color in zip(expected, still.points.T, still.colors, strict=True):
        z = float(depth[v, u])
        assert point == pytest.approx([(u - 19) / 30 * z, (v - 11) / 31 * z, z], rel=1e-6)
        assert (color == rgb[v, u]).all()
