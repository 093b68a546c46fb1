"""Whole runs with objects: the map they make, what recordings keep of it, queries over both."""

import dataclasses
import json
import os
import re
import shutil
import subprocess
import sys

import numpy as np
import pytest
from command_line import command

import render_room
import vlmm_log
from known_maps import bits, evidence, observations
from vlmm_log.ask import Questions, find, parse
from vlmm_log.background import empty_background
from vlmm_log.elements import MotionClass, Movability, WorldMap
from vlmm_log.maps import load_map, save_map
from vlmm_log.models.load import load_models
from vlmm_log.models.words import Words
from vlmm_log.pipeline.fusion import fuse
from vlmm_log.pipeline.run import Tally, empty_world, keyframe_pairs, step
from vlmm_log.pipeline.world_map import merge_evidence
from vlmm_log.recording.map import read_map, read_masks
from vlmm_log.settings import MapSettings
from vlmm_log.sinks.map_entries import slug
from vlmm_log.sinks.memory import Memory
from vlmm_log.types import InputError

QUERIES = ("the box that slides", "things that never moved")


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs") / "room"
    render_room.write_tum(folder, 9)
    return folder


def settings(room, *sets):
    return vlmm_log.Settings.load(sets=[f"objects.segmenter=masks:{room / 'masks'}", *sets])


@pytest.fixture(scope="module")
def run(room, tmp_path_factory):
    """A run with everything written: what ``process`` gave, the recording, the map file."""
    out = tmp_path_factory.mktemp("out")
    done = vlmm_log.process(room, rrd=out / "room.rrd", map=out / "room.json", queries=QUERIES, settings=settings(room))
    return done, out / "room.rrd", out / "room.json"


def test_the_map_tells_movers_from_the_rest(run):
    elements = {e.label: e for e in run[0].map.world.elements.values()}
    assert elements.keys() == {"ball", "shelf", "box"}
    assert {name: e.id for name, e in elements.items()} == {"ball": 1, "shelf": 2, "box": 3}  # the masks' identities
    for name in ("ball", "box"):
        assert elements[name].motion_class is MotionClass.MOVING
        assert len(elements[name].intervals) == 1
        truth = np.linalg.norm(render_room.SPEED[elements[name].id])
        assert elements[name].speed == pytest.approx(truth, rel=0.25)
    assert elements["shelf"].motion_class is MotionClass.STATIC
    assert not elements["shelf"].intervals.size


def test_the_map_is_the_same_whoever_watches(room, run, tmp_path):
    memory = Memory()
    alone = vlmm_log.process(room, sinks=[memory], settings=settings(room))
    save_map(tmp_path / "alone.json", alone.map, force=False)
    assert (tmp_path / "alone.json").read_bytes() == run[2].read_bytes()


def test_the_map_does_not_depend_on_the_order_of_pairs_where_identities_are_given(room, run):
    s = settings(room)
    models, _ = load_models(s)
    log = vlmm_log.open_log(room)
    pairs = [p for p in keyframe_pairs(log.frames(0, 10**18), s, Tally()) if hasattr(p, "first")]
    world = empty_world(s, has_poses=True)
    for k in (3, 0, 5, 2, 1, 4):
        world = step(pairs[k], world, models, s)
    assert len(pairs) == 6
    assert bits(world.map.columns) == bits(run[0].map.world.columns)


def test_a_map_file_comes_back(run):
    saved = load_map(run[2])
    assert bits(saved.world.columns) == bits(run[0].map.world.columns)
    assert saved.run == run[0].run and saved.end == run[0].end
    assert saved.origin_ns == run[0].map.origin_ns


def test_a_recording_holds_its_map(run):
    saved = read_map(run[1])
    assert bits(saved.world.columns) == bits(run[0].map.world.columns)
    for i, e in run[0].map.world.evidence.items():
        assert saved.world.evidence[i].observations.tobytes() == e.observations.tobytes()
    assert saved.world.background.cells.tobytes() == run[0].map.world.background.cells.tobytes()
    assert (saved.run, saved.end, saved.origin_ns) == (run[0].run, run[0].end, run[0].map.origin_ns)
    assert saved.T_world_cam == pytest.approx(run[0].map.T_world_cam, abs=1e-6)


