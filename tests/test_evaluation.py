"""Evaluations: truth, things, baselines, fields taken away, what is compared, outputs, and damaged truth."""

import dataclasses
import json
import re
import shutil
from types import SimpleNamespace

import known_map
import numpy as np
import pytest
from inert import HOSTILE, read_page
from small_room import write_masks, write_small_room
from truth_room import write_room

import render_room as room
import vlmm_log
from vlmm_log.assessment import evaluate
from vlmm_log.elements import MotionClass, Movability
from vlmm_log.evaluation import scores as sc
from vlmm_log.evaluation.baselines.dewan import DewanStyle
from vlmm_log.evaluation.baselines.displacement import RawDisplacement
from vlmm_log.evaluation.baselines.khronos import KhronosStyle
from vlmm_log.evaluation.baselines.semantic import DualMapStyle, VoxelandStyle
from vlmm_log.evaluation.metrics import element_average_precision
from vlmm_log.evaluation.plans import LEVERS, Comparison, parse_pose_noise, parse_sweeps, plans
from vlmm_log.evaluation.report import to_json
from vlmm_log.evaluation.things import ThingCounts
from vlmm_log.evaluation.truth import IGNORE, MOVING, STATIC, MotionMasks, PairTruth, People, SimulatedTruth, ThingTruth
from vlmm_log.recording import open_recording
from vlmm_log.settings import PROFILES, Settings
from vlmm_log.types import FlowField, Frame, FramePair, InputError, Motion, Segments

FRAMES, GAP = 7, 3
ALL = Comparison(profiles=True, baselines=True, association=True)


