"""Probabilities of motion, from a file's curves to images, maps, recordings and queries; what a judged run records."""

import dataclasses
import itertools
import json
from pathlib import Path

import numpy as np
import pytest
from command_line import command
from hypothesis import given
from hypothesis import strategies as st

import render_room
import vlmm_log
from known_maps import bits, element, kitchen, saved, world
from vlmm_log.calibration import Calibration, Curve, deciding
from vlmm_log.compare import diff
from vlmm_log.elements import class_posterior
from vlmm_log.entries import Labels, Raster, Scalar, Table
from vlmm_log.maps import load_map, save_map
from vlmm_log.models.load import load_models
from vlmm_log.pipeline.fusion import motion_evidence
from vlmm_log.pipeline.posterior import posterior
from vlmm_log.protocols import Moment
from vlmm_log.recording import open_recording
from vlmm_log.recording.map import read_map
from vlmm_log.settings import Settings
from vlmm_log.sinks.mcap import McapFile, load_dialect
from vlmm_log.sinks.memory import Memory
from vlmm_log.sinks.recorder import Recorder
from vlmm_log.sinks.recorder import open_recording as begin
from vlmm_log.sinks.rerun import RerunFile
from vlmm_log.types import (
    FramePair,
    InputError,
    Judgement,
    Motion,
    Outcome,
    Posterior,
    Run,
    RunEnd,
)

IMAGE = "world/camera/image"
P_MOVING = f"{IMAGE}/residual/p_moving"
PIXEL = Curve(np.array([0.5, 2.0, 2.0001, 8.0]), np.array([0.01, 0.1, 0.6, 0.99]))
ELEMENT = Curve(np.array([0.2, 0.9, 1.6]), np.array([0.02, 0.3, 0.97]))


def curves():
    knots = st.lists(st.floats(0, 100), min_size=1, max_size=12, unique=True)
    return knots.flatmap(
        lambda x: st.lists(st.floats(0, 1), min_size=len(x), max_size=len(x)).map(
            lambda p: Curve(np.sort(np.array(x)), np.sort(np.array(p)))
        )
    )


def motion(d_m):
    nothing = np.zeros(d_m.shape, np.uint8)
    return Motion(np.zeros((3, *d_m.shape), np.float32), d_m, d_m, nothing, 2.8, lambda stride: None)


def write(path, s, *, element=ELEMENT, **settings):
    fitted = {**deciding(s), **settings}
    told = Calibration(PIXEL, element, fitted, ("kitchen 1 (ab12)",), 2.41, (0.0013, 0.002))
    path.write_text(told.to_json())
    return path


# ---- curves


@given(curves(), st.lists(st.floats(0, 1e4, width=32), max_size=40))
def test_pixels_follow_the_curve_rise_with_it_and_nan_stays(curve, scores):
    d_m = np.sort(np.array([*scores, 0.0, *curve.x], np.float32))
    d_m = np.append(d_m, np.float32("nan"))[None]
    p = posterior(motion(d_m), curve).p_moving
    assert p.dtype == np.float32 and p.shape == d_m.shape
    assert np.isnan(p[0, -1])
    steep = np.diff(curve.p) / np.maximum(np.diff(curve.x), 1e-300)  # beyond it, half a float32's step of d_M decides
    if steep.size == 0 or steep.max() < 1e3:
        assert np.nanmax(np.abs(p - curve(d_m))) < 0.01
    assert (np.diff(p[0, :-1]) >= -1e-6).all()
    assert curve.p[0] - 1e-6 <= p[0, :-1].min() and p[0, :-1].max() <= curve.p[-1] + 1e-6


@given(st.lists(st.tuples(st.booleans(), st.floats(0, 1e6)), min_size=1), st.floats(0, 5))
def test_motion_evidence_puts_what_moved_first(rows, tau_o):
    has_moved, score = (np.array(column) for column in zip(*rows, strict=True))
    evidence = motion_evidence(has_moved, score, tau_o)
    assert ((evidence >= has_moved) & (evidence <= has_moved + 1)).all()
    order = np.argsort(score, kind="stable")
    for one in (has_moved, ~has_moved):
        assert (np.diff(evidence[order][one[order]]) >= 0).all()