def test_the_recording_shows_every_query_at_every_pair(run):
    from rerun.chunk import RrdReader

    rows = {}
    for chunk in RrdReader(str(run[1])).store().stream():
        if not chunk.is_static:
            rows[chunk.entity_path] = rows.get(chunk.entity_path, 0) + chunk.num_rows
    for name in ("the_box_that_slides", "things_that_never_moved"):
        assert rows[f"/world/map/query/{name}"] == 6
        assert rows[f"/world/camera/image/query/{name}"] == 6
    assert {f"/world/map/elements/{i}" for i in (1, 2, 3)} <= rows.keys()


def test_the_closing_answers_are_those_of_the_map(run):
    done, rrd, saved = run
    slides, still = done.answers
    assert slides.ids.tolist() == [3] and still.ids.tolist() == [2]
    for source in (rrd, saved, done.map):
        assert vlmm_log.query(source, QUERIES[0]).ids.tolist() == [3]
        assert vlmm_log.query(source, QUERIES[1]).reasons == still.reasons


def test_masks_of_a_recording_are_the_logs(room, run):
    import cv2

    seen = sorted(read_masks(run[1]), key=lambda row: row[0])
    assert [index for index, _, _ in seen] == [0, 1, 2, 3, 4, 5]
    for index, _, labels in seen:
        assert (labels == cv2.imread(str(room / f"masks/{index:06d}.png"), cv2.IMREAD_UNCHANGED)).all()


def test_hits_open_with_the_recording(run, tmp_path):
    from rerun.chunk import RrdReader

    found = find(run[1], QUERIES[0], rrd=tmp_path / "hits.rrd", grid=tmp_path / "grid.npz")
    assert found.outputs == (tmp_path / "grid.npz", tmp_path / "hits.rrd")
    hits, whole = (RrdReader(str(p)).recordings()[0] for p in (tmp_path / "hits.rrd", run[1]))
    assert (hits.application_id, hits.recording_id) == (whole.application_id, whole.recording_id)
    paths = {
        c.entity_path: c.num_rows for c in RrdReader(str(tmp_path / "hits.rrd")).store().stream() if not c.is_static
    }
    assert paths["/world/camera/image/query/the_box_that_slides"] == 6
    with np.load(tmp_path / "grid.npz", allow_pickle=False) as grid:
        assert set(np.unique(grid["element_id"])) == {-1, 3}
    with pytest.raises(InputError, match="--force"):
        find(run[1], QUERIES[0], rrd=tmp_path / "hits.rrd")


def test_masks_of_the_answers_are_written(run, room, tmp_path):
    import cv2

    found = find(run[1], QUERIES[0], masks=tmp_path / "masks")
    assert found.outputs == (tmp_path / "masks",)
    for index in range(6):
        own = cv2.imread(str(room / f"masks/{index:06d}.png"), cv2.IMREAD_UNCHANGED)
        hit = cv2.imread(str(tmp_path / f"masks/{index:06d}.png"), cv2.IMREAD_UNCHANGED)
        assert (hit == 255 * (own == 3)).all()
    with pytest.raises(InputError, match="--force"):
        find(run[1], QUERIES[0], masks=tmp_path / "masks")
    with pytest.raises(InputError, match="a map file holds no masks"):
        find(run[2], QUERIES[0], masks=tmp_path / "more")
    with pytest.raises(InputError, match="masks: exists; give --force"):  # before anything else is written
        find(run[1], QUERIES[0], masks=tmp_path / "masks", rrd=tmp_path / "hits.rrd")
    assert not (tmp_path / "hits.rrd").exists()
    (tmp_path / "out").mkdir()
    (tmp_path / "out/file").write_text("")
    os.mkfifo(tmp_path / "out/pipe")
    for name, told in (
        ("file", "file: is no folder; name a folder"),
        ("pipe", "pipe: is no folder; name a folder"),
        ("x" * 300, "cannot be written"),
        (".", "hits.rrd, which the run needs"),  # it is written there
    ):
        with pytest.raises(InputError, match=told):
            find(run[1], QUERIES[0], masks=tmp_path / "out" / name, rrd=tmp_path / "out/hits.rrd", force=True)
    about = json.loads((tmp_path / "masks/query.json").read_text())
    assert (about["query"], about["ids"]) == (QUERIES[0], [3])
    assert about["map"]["end"]["input_hash"]
    (tmp_path / "masks/000099.png").write_bytes(b"of an earlier run")
    with pytest.raises(InputError, match="holds other things"):
        vlmm_log.convert(room, tmp_path / "masks", force=True)
    find(run[1], QUERIES[0], masks=tmp_path / "masks", force=True)
    written = {path.name for path in (tmp_path / "masks").iterdir()}
    assert written == {"query.json", *(f"{k:06d}.png" for k in range(6))}
    (tmp_path / "masks/query.json").unlink()
    with pytest.raises(InputError, match="holds other things"):  # a user's own
        find(run[1], QUERIES[0], masks=tmp_path / "masks", force=True)
    assert (tmp_path / "masks/000000.png").exists()