@pytest.fixture(scope="module")
def big(tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs") / "room"
    write_room(folder, FRAMES)
    return folder


@pytest.fixture(scope="module")
def judged(big, tmp_path_factory):
    """Everything compared, everything written."""
    out = tmp_path_factory.mktemp("out")
    done = evaluate([big], compare=ALL, json=out / "e.json", html=out / "e.html", recordings=out / "rec")
    return done, out


@pytest.fixture(scope="module")
def little(tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs") / "little"
    write_small_room(folder)
    return folder


@pytest.fixture
def copied(little, tmp_path):
    """A log of one's own, to break."""
    return shutil.copytree(little, tmp_path / "log")


def pairs(log):
    frames = [f for f in vlmm_log.open_log(log).frames(0, 10**18) if isinstance(f, Frame)]
    return [FramePair(a, b) for a, b in zip(frames, frames[GAP:], strict=False)]


def ap(done, trial, score="d_M"):
    (found,) = [r.ap for r in done.pixels if (r.trial, r.score) == (trial, score)]
    return found


def refused(*args, **options):
    with pytest.raises(InputError) as e:
        evaluate(*args, **options)
    assert "\n" not in str(e.value)
    return str(e.value)


# ---- truth


def test_displacement_is_the_movers_speed(big):
    truth = SimulatedTruth(big / "truth")
    for pair in pairs(big)[::3]:
        moved = truth.displacement(pair)
        labels = room.render(room.pose(pair.first.index * room.FRAME_S), pair.first.index * room.FRAME_S).labels
        for label, speed in room.SPEED.items():
            way = np.linalg.norm(speed) * GAP * room.FRAME_S
            assert np.abs(moved[labels == label] - way).max() < 1e-3
        assert (moved[labels == 0] == 0).all()
    assert truth.things[2] == ThingTruth("ball", 1.0, "roll")


def test_masks_judge_as_the_simulated_truth_does(little, tmp_path):
    exact = SimulatedTruth(little / "truth")
    masks = {pair.first.index: exact.of(pair).motion for pair in pairs(little)}
    assert {int(v) for m in masks.values() for v in np.unique(m)} == {STATIC, MOVING}
    write_masks(tmp_path / "masks", masks)
    given = MotionMasks(tmp_path / "masks")
    for pair in pairs(little):
        assert (given.of(pair).motion == exact.of(pair).motion).all()
    instances = f"masks:{little / 'truth/instances'}"
    a, b = evaluate([little]), evaluate([little], truth=tmp_path / "masks", segmenter=instances)
    assert a.pixels == b.pixels
    assert not b.objects and b.things is None and not b.association
    assert a.logs[0].truth == "exact, room seed 0" and b.logs[0].truth == "masks, masks"


def test_masks_within_the_log_are_its_truth(copied):
    shutil.rmtree(copied / "truth")
    mask = np.zeros((120, 160), np.uint8)
    mask[40:80] = MOVING
    write_masks(copied / "truth", {1: mask})
    done = evaluate([copied])
    assert (done.logs[0].judged_pairs, done.logs[0].pairs) == (1, 3)
    assert done.pixels[0].prevalence == pytest.approx(1 / 3)


def test_people_move_and_all_else_does_not():
    labels = np.array([[0, 1, 2], [3, 3, 0]], np.int32)

    def segment(_frame):
        return Segments(labels, ("person", "chair", "man"), np.ones(3, np.float32), np.full(3, -1))

    truth = People(segment).of(SimpleNamespace(first=None))
    assert truth.motion.tolist() == [[0, 255, 0], [255, 255, 0]] and truth.instances is None
    nobody = People(lambda _: Segments(labels, ("cup", "chair", ""), np.ones(3, np.float32), np.full(3, -1)))
    assert nobody.of(SimpleNamespace(first=None)) is None


def test_the_person_proxy_through_masks(copied):
    labels = copied / "truth/instances/labels.txt"
    labels.write_text(labels.read_text().replace("ball", "person"))
    masks = f"masks:{copied / 'truth/instances'}"
    done = evaluate([copied], truth="person", segmenter=masks)
    assert done.logs[0].truth.startswith("proxy")
    assert 0 < done.pixels[0].prevalence < evaluate([copied]).pixels[0].prevalence
    told = refused([copied], truth="person", settings=Settings.load(sets=["objects.segmenter=none"]))
    assert "nobody was found" in told and "--segmenter" in told


# ---- things


THINGS = {1: ThingTruth("wall", 0.0, "still"), 2: ThingTruth("cup", 0.9, "slide"), 3: ThingTruth("book", 0.8, "still")}


def sighted(labels, ids):
    labels = np.asarray(labels, np.int32)
    names = tuple("" for _ in ids)
    segments = Segments(labels, names, np.ones(len(ids), np.float32), np.full(len(ids), -1))
    return SimpleNamespace(segments=segments, tracked=SimpleNamespace(ids=np.array(ids, np.int64)))


def scene():
    """10x20 px: the wall, the cup (moving) 5x5, the book 5x5."""
    instances = np.ones((10, 20), np.int32)
    instances[2:7, 2:7], instances[2:7, 12:17] = 2, 3
    return PairTruth(np.where(instances == 2, np.uint8(MOVING), np.uint8(STATIC)), instances)


def test_a_missed_thing_stands_at_the_end():
    counts, truth = ThingCounts(THINGS), scene()
    counts.add(truth, sighted(np.select([truth.instances == 1, truth.instances == 2], [1, 2]), [7, 8]), 20)
    judged = counts.judged(np.array([7, 8]), 20)
    assert judged.rows.tolist() == [0, 1, -1] and judged.things.tolist() == [1, 2, 3]
    assert judged.moved.tolist() == [False, True, False] and judged.movability.tolist() == [0, 0.9, 0.8]
    assert counts.judged(np.array([7, 8]), 30).rows.tolist() == [0, 1]  # the book has 25 px
    assert (counts.true_seen, counts.found_seen) == (3, 2)
    assert counts.idf1 == pytest.approx(2 * 2 / 5)


def test_an_element_that_straddles_two_things_is_the_larger_one():
    counts, truth = ThingCounts(THINGS), scene()
    labels = np.zeros((10, 20), np.int32)
    labels[2:7, 4:14] = 1  # 15 px of the cup, 10 of the book, 25 of the wall
    counts.add(truth, sighted(labels, [5]), 5)
    assert counts.judged(np.array([5]), 5).things.tolist() == [1, 2, 3]
    assert counts.idf1 == 0  # none to half
    labels = labels * (np.arange(20) < 7)
    again = ThingCounts(THINGS)
    again.add(truth, sighted(labels, [5]), 5)
    assert again.judged(np.array([5]), 5).things.tolist()[0] == 2


def test_identities_that_split_or_swap_lower_idf1():
    truth = scene()
    whole = truth.instances
    for ids, expected in (
        ([[1, 2, 3]] * 4, 1.0),
        ([[1, 2, 3]] * 2 + [[1, 2, 4]] * 2, 2 * 10 / 24),  # the book splits
        ([[1, 2, 3]] * 3 + [[1, 3, 2]], 2 * 10 / 24),  # they swap once
    ):
        counts = ThingCounts(THINGS)
        for row in ids:
            counts.add(truth, sighted(whole, row), 5)
        assert counts.idf1 == pytest.approx(expected)


def test_what_moves_for_half_of_its_judged_pixels_moved():
    truth = scene()
    for share, moved in ((0.3, False), (0.6, True)):
        motion = truth.motion.copy()
        cup = np.flatnonzero(truth.instances == 2)
        motion.ravel()[cup] = IGNORE
        motion.ravel()[cup[:10]] = STATIC
        motion.ravel()[cup[: round(10 * share)]] = MOVING
        counts = ThingCounts(THINGS)
        counts.add(PairTruth(motion, truth.instances), sighted(truth.instances, [1, 2, 3]), 5)
        assert counts.moved(2) == moved


# ---- baselines


K = np.array([[60.0, 0, 39.5], [0, 60.0, 29.5], [0, 0, 1]])
MAP = known_map.known_map(known_map.ROWS[:2])  # elements 1 and 2
RHO = {"chair": 0.8, "wall": 0.0, "cup": 0.9}


def prior(label):
    return Movability(RHO[label], "test")


def seen(index, depth, norm, labels=None, names=("chair", "wall"), ids=(1, 2), flow_x=0.0):
    """A pair that starts at frame ``index``, 30 frames/s, from a camera that stands still."""
    shape = depth.shape
    first = Frame(index * 10**9 // 30, index, np.zeros((*shape, 3), np.uint8), depth.astype(np.float32), K, np.eye(4))
    second = dataclasses.replace(first, stamp_ns=(index + 3) * 10**9 // 30, index=index + 3)
    residual = np.zeros((3, *shape), np.float32)
    residual[0] = norm
    scored = np.where(np.isfinite(depth), np.float32(1), np.float32("nan"))
    motion = Motion(residual, scored, scored, np.zeros(shape, np.uint8), 2.8, lambda stride: None)
    forward = np.zeros((*shape, 2), np.float32)
    forward[..., 0] = flow_x
    segments = Segments(
        np.zeros(shape, np.int32) if labels is None else labels,
        names,
        np.ones(len(names), np.float32),
        np.array(ids, np.int64),
    )
    return SimpleNamespace(
        pair=FramePair(first, second),
        flow=FlowField(forward, -forward, np.zeros(shape, np.float32)),
        motion=motion,
        segments=segments,
        odometry=SimpleNamespace(T_world_first=np.eye(4)),
        tracked=SimpleNamespace(ids=np.array(ids, np.int64), features=np.eye(len(ids), 4, dtype=np.float32)),
        sightings=SimpleNamespace(observed=np.ones(len(ids), bool)),
    )


def halves():
    labels = np.full((60, 80), 2, np.int32)
    labels[:, :40] = 1
    return labels


def test_raw_displacement_ranks_the_mover():
    way = RawDisplacement()
    for k in range(3):
        assert way.see(seen(k, np.full((60, 80), 2.0), np.where(halves() == 1, 0.05, 0.0), halves())) is None
    (found,) = way.answers(MAP)
    assert found.moving == pytest.approx([0.05, 0])
    assert found.static == pytest.approx([-0.05, 0])


def test_khronos_flags_what_stands_in_free_space_and_not_the_wall():
    way, wall = KhronosStyle(), np.full((60, 80), 3.0)
    labels = halves()
    for k in range(4):
        assert not np.nan_to_num(way.see(seen(k, wall, 0.0, labels))).any()
    box = wall.copy()
    box[:, :40] = 1.5
    box[0] = np.nan
    score = way.see(seen(4, box, 0.0, labels))
    assert (score[1:, 2:38] > way.threshold).all() and (score[1:, 42:] == 0).all() and np.isnan(score[0]).all()
    for k in range(5, 12):
        way.see(seen(k, box, 0.0, labels))
    (found,) = way.answers(MAP)
    assert found.moving[0] > found.moving[1] == 0


def test_dewan_s_belief_sums_to_one_and_rises_for_a_mover():
    way, labels = DewanStyle(prior), halves()
    depth = np.full((60, 80), 2.0)
    before = 0.0
    for k in range(4):
        belief = way.see(seen(k, depth, np.where(labels == 1, 0.2, 0.0), labels))
        assert belief[:, :40].min() > before and belief[:, 40:].max() < 1 / 3
        before = belief[:, :40].max() - 1e-6
        if k == 0:
            (found,) = way.answers(MAP)
            assert found.movable + found.static == pytest.approx(1)
    assert before > way.threshold
    (found,) = way.answers(MAP)
    assert found.moving[0] > found.moving[1] and found.static[1] > found.static[0]


def test_dewan_s_belief_is_carried_along_by_the_flow():
    way = DewanStyle(prior)
    depth, labels = np.full((60, 80), 2.0), np.full((60, 80), 2, np.int32)
    norm = np.zeros((60, 80))
    norm[:, 30:40] = 0.2
    first = way.see(seen(0, depth, norm, labels))
    assert (first[0] > 0.5).nonzero()[0].tolist() == list(range(30, 40))
    blind = np.full((60, 80), np.nan)  # it tells nothing of motion: what is believed was carried
    second = way.see(seen(1, depth, blind, labels, flow_x=6.0))  # in 3 frames; 2 px since the last pair
    best = np.argsort(second[0])[-10:]
    assert sorted(best.tolist()) == list(range(32, 42))


def test_voxeland_s_expectation_by_hand():
    way = VoxelandStyle(prior)
    for names in (("chair", "wall"), ("chair", "wall"), ("cup", "wall")):
        way.see(seen(0, np.full((60, 80), 2.0), 0.0, halves(), names))
    (found,) = way.answers(MAP)
    assert found.movable == pytest.approx([(2 * 0.8 + 0.9 + 0.5) / 4, (0.5) / 4])
    assert found.static == pytest.approx(1 - found.movable)


def test_dualmap_puts_a_cup_above_a_wall():
    words = vlmm_log.models.load.load_models(Settings())[0].embed
    features = words.texts(["cup", "wall"])
    (found,) = DualMapStyle(words).answers(dataclasses.replace(MAP, features=features))
    assert found.movable[0] > found.movable[1]


def test_every_way_answers_for_the_same_elements(judged):
    done, _ = judged
    names = [r.name for r in done.objects]
    assert names[0] == "full" and names[-1] == "random"
    for name in (
        "no uncertainty",
        "raw displacement",
        "Khronos-style",
        "Dewan-style",
        "paper",
        "movability prior only",
    ):
        assert name in names
    assert done.things.elements == 4 and done.things.missed == 0
    assert done.objects[0].ap == {"moving": 1.0, "movable": 1.0, "static": 1.0}
    best = {r.name: r.ap["moving"] for r in done.objects}
    assert best["raw displacement"] == best["no uncertainty"] == best["Dewan-style"] == 1.0
    assert ap(done, "default") > ap(done, "default", "raw") + 0.3
    assert [a.idf1 for a in done.association] == [1.0, 1.0]


# ---- fields taken away


def constructed(rows):
    return known_map.known_map([(i, "chair", (2, 0, 0), 0.5, *rest, 0.0, 10, []) for i, *rest in rows])


def test_the_prior_alone_cannot_tell_movers_among_movables():
    still, moving = MotionClass.MOVABLE_STATIC, MotionClass.MOVING
    elements = constructed([(k, 0.8, moving if k < 2 else still, 5.0 if k < 2 else 0.9, 0.6, 5.0) for k in range(6)])
    truth = sc.query_truth(elements.motion_class == moving, elements.rho)
    s = Settings()
    assert element_average_precision(truth["moving"], sc.prior_only(elements).moving) == pytest.approx(2 / 6)
    assert element_average_precision(truth["moving"], sc.observed_only(elements, s).moving) == 1
    assert element_average_precision(truth["moving"], sc.whole(elements, s).moving) == 1


def test_observed_motion_alone_cannot_tell_still_movables():
    movable, static = MotionClass.MOVABLE_STATIC, MotionClass.STATIC
    rows = [(k, 0.9 if k < 2 else 0.1, movable if k < 2 else static, 0.9, 0.1, 0.9) for k in range(6)]
    elements, s = constructed(rows), Settings()
    truth = sc.query_truth(np.zeros(6, bool), elements.rho)
    assert element_average_precision(truth["movable"], sc.observed_only(elements, s).movable) == pytest.approx(2 / 6)
    assert element_average_precision(truth["movable"], sc.prior_only(elements).movable) == 1
    assert element_average_precision(truth["movable"], sc.whole(elements, s).movable) == 1


def test_another_prior_decides_the_classes_anew():
    elements, s = known_map.known_map(known_map.ROWS[:8]), Settings()
    same = sc.with_prior(elements, elements.rho, s)
    assert (same.rho == elements.rho).all()
    none = sc.with_prior(elements, np.zeros(8), s)
    assert MotionClass.MOVABLE_STATIC not in none.motion_class.tolist()
    assert (sc.with_prior(elements, np.ones(8), s).motion_class > 0).all()


def test_missing_rows_come_last_and_are_never_named():
    elements, s = known_map.known_map(known_map.ROWS[:8]), Settings()
    whole = sc.whole(elements, s)
    some = sc.taken(whole, np.array([3, -1, 0]))
    assert some.moving[1] < min(whole.moving.min(), some.moving[0]) and not any(yes[1] for yes in some.named.values())
    assert some.motion_class.tolist()[1] not in set(MotionClass)
    nothing = sc.taken(sc.whole(known_map.known_map(known_map.ROWS[:1]), s), np.array([-1, -1]))
    assert (nothing.moving == sc.LAST).all()


# ---- what is compared


@pytest.mark.parametrize("name", LEVERS)
def test_every_lever_changes_the_default(name):
    s = Settings()
    for one in LEVERS[name]:
        assert s.changed([one]) != s, one
    assert f"without {name}" in [p.name for p in plans(s, Comparison(levers=True))]


def test_levers_that_change_nothing_are_left_out():
    paper = [p.name for p in plans(PROFILES["paper"], Comparison(levers=True))]
    assert paper[0] == "paper" and "without row-linear ego" not in paper
    names = [p.name for p in plans(Settings.load(sets=["noise.scale=2"]), Comparison(profiles=True))]
    assert names == ["as set", "default", "paper", "paper, poses trusted"]


def test_profiles_keep_what_all_trials_share():
    s = Settings.load(sets=["objects.yolo_score=0.5", "keyframes.gap=5", "objects.crop_px=100", "seed=3"])
    for plan in plans(s, Comparison(profiles=True)):
        p = plan.settings
        assert (p.objects.yolo_score, p.keyframes.gap, p.objects.crop_px, p.seed) == (0.5, 5, 100, 3)


def test_sweeps():
    assert parse_sweeps(["a.b=1, 2,1", "a.b=3", "c=x"]) == (("a.b", ("1", "2", "3")), ("c", ("x",)))
    for text in ("", "a.b", "a.b=", "=1", "a.b=,"):
        with pytest.raises(InputError, match="--sweep"):
            parse_sweeps([text])

    def names(*texts):
        return [p.name for p in plans(Settings(), Comparison(sweeps=parse_sweeps(texts)))][1:]

    assert names("objects.quantile=0.5,0.9", "seed=1") == ["objects.quantile=0.5", "objects.quantile=0.9", "seed=1"]
    for text in ("keyframes.gap=1,6", "flow.dis_preset=medium", "objects.segmenter=none", "read.poses=none"):
        with pytest.raises(InputError, match="all trials share"):
            names(text)
    with pytest.raises(InputError, match=r"nearest is noise\.scale"):
        names("noise.scael=1")
    with pytest.raises(InputError):
        names("objects.quantile=2")


def test_pose_noise_is_parsed():
    assert parse_pose_noise("1.5,3") == (1.5, 3.0)
    for text in ("", "1", "1,2,3", "a,b", "-1,2", "1,nan", "180,0", "1,inf"):
        with pytest.raises(InputError, match="degrees and cm"):
            parse_pose_noise(text)


def test_poses_that_are_off_do_nothing_with_ego_refinement(little):
    done = evaluate([little], compare=Comparison(pose_noise=(1.5, 3.0)))
    off = "poses off by 1.5 deg, 3 cm"
    assert ap(done, f"default, {off}") == pytest.approx(ap(done, "default"), abs=0.03)
    assert ap(done, f"poses trusted, {off}") < ap(done, "poses trusted") - 0.1


def test_without_poses_what_needs_them_is_left_out(copied):
    (copied / "groundtruth.txt").unlink()
    done = evaluate([copied], compare=Comparison(profiles=True, levers=True))
    assert "paper" in {r.trial for r in done.pixels}
    assert not [r.trial for r in done.pixels if "trusted" in r.trial or r.trial == "without ego-refinement"]
    assert "no poses" in refused([copied], compare=Comparison(pose_noise=(1, 1)))
    assert "no poses" in refused([copied], settings=Settings.load(sets=["ego.model=off"]))


# ---- outputs


def test_runs_give_the_same_bytes(little, tmp_path):
    for name in ("a", "b"):
        evaluate([little], compare=Comparison(baselines=True), json=tmp_path / f"{name}.json", html=tmp_path / name)
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_the_json_says_all(judged):
    done, out = judged
    told = json.loads((out / "e.json").read_text(), parse_constant=lambda text: pytest.fail(text))
    (e,) = told["evaluations"]
    assert told["format"] == "vlmm-log evaluation" and e["title"] == "room"
    assert [r["trial"] for r in e["pixels"]] == [r.trial for r in done.pixels]
    assert e["pixels"][0]["ap"] == pytest.approx(done.pixels[0].ap, abs=1e-6)
    assert (e["logs"][0]["frames"], e["logs"][0]["pairs"]) == (FRAMES, FRAMES - GAP)
    assert to_json([done]) == (out / "e.json").read_text()


def test_the_page_needs_nothing_else(judged):
    text = (judged[1] / "e.html").read_text()
    links = re.findall(r"(?:src|href)\s*=\s*[\"']?([^\"'\s>]+)", text)
    assert links and all(link.startswith(("#", "data:")) for link in links)
    assert not re.search(r"<script|@import|url\(\s*[\"']?(?!data:|#)", text)
    assert "Khronos-style" in text and "Worst frames" in text


def test_recordings_of_what_scores_pixels(judged):
    _, out = judged
    names = {p.stem for p in (out / "rec").iterdir()}
    assert names == {"default", "paper", "paper_poses_trusted", "identities_withheld", "dewan_style", "khronos_style"}
    for name in sorted(names):
        recording = open_recording(out / "rec" / f"{name}.rrd")
        assert recording.entities >= {"metrics/ap", "world/camera/image/outcome", "world/camera/image/truth"}, name
    found = vlmm_log.diff(out / "rec/default.rrd", out / "rec/paper.rrd")
    assert not found.same and found.first is not None
    assert found.first.stage == "matches"  # the flow is one and the same
    assert vlmm_log.diff(out / "rec/default.rrd", out / "rec/default.rrd").same


STAGES = {"without ego-refinement": "ego", "without coherence of flagged pixels": "aggregate", "map.tau_o=9": "map"}


def test_diff_names_the_stage_that_a_lever_belongs_to(little, tmp_path):
    evaluate([little], compare=Comparison(levers=True, sweeps=(("map.tau_o", ("9",)),)), recordings=tmp_path / "rec")
    for name, stage in (STAGES | {"without displacement noise": "matches"}).items():
        path = tmp_path / "rec" / f"{name.replace(' ', '_').replace('-', '_')}.rrd"
        assert vlmm_log.diff(tmp_path / "rec/default.rrd", path).first.stage == stage


def test_a_trial_is_what_process_does(little, tmp_path):
    evaluate([little], compare=Comparison(profiles=True), recordings=tmp_path / "rec")
    s = Settings.load("paper", sets=[f"objects.segmenter=masks:{little / 'truth/instances'}"])
    vlmm_log.process(little, rrd=tmp_path / "a.rrd", settings=s)
    found = vlmm_log.diff(tmp_path / "rec/paper.rrd", tmp_path / "a.rrd")
    assert {e.stage for e in found.entities} == {"judge"}
    assert not found.elements.changes and not found.settings


def test_what_exists_is_refused_before_the_first_pair(little, tmp_path):
    (tmp_path / "e.json").write_text("mine")
    (tmp_path / "rec").mkdir()
    (tmp_path / "rec/x.rrd").write_text("mine")
    seen_pairs = []

    def progress(done, total):
        seen_pairs.append(done)

    assert "--force" in refused([little], json=tmp_path / "e.json", progress=progress)
    assert "--force" in refused([little], recordings=tmp_path / "rec", progress=progress)
    assert "folder" in refused([little], recordings=tmp_path / "e.json", force=True, progress=progress)
    assert str(tmp_path / "none") in refused([little, tmp_path / "none"], progress=progress)
    assert not seen_pairs and (tmp_path / "e.json").read_text() == "mine"
    evaluate([little], json=tmp_path / "e.json", recordings=tmp_path / "rec", force=True)
    assert json.loads((tmp_path / "e.json").read_text())


def test_calibrated_probabilities_err_less(little, tmp_path):
    file = tmp_path / "c.json"
    fitted = evaluate([little], calibrate=file)
    assert [c.name for c in fitted.calibration if c.unit == "pixel"] == ["1 - p_stat"]
    done = evaluate([little], calibration=file)
    ece = {c.name: c.ece for c in done.calibration}
    assert ece["calibrated"] < min(0.02, ece["1 - p_stat"])
    assert ece["calibrated, of having moved"] < 0.01
    told = refused([little], calibration=file, settings=Settings.load(sets=["noise.scale=2"]))
    assert "noise.scale" in told and "fit it anew" in told
    file.write_text("{")
    assert "no calibration" in refused([little], calibration=file)


@pytest.mark.parametrize("profile", ["default", "paper"])
def test_maps_have_the_probabilities_that_were_fitted(little, tmp_path, profile):
    file = tmp_path / "c.json"
    s = Settings.load(profile, sets=[f"objects.segmenter=masks:{little / 'truth/instances'}"])
    evaluate([little], calibrate=file, settings=s)
    run = s.changed([f"calibration.file={file}"])
    vlmm_log.process(little, rrd=tmp_path / "a.rrd", map=tmp_path / "a.json", settings=run)
    elements = vlmm_log.load_map(tmp_path / "a.json").world.columns
    p = dict(zip(elements.labels, elements.p_moving.tolist(), strict=True))
    assert min(p["ball"], p["box"]) > 0.9 and max(p["wall"], p["shelf"]) < 0.1


# ---- damaged and odd


def edit(path, change):
    path.write_text(change(path.read_text()))


DAMAGES = {
    "no truth.json": lambda t: (t / "truth.json").unlink(),
    "truth.json empty": lambda t: (t / "truth.json").write_text(""),
    "truth.json a list": lambda t: (t / "truth.json").write_text("[]"),
    "no scene": lambda t: edit(t / "truth.json", lambda x: x.replace('"scene"', '"sc"')),
    "units 0": lambda t: edit(t / "truth.json", lambda x: x.replace("10000", "0")),
    "units nan": lambda t: edit(t / "truth.json", lambda x: x.replace("10000", "NaN")),
    "units text": lambda t: edit(t / "truth.json", lambda x: x.replace("10000", "null")),
    "no objects": lambda t: (t / "objects.csv").unlink(),
    "objects short": lambda t: (t / "objects.csv").write_text("id,name,movability,kind\n1\n"),
    "objects NUL": lambda t: (t / "objects.csv").write_bytes(b"id,name\0\n\xff\n"),
    "no poses": lambda t: (t / "poses.txt").unlink(),
    "poses empty columns": lambda t: (t / "poses.txt").write_text("1 2 3\n"),
    "poses nan": lambda t: edit(t / "poses.txt", lambda x: x.replace("0.", "nan", 1)),
    "quaternion 0": lambda t: (t / "poses.txt").write_text("1 0 0 0 0 0 0 0\n" * 6),
    "part poses short": lambda t: (t / "part_poses.csv").write_text("frame,part,tx\n0,1,2\n"),
    "part pose missing": lambda t: edit(
        t / "part_poses.csv", lambda x: "\n".join(line for line in x.splitlines() if not line.startswith("3,1,"))
    ),
    "parts lost": lambda t: (t / "parts/000001.png").unlink(),
    "parts empty": lambda t: (t / "parts/000001.png").write_bytes(b""),
    "depth damaged": lambda t: (t / "depth/000001.png").write_bytes(b"\x89PNG\r\n"),
    "instances damaged": lambda t: (t / "instances/000001.png").write_bytes(b"\x89PNG\r\n"),
    "other size": lambda t: write_masks(t / "parts", {1: np.zeros((60, 80))}),
    "colour": lambda t: write_masks(t / "parts", {1: np.zeros((120, 160, 3))}),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_damaged_truth_is_told_in_one_line(copied, name):
    DAMAGES[name](copied / "truth")
    told = refused([copied], segmenter="none")
    assert str(copied) in told


MASKS = {
    "none": (lambda t: None, "neither"),
    "other values": (lambda t: write_masks(t, {0: np.full((120, 160), 7)}), "0 static, 128 ignored, 255 moving"),
    "other size": (lambda t: write_masks(t, {0: np.zeros((60, 80))}), "images' size"),
    "colour": (lambda t: write_masks(t, {0: np.zeros((120, 160, 3))}), "one channel"),
    "other frames": (lambda t: write_masks(t, {77: np.zeros((120, 160))}), "no pair of it has a truth"),
    "damaged": (lambda t: write_masks(t, {0: 0}) or (t / "000000.png").write_bytes(b""), "one channel"),
}


@pytest.mark.parametrize("name", MASKS)
def test_unusable_masks_are_told_in_one_line(little, tmp_path, name):
    make, expected = MASKS[name]
    write_masks(tmp_path / "masks", {})
    make(tmp_path / "masks")
    assert expected in refused([little], truth=tmp_path / "masks", segmenter="none")


def test_an_error_on_the_way_keeps_readable_recordings(copied, tmp_path):
    (copied / "truth/parts/000002.png").unlink()
    assert "000002.png" in refused([copied], recordings=tmp_path / "rec")
    (kept,) = (tmp_path / "rec").iterdir()
    assert kept.name == "default.rrd.partial"
    shutil.copy(kept, tmp_path / "kept.rrd")
    assert "metrics/ap" in open_recording(tmp_path / "kept.rrd").entities


@pytest.mark.parametrize("value", [STATIC, IGNORE, MOVING])
def test_truth_of_one_kind(little, tmp_path, value):
    write_masks(tmp_path / "masks", {0: np.full((120, 160), value), 1: np.full((120, 160), value)})
    names = {"json": tmp_path / "e.json", "html": tmp_path / "e.html"}
    told = refused(
        [little], truth=tmp_path / "masks", segmenter="none", calibrate=tmp_path / "c.json", **names,
        recordings=tmp_path / "rec", compare=Comparison(baselines=True, association=True),
    )  # fmt: skip
    assert "nothing to fit" in told and "e.html" in told and not (tmp_path / "c.json").exists()
    row = json.loads((tmp_path / "e.json").read_text())["evaluations"][0]["pixels"][0]
    assert row["ap"] == (1.0 if value == MOVING else None)
    assert row["prevalence"] == {STATIC: 0.0, MOVING: 1.0, IGNORE: None}[value]
    page = (tmp_path / "e.html").read_text()
    assert "nan" not in re.sub(r"base64,[A-Za-z0-9+/=]*", "", page).lower().replace("nancy", "")
    assert (tmp_path / "rec/default.rrd").exists()


def test_a_log_shorter_or_longer_than_its_truth(copied, tmp_path):
    rows = (copied / "rgb.txt").read_text().splitlines()
    (copied / "rgb.txt").write_text("\n".join(rows[:5]) + "\n")  # 4 frames: one pair
    done = evaluate([copied], html=tmp_path / "e.html")
    assert (done.logs[0].pairs, done.logs[0].judged_pairs) == (1, 1)
    assert np.isnan(done.pixels[0].ap_interval).all()
    (copied / "rgb.txt").write_text("\n".join(rows) + "\n")
    edit(copied / "truth/poses.txt", lambda x: "\n".join(x.splitlines()[:5]) + "\n")
    assert evaluate([copied]).logs[0].judged_pairs == 2


def test_a_log_without_pairs(copied, tmp_path):
    rows = (copied / "rgb.txt").read_text().splitlines()
    (copied / "rgb.txt").write_text("\n".join(rows[:3]) + "\n")
    told = refused([copied], recordings=tmp_path / "rec", compare=Comparison(baselines=True))
    assert "fewer frames than the keyframe gap" in told or "no pair of frames" in told
    assert not list((tmp_path / "rec").iterdir())


def test_several_logs(little, copied, tmp_path):
    shutil.rmtree(copied / "truth")
    mask = np.zeros((120, 160), np.uint8)
    mask[:30] = MOVING
    write_masks(copied / "truth", {0: mask})  # pixels alone
    done = evaluate([copied, little], compare=ALL, recordings=tmp_path / "rec", html=tmp_path / "e.html")
    assert [e.judged_pairs for e in done.logs] == [1, 3] and done.pixels[0].pairs == 4
    assert done.things.elements == 4 and done.objects
    assert {p.name for p in (tmp_path / "rec").iterdir()} == {"log", "little"}
    assert "of several logs" in refused([little, copied], truth=little / "truth")


def test_the_same_log_twice(little, tmp_path):
    once = evaluate(str(little))
    twice = evaluate([little, little], recordings=tmp_path / "rec", html=tmp_path / "e.html")
    for name in ("ap", "scored_ap", "coverage", "recall", "far_flags"):
        assert getattr(twice.pixels[0], name) == getattr(once.pixels[0], name)
    assert twice.pixels[0].pairs == 2 * once.pixels[0].pairs
    assert twice.things.elements == 2 * once.things.elements
    assert len(list((tmp_path / "rec").rglob("default.rrd"))) == 2


@pytest.mark.parametrize("segmenter", ["none", "geometric"])
def test_a_segmenter_is_taken_at_its_word(little, tmp_path, segmenter):
    done = evaluate([little], segmenter=segmenter, compare=ALL, html=tmp_path / "e.html", json=tmp_path / "e.json")
    assert segmenter in done.settings
    if segmenter == "none":
        assert done.things.elements == 0 and done.things.missed == 4
        assert done.objects[0].decisions["moving"].recall == 0
    else:
        assert "masks" not in done.versions
        assert done.things.elements != 4 or done.association[0].idf1 < 1
    json.loads((tmp_path / "e.json").read_text(), parse_constant=lambda text: pytest.fail(text))


@pytest.mark.parametrize(
    "sets", [["keyframes.gap=1"], ["keyframes.gap=0.1s"], ["keyframes.stride=2"], ["ego.model=off"], ["log.dense=true"]]
)
def test_other_settings(little, tmp_path, sets):
    s = Settings.load(sets=sets)
    done = evaluate(
        [little], settings=s, compare=Comparison(profiles=True, baselines=True), recordings=tmp_path / "rec"
    )
    assert done.pixels[0].trial == ("as set" if sets == ["ego.model=off"] else "default")
    assert all(0 <= r.ap <= 1 for r in done.pixels)


def test_profile_paper(little, tmp_path):
    compare = Comparison(profiles=True, levers=True, baselines=True)
    done = evaluate([little], settings=PROFILES["paper"], compare=compare, html=tmp_path / "e.html")
    assert [done.pixels[0].trial, done.pixels[2].trial] == ["paper", "default"]


def test_a_very_small_image(tmp_path):
    write_small_room(tmp_path / "tiny", stride=10)
    done = evaluate([tmp_path / "tiny"], compare=ALL, html=tmp_path / "e.html", recordings=tmp_path / "rec")
    assert done.pixels[0].pixels == 3 * 64 * 48


NAMES = ["[bold]x[/bold]", HOSTILE[:100], "a\u202eb", "$\\frac{$ & y"]


@pytest.mark.parametrize("name", NAMES)
def test_odd_names(little, tmp_path, name, capsys):
    from vlmm_log.commands.evaluate import print_evaluation

    log = shutil.copytree(little, tmp_path / name.replace("/", "_"))
    labels = [f"1 {name}", "2 ball", f"3 {name}", "4 box"]
    (log / "truth/instances/labels.txt").write_text("\n".join(labels) + "\n")
    done = evaluate([log], compare=ALL, html=tmp_path / "e.html", json=tmp_path / "e.json", recordings=tmp_path / "rec")
    page = (tmp_path / "e.html").read_text()
    live, text = read_page(page)
    assert live == [] and log.name in text
    print_evaluation(done)
    told = capsys.readouterr().out
    assert "\u202e" not in told
    if "bold" in name:
        assert "[bold]x[_bold]" in told