def test_the_classes_share_all_probability():
    p, rho = np.array([0.9, 0.1, np.nan], np.float32), np.array([0.3, 0.8, 0.5])
    shares = class_posterior(p, rho)
    assert shares[:, 1] == pytest.approx([0.9 * 0.2, 0.9 * 0.8, 0.1])
    assert shares.sum(axis=0)[:2] == pytest.approx(1)
    assert np.isnan(shares[:, 2]).all()


# ---- refused


def refused(path, s):
    with pytest.raises(InputError) as e:
        load_models(dataclasses.replace(s, calibration=dataclasses.replace(s.calibration, file=str(path))))
    assert "\n" not in str(e.value) and str(path) in str(e.value)
    return str(e.value)


def test_other_settings_than_it_was_fitted_with_are_refused(tmp_path):
    s = vlmm_log.Settings()
    file = write(tmp_path / "c.json", s)
    there = dataclasses.replace(s, calibration=dataclasses.replace(s.calibration, file=str(file)))
    models, versions = load_models(there)
    assert models.calibration.pixel.x.tolist() == PIXEL.x.tolist()
    assert versions["calibration"].startswith("c.json sha256:")
    told = refused(file, s.changed(["noise.scale=0.7"]))
    assert "fitted with noise.scale = 1, this run has 0.7; fit it anew or --set noise.scale=1" in told
    assert "(2 more differ)" in refused(file, s.changed(["keyframes.gap=0.1s", "noise.scale=2", "map.tau_o=3"]))
    assert "fitted with keyframes.gap = 3, this run has 0.1s" in refused(file, s.changed(["keyframes.gap=0.1s"]))
    assert "fitted with tracks." in refused(file, s.changed([f"tracks.{next(iter(vars(s.tracks)))}=0.123"]))
    write(file, s, **{"noise.scale": 1})  # an integer is the same number
    assert load_models(there)[0].calibration is not None
    write(file, s, **{"noise.of_another_version": 1})
    assert "fitted with noise.of_another_version, by another version; fit it anew" in refused(file, s)
    assert "no calibration" in refused(tmp_path / "none.json", s)
    file.write_text("{}")
    assert "--calibrate" in refused(file, s)


def test_settings_that_decide_no_score_may_differ(tmp_path):
    s = vlmm_log.Settings()
    file = write(tmp_path / "c.json", s)
    other = s.changed(["query.near_m=2", "read.stop_s=3", f"calibration.file={file}", "log.dense=true"])
    assert load_models(other)[0].calibration is not None


# ---- map files


@pytest.mark.parametrize("suffix", ["json", "parquet"])
def test_map_files_keep_it_and_those_without_it_are_as_ever(tmp_path, suffix):
    plain, path = kitchen(), tmp_path / f"map.{suffix}"
    some = dict(plain.world.elements)
    some[7] = dataclasses.replace(some[7], p_moving=0.1 + 0.2)
    calibrated = dataclasses.replace(plain, world=dataclasses.replace(plain.world, elements=some))
    save_map(path, calibrated, force=True)
    assert bits(load_map(path)) == bits(calibrated)
    assert np.isnan(load_map(path).world.elements[4].p_moving)
    save_map(path, plain, force=True)
    assert b"p_moving" not in path.read_bytes()
    assert np.isnan(load_map(path).world.columns.p_moving).all()
    wrong = world([dataclasses.replace(element(1), p_moving=1.5)])
    with pytest.raises(InputError, match="p_moving: is no probability"):
        save_map(path, saved(wrong), force=True)


# ---- runs


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs") / "room"
    render_room.write_tum(folder, 9)
    return folder


@pytest.fixture(scope="module")
def run(room, tmp_path_factory):
    """A calibrated run with everything written, and what a sink saw."""
    out = tmp_path_factory.mktemp("out")
    s = vlmm_log.Settings.load(sets=[f"objects.segmenter=masks:{room / 'masks'}"])
    file = write(out / "curves.json", s)
    s, memory = s.changed([f"calibration.file={file}"]), Memory()
    outputs = {"rrd": out / "a.rrd", "mcap": out / "a.mcap", "map": out / "a.json"}
    done = vlmm_log.process(room, **outputs, settings=s, sinks=[memory], queries=["p_moving above 0.9"])
    file.unlink()  # recordings do not need it
    return done, out, memory