def test_elements_histories_are_states(run):
    from rerun.chunk import RrdReader

    states = {}
    for chunk in RrdReader(str(run[1])).store().stream().filter(content="/world/map/elements/**"):
        batch = chunk.to_record_batch()
        if "StateChange:state" in batch.schema.names:
            rows = zip(batch["frame"].to_pylist(), batch["StateChange:state"].to_pylist(), strict=True)
            states.setdefault(chunk.entity_path, []).extend(rows)
    assert sorted(states["/world/map/elements/3"]) == [(2, ["moving", "moves"])]
    assert states["/world/map/elements/2"] == [(2, ["static", "still"])]


def test_queries_that_differ_in_signs_have_entities_of_their_own():
    texts = ("rho >= 0.8", "rho <= 0.8", "the box", "The box", "\u6905\u5b50", "\u684c\u5b50", "the_box", "!!!")
    assert len({slug(text) for text in texts}) == len(texts)
    assert slug("the box that slides") == "the_box_that_slides"
    assert all(re.fullmatch(r"[a-z0-9_]+", slug(text)) for text in texts)


def test_the_label_that_won_is_what_a_query_sees():
    """The largest view was once called a dog; the element is a chair."""
    chair = merge_evidence(
        evidence(1, "chair", seen=observations(10), pixels=500),
        evidence(1, "dog", seen=observations(1, start_ns=10**18), pixels=600),
    )
    embed = Words()
    features = embed.labels(["dog"])[0]
    chair = dataclasses.replace(chair, votes={"chair": 9000, "dog": 900}, feature=features)
    world = fuse(
        WorldMap({1: chair}, {}, (empty_background(0.05),), (1,)), lambda label: Movability(0.5, "test"), MapSettings()
    )
    queries, _ = parse(["chairs", "dogs"], vlmm_log.Settings())
    questions = Questions(queries, embed, vlmm_log.Settings().query, MapSettings(), "+z")
    chairs, dogs = questions.answers(world.columns, None, 0)
    assert chairs.ids.tolist() == [1] and not dogs.ids.size


def test_poses_that_begin_late_keep_the_pairs_before_out_of_the_map(room, run, tmp_path):
    late = tmp_path / "room"
    shutil.copytree(room, late)
    lines = (late / "groundtruth.txt").read_text().splitlines()
    (late / "groundtruth.txt").write_text("\n".join(lines[:1] + lines[5:]) + "\n")  # frames 0 to 3 have none
    done = vlmm_log.process(late, settings=settings(room))
    assert done.summary.skipped["no pose yet: not in the map"] == 1  # pair 0 to 3; 1 to 4 sees the first pose
    whole = run[0].map.world.elements
    for i, e in done.map.world.elements.items():
        assert e.position == pytest.approx(whole[i].position, abs=0.05)


def test_a_map_as_ply_without_open3d_is_refused_before_the_run(room, tmp_path, monkeypatch):
    monkeypatch.setattr("vlmm_log.run_outputs.find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"vlmm-log\[sim\]"):
        vlmm_log.process(room, rrd=tmp_path / "a.rrd", map=tmp_path / "a.ply", settings=settings(room))
    assert not list(tmp_path.iterdir())


def test_a_recording_whose_writer_was_killed_holds_the_map_so_far(room, run, tmp_path):
    code = """
import os, sys, vlmm_log
import vlmm_log.sinks.rerun as sink
sink.FLUSHED = 2
def tell(done, expected):
    if done == 5: os._exit(9)
s = vlmm_log.Settings.load(sets=["objects.segmenter=masks:" + sys.argv[1] + "/masks"])
vlmm_log.process(sys.argv[1], rrd=sys.argv[2], settings=s, progress=tell)
"""
    subprocess.run([sys.executable, "-c", code, room, tmp_path / "room.rrd"], cwd=tmp_path, check=False)
    assert not (tmp_path / "room.rrd").exists()
    saved = read_map(tmp_path / "room.rrd.partial")
    assert not saved.end.complete
    seen = {i: e.observations for i, e in saved.world.evidence.items()}
    assert 3 <= max(o.size for o in seen.values()) <= 5
    whole = run[0].map.world.evidence
    for i, o in seen.items():
        assert o.tobytes() == whole[i].observations[: o.size].tobytes()


def test_a_recording_that_was_cut_off_is_read_as_far_as_it_goes(run, tmp_path):
    data = run[1].read_bytes()
    (tmp_path / "cut.rrd").write_bytes(data[: len(data) * 3 // 4])
    saved = read_map(tmp_path / "cut.rrd")
    repair = ["-m", "rerun_cli", "rrd", "optimize", tmp_path / "cut.rrd", "-o", tmp_path / "whole.rrd"]
    subprocess.run([sys.executable, *repair], check=True, capture_output=True)
    repaired = read_map(tmp_path / "whole.rrd")
    assert not saved.end.complete and saved.world.evidence
    assert saved.world.evidence.keys() == repaired.world.evidence.keys()


def test_outputs_that_collide_are_refused_before_the_run(room, run, tmp_path):
    for names in ({"rrd": "a.json", "map": "a.json"}, {"rrd": "a.json.partial", "map": "a.json"}):
        with pytest.raises(InputError, match="two outputs"):
            vlmm_log.process(room, **{k: tmp_path / v for k, v in names.items()}, settings=settings(room))
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        vlmm_log.process(room, map=tmp_path / "file/a.json", settings=settings(room))
    with pytest.raises(InputError, match="cannot be written"):
        vlmm_log.process(room, map=tmp_path / f"{'a' * 250}.json", settings=settings(room))
    assert [p.name for p in tmp_path.iterdir()] == ["file"]
    copy = tmp_path / "copy.rrd"
    shutil.copy(run[1], copy)
    for outputs in ({"rrd": copy}, {"rrd": tmp_path / "x", "grid": tmp_path / "x"}):
        with pytest.raises(InputError, match=r"is the input|two outputs"):
            find(copy, QUERIES[0], **outputs, force=True)
    assert copy.read_bytes() == run[1].read_bytes()


def test_a_finished_map_does_not_follow_other_thresholds(run):
    with pytest.raises(InputError, match="process the log again"):
        vlmm_log.query(run[2], QUERIES[0], sets=["map.tau_o=50"])
    assert not vlmm_log.query(run[2], QUERIES[0], sets=["query.threshold=0.99"]).ids.size


def test_an_interrupted_run_writes_no_map_but_its_recording_holds_one(room, tmp_path):
    def press_ctrl_c(done, _expected):
        if done == 3:
            raise KeyboardInterrupt

    done = vlmm_log.process(
        room, rrd=tmp_path / "a.rrd", map=tmp_path / "a.json", settings=settings(room), progress=press_ctrl_c
    )
    assert done.outputs == (tmp_path / "a.rrd.partial",)
    assert bits(read_map(tmp_path / "a.rrd.partial").world.columns) == bits(done.map.world.columns)


def test_unreliable_pairs_stay_out_of_the_map(room):
    done = vlmm_log.process(room, settings=settings(room, "ego.min_inlier_share=1.0"))
    assert done.summary.unreliable_pairs == 6
    assert not done.map.world.evidence and not len(done.map.world.background.cells)


def test_a_log_without_poses_has_a_map_in_the_first_camera(room, run, tmp_path):
    bare = tmp_path / "room"
    shutil.copytree(room, bare)
    (bare / "groundtruth.txt").unlink()
    done = vlmm_log.process(bare, rrd=tmp_path / "bare.rrd", settings=settings(room))
    T = run[0].map.T_world_cam @ np.linalg.inv(done.map.T_world_cam)  # where the first camera stands in the world
    for name in ("ball", "shelf", "box"):
        (a,) = (e for e in run[0].map.world.elements.values() if e.label == name)
        (b,) = (e for e in done.map.world.elements.values() if e.label == name)
        assert T[:3, :3] @ b.position + T[:3, 3] == pytest.approx(a.position, abs=0.03)
        assert a.motion_class is b.motion_class


def test_instances_are_not_needed(room):
    done = vlmm_log.process(
        room, queries=["everything"], settings=vlmm_log.Settings.load(sets=["objects.segmenter=none"])
    )
    assert not done.map.world.elements and not done.answers[0].matches
    assert len(done.map.world.background.cells) > 100


def test_an_endpoint_that_is_down_is_a_named_fallback(room, tmp_path, monkeypatch):
    from rerun.chunk import RrdReader

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    s = settings(room, "objects.prior=llm:http://127.0.0.1:9/v1", "read.stop_s=0.12")
    done = vlmm_log.process(room, rrd=tmp_path / "room.rrd", settings=s)
    for e in done.map.world.elements.values():
        assert "llm:" in e.rho_source
    assert any(told.startswith("movability endpoint http://127.0.0.1:9/v1: ") for told in done.end.told)
    log = [
        text
        for chunk in RrdReader(str(tmp_path / "room.rrd")).store().stream().filter(content="/log")
        for (text,) in chunk.to_record_batch()["TextLog:text"].to_pylist()
    ]
    for e in done.map.world.elements.values():
        assert f"movability of {e.label!r}: {e.rho:.2f}, {e.rho_source}" in log


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "say what to look for"),
        ("things blorbing the flarn of 7", "not understood"),
        ("x" * 2000, "characters"),
    ],
)
def test_a_query_that_is_not_understood_is_refused_before_the_run(room, run, text, told):
    with pytest.raises(InputError, match=told):
        vlmm_log.process(room, queries=[text], settings=settings(room))
    with pytest.raises(InputError, match=told):
        vlmm_log.query(run[2], text)


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        ("missing.rrd", None, "no such file"),
        ("text.rrd", b"hello", "Rerun recording"),
        ("empty.rrd", b"", "Rerun recording"),
        ("map.txt", b"hello", "json or .parquet"),
        ("map.json", b"{}", "map.json"),
        ("cloud.ply", b"ply", "only to look at"),
    ],
)
def test_what_is_no_map_is_refused_in_one_line(tmp_path, name, content, told):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=re.escape(told)) as error:
        vlmm_log.load_map(tmp_path / name)
    assert "\n" not in str(error.value)