@pytest.fixture(scope="module")
def uncalibrated(room, tmp_path_factory):
    out = tmp_path_factory.mktemp("plain")
    s = vlmm_log.Settings.load(sets=[f"objects.segmenter=masks:{room / 'masks'}"])
    vlmm_log.process(room, rrd=out / "a.rrd", mcap=out / "a.mcap", settings=s, queries=["p_moving above 0.9"])
    return out / "a.rrd"


def values(path, *entities):
    return list(open_recording(path).entries(entities))


def test_the_image_of_a_run_is_the_curve_of_its_scores(run):
    _, out, memory = run
    results = [r for _, r in memory.seen if isinstance(r, Motion | Posterior)]
    pairs = list(zip(results[::2], results[1::2], strict=True))
    assert len(pairs) == 6
    for seen, found in pairs:
        assert np.nanmax(np.abs(found.p_moving - PIXEL(seen.d_m))) < 0.01
        assert (np.isnan(found.p_moving) == np.isnan(seen.d_m)).all()
    for file in ("a.rrd", "a.mcap"):
        told = [e.value for e in values(out / file, P_MOVING) if isinstance(e.value, Raster)]
        rasters = [value.values.astype(np.float32) for value in told]
        assert len(rasters) == 6
        for raster, (_, found) in zip(rasters, pairs, strict=True):
            assert raster == pytest.approx(found.p_moving[::2, ::2], abs=1e-3, nan_ok=True)


def test_elements_have_it_in_the_map_the_file_and_the_recordings(run):
    done, out, _ = run
    elements = done.map.world.elements.values()
    p = {e.label: e.p_moving for e in elements}
    assert min(p["ball"], p["box"]) > 0.9 > p["shelf"]
    for e in elements:
        evidence = motion_evidence(e.label != "shelf", e.o, Settings().map.tau_o)
        assert e.p_moving == float(ELEMENT(evidence))
    for file in ("a.rrd", "a.mcap", "a.json"):
        read = read_map(out / file) if file != "a.json" else load_map(out / file)
        assert bits(read.world.columns) == bits(done.map.world.columns)
    last = [e.value for e in values(out / "a.rrd", "world/map/elements") if isinstance(e.value, Table)][-1].columns
    total = sum(np.asarray(last[name]) for name in ("p_moving", "p_static", "p_movable_static"))
    assert total == pytest.approx(1)


def test_queries_compare_and_order_by_it(run, room):
    done, out, _ = run
    movers = sorted(e.id for e in done.map.world.elements.values() if e.label != "shelf")
    assert sorted(done.answers[0].ids.tolist()) == movers
    for file in ("a.rrd", "a.mcap", "a.json"):
        assert sorted(vlmm_log.query(out / file, "p_moving above 0.9").ids.tolist()) == movers
        answer = vlmm_log.query(out / file, "things ranked by p_moving ascending")
        assert answer.ids[0] not in movers
        assert vlmm_log.query(out / file, "p_moving above 0.9").reasons[0].startswith("p_moving 0.9")


def test_it_is_told_where_the_curves_come_from(run):
    done, out, _ = run
    told = "calibration: fitted on kitchen 1 (ab12); static d_M^2 2.41 (2.366 expected); its sensor's sigma_z a 0.0013"
    assert [line for line in done.end.told if line.startswith(told)]
    assert any(e.value.text.startswith(told) for e in values(out / "a.rrd", "log"))
    assert done.run.versions["calibration"].startswith("curves.json sha256:")
    assert "curves.json" in done.run.settings


def test_both_containers_hold_the_same_and_diff_names_the_stage(run, uncalibrated):
    out = run[1]
    assert diff(out / "a.rrd", out / "a.mcap").same
    done = diff(uncalibrated, out / "a.rrd")
    assert {s.stage for s in done.stages} == {"map", "query"}  # what both measured is the same
    assert "p_moving" in done.elements.changes[0].told
    (only,) = [e for e in done.entities if e.entity == P_MOVING]
    assert only.stage == "posterior" and len(only.only_b) == 6


def test_without_a_calibration_nothing_of_it_is_recorded(uncalibrated):
    for path in (uncalibrated, uncalibrated.with_suffix(".mcap")):
        entities = open_recording(path).entities
        assert not {name for name in entities if "p_moving" in name and "query" not in name}
        assert not entities & {f"{IMAGE}/truth", f"{IMAGE}/outcome", f"{IMAGE}/score", "stats/stage_ms/posterior"}
        tables = [e.value.columns for e in values(path, "world/map/elements", "digests") if isinstance(e.value, Table)]
        assert not any("p_moving" in columns for columns in tables)
        assert not any("posterior" in columns.get("stage", ()) for columns in tables)
    assert not vlmm_log.query(uncalibrated, "p_moving above 0.0").matches