def test_somebody_elses_recording_is_refused(tmp_path):
    import rerun as rr

    rec = rr.RecordingStream("other")
    rec.save(tmp_path / "other.rrd")
    rec.log("points", rr.Points3D([[0, 0, 0]]))
    rec.disconnect()
    with pytest.raises(InputError, match="holds no settings"):
        vlmm_log.load_map(tmp_path / "other.rrd")


def test_the_query_command(run, tmp_path):
    found = command("query", run[2], "things that moved", "--json", cwd=tmp_path)
    assert found.returncode == 0, found.stderr
    told = json.loads(found.stdout)
    assert sorted(a["label"] for a in told["answers"]) == ["ball", "box"]
    assert all("moved" in a["reason"] for a in told["answers"])
    none = command("query", run[1], "elephants", "--explain", cwd=tmp_path)
    assert none.returncode == 1 and "elephant" in none.stdout
    count = command("query", run[1], "how many things moved", cwd=tmp_path)
    assert count.stdout.splitlines()[0].strip() == "2"
    for arguments in (
        ["nothing.json", "chairs"],
        [run[2], "blorb the flarn of 7"],
        [run[2], "chairs", "--parser", "x"],
    ):
        refused = command("query", *arguments, cwd=tmp_path)
        assert refused.returncode == 2 and len(refused.stderr.splitlines()) == 1, refused.stderr
        assert not refused.stdout


def test_the_paper_profile_has_a_map_too(room, tmp_path):
    s = vlmm_log.Settings.load("paper", sets=[f"objects.segmenter=masks:{room / 'masks'}"])
    done = vlmm_log.process(room, map=tmp_path / "paper.json", queries=["the box that opens"], settings=s)
    moving = {e.label for e in done.map.world.elements.values() if e.motion_class is MotionClass.MOVING}
    assert {"ball", "box"} <= moving
    assert done.answers[0].ids.tolist() == [3]