# ---- judged runs


def judgement(rng, H=12, W=16):
    score = rng.gamma(1.0, 2.0, (H, W)).astype(np.float32)
    score[rng.random((H, W)) < 0.2] = np.nan
    truth = rng.choice(np.array([0, 128, 255], np.uint8), (H, W))
    outcome = rng.choice(np.array(list(Outcome), np.uint8), (H, W))
    return Judgement(truth, outcome, score, {"average_precision": 0.75, "recall": 0.5})


@pytest.mark.parametrize("dialect", ["rrd", "ros2", "foxglove"])
@pytest.mark.parametrize("dense", [False, True])
def test_judgements_come_back(room, tmp_path, dialect, dense):
    if dialect == "foxglove":
        pytest.importorskip("foxglove", reason="needs the extra 'foxglove'")
    told = Run("room", "tum", vlmm_log.Settings().to_toml(), {"vlmm-log": "0"}, True, "+z", ())
    path = tmp_path / ("judged.rrd" if dialect == "rrd" else "judged.mcap")
    opened = begin(path, lambda p: RerunFile(p, told) if dialect == "rrd" else McapFile(p, told, load_dialect(dialect)))
    recorder, rng = Recorder([opened], dense=dense), np.random.default_rng(0)
    frames = [f for f in vlmm_log.open_log(room).frames(0, 10**18) if hasattr(f, "rgb")]
    judged = {}
    for frame, second in itertools.pairwise(frames[:4]):
        at = Moment(frame.stamp_ns, frame.index, 1.0)
        judged[frame.index] = judgement(rng)
        recorder.write(FramePair(frame, second), at)
        recorder.write(judged[frame.index], at)
    recorder.close(RunEnd(True, "", 4, 3))
    names = (f"{IMAGE}/truth", f"{IMAGE}/outcome", f"{IMAGE}/score", "metrics/recall", "metrics/average_precision")
    assert open_recording(path).entities >= {*names, "stats/stage_ms/judge"}
    read = [e for e in values(path, *names) if isinstance(e.value, Labels | Raster | Scalar)]
    assert len(read) == 3 * len(names)
    for e in read:
        was = judged[e.index]
        match e.entity.rsplit("/", 1)[-1]:
            case "truth":
                assert (e.value.values == was.truth).all()
            case "outcome":
                assert (e.value.values == was.outcome).all()
            case "score":
                assert e.value.values == pytest.approx(was.score, rel=0 if dense else 1e-3, nan_ok=True)
            case name:
                assert e.value.value == was.figures[name]
    stages = [e.value.columns["stage"] for e in values(path, "digests") if isinstance(e.value, Table)]
    assert stages == [("input", "judge")] * 3


# ---- the command line


def test_the_command_takes_a_file_and_refuses_another_s(room, tmp_path):
    file = write(tmp_path / "curves.json", vlmm_log.Settings())
    done = command("process", room, "--calibration", file, "--rrd", "a.rrd", "--map", "a.json", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert any(note.startswith("calibration: fitted on kitchen 1") for note in told["notes"])
    assert told["figures"]["posterior_ms"] > 0
    asked = command("query", "a.json", "p_moving above 0.0", "--json", cwd=tmp_path)
    assert asked.returncode == 0, asked.stderr
    assert 0 <= json.loads(asked.stdout)["answers"][0]["p_moving"] <= 1
    for options, line in (
        (["--set", "noise.scale=0.7"], "fitted with noise.scale = 1, this run has 0.7"),
        (["--profile", "paper"], "more differ"),
    ):
        no = command("process", room, "--calibration", file, "--rrd", "b.rrd", *options, cwd=tmp_path)
        assert no.returncode == 2 and line in no.stderr and len(no.stderr.splitlines()) == 1
    no = command("process", room, "--calibration", "none.json", "--rrd", "b.rrd", cwd=tmp_path)
    assert no.returncode == 2 and "none.json: no calibration" in no.stderr
    assert sorted(p.name for p in Path(tmp_path).iterdir()) == ["a.json", "a.rrd", "curves.json"]
