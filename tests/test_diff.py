"""Two runs compared: planted changes are found where they are, equal runs are equal, the rest is refused."""

import itertools
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import jsonschema
import numpy as np
import pytest
import rerun as rr
from command_line import command
from rerun.chunk import Chunk
from scipy.optimize import linear_sum_assignment

import render_room
import vlmm_log
from planted import cell, later, rewritten, without
from vlmm_log import viewing
from vlmm_log.comparison.difference import ElementChange
from vlmm_log.comparison.maps import NEAR_M, OTHER_LABEL, matched
from vlmm_log.comparison.measures import figures
from vlmm_log.comparison.report import report
from vlmm_log.comparison.stages import STAGES
from vlmm_log.comparison.tolerance import Choice, Tolerance
from vlmm_log.comparison.words import figure_words, flip_words, summary
from vlmm_log.entries import Pose, Scalar, Table
from vlmm_log.recording import open_recording
from vlmm_log.types import InputError

ROW = "rerun.controls.RowId"
IMAGE = "world/camera/image"
QUERY = "things that moved"
USUAL = tuple(stage for stage in STAGES if stage not in ("posterior", "judge"))  # without calibration and truth
SCHEMA = json.loads((Path(__file__).parents[1] / "docs/diff.schema.json").read_text())


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs") / "room"
    render_room.write_tum(folder, 10)
    return folder


def run(room, *sets, **outputs):
    settings = vlmm_log.Settings.load(sets=[f"objects.segmenter=masks:{room / 'masks'}", *sets])
    return vlmm_log.process(room, settings=settings, queries=[QUERY], **outputs)


@pytest.fixture(scope="module")
def recording(room, tmp_path_factory):
    out = tmp_path_factory.mktemp("out") / "room.rrd"
    run(room, rrd=out, mcap=out.with_suffix(".mcap"), map=out.with_suffix(".json"))
    return out


@pytest.mark.parametrize(("label", "told"), [("box", "3 box: moving -> static"), ("", "3: moving -> static")])
def test_an_element_without_a_label_is_told_by_its_id(label, told):
    assert flip_words(ElementChange(3, 3, label, ("flipped",), "", ("moving", "static"))) == told


def test_what_others_logged_beside_a_run_is_compared(recording, tmp_path):
    """On Rerun's own timelines, and merged by its own tool."""
    rec = rr.RecordingStream("vlmm-log", recording_id=open_recording(recording).run.recording_id, send_properties=False)
    rec.save(tmp_path / "own.rrd")
    rec.log("robot/battery", rr.Scalars(0.5))
    rec.disconnect()
    names = [recording, tmp_path / "own.rrd", "-o", tmp_path / "merged.rrd"]
    subprocess.run([str(viewing._viewer()), "rrd", "merge", *map(str, names)], check=True, capture_output=True)
    found = vlmm_log.diff(recording, tmp_path / "merged.rrd")
    assert [(e.entity, len(e.only_a), len(e.only_b)) for e in found.entities] == [("robot/battery", 0, 1)]


def byte(place, change):
    """Change one byte of an image buffer."""

    def edit(value):
        data = bytearray(bytes(value[0]))
        data[place] = change(data[place])
        return [list(data)]

    return edit


def half(place, value):
    """Write one half-precision number into a buffer."""

    def edit(cell_value):
        data = np.frombuffer(bytes(cell_value[0]), np.float16).copy()
        data[place] = value
        return [list(data.tobytes())]

    return edit


def steps(place, count):
    """Write one count into a field in steps: RVL behind 20 bytes of header."""

    def edit(value):
        image = bytes(value[0])
        words = np.frombuffer(image[20:], "<u4")
        nibbles = iter((words[:, None] >> np.arange(28, -4, -4) & 15).ravel().tolist())
        width, height = np.frombuffer(image[12:20], "<i4")

        def number():
            found, shift = 0, 0
            while True:
                nibble = next(nibbles)
                found |= (nibble & 7) << shift
                shift += 3
                if nibble < 8:
                    return found

        counts, last = [], 0
        while len(counts) < width * height:
            counts += [0] * number()
            for _ in range(number()):
                step = number()
                last += step // 2 if step % 2 == 0 else -(step + 1) // 2
                counts.append(last)
        counts[place] = count
        out, last = [], 0

        def put(number):
            while number > 7:
                out.append(number & 7 | 8)
                number >>= 3
            out.append(number)

        for seen, run in itertools.groupby(counts, bool):
            run = list(run)
            put(0) if seen and not out else None
            put(len(run))
            for current in run if seen else ():
                put(2 * (current - last) if current >= last else 2 * (last - current) - 1)
                last = current
        put(0) if not counts[-1] else None
        out += [0] * (-len(out) % 8)
        packed = (np.array(out, np.uint32).reshape(-1, 8) << np.arange(28, -4, -4, dtype=np.uint32)).sum(axis=1)
        return [list(image[:20] + packed.astype("<u4").tobytes())]

    return edit


def pixel(value):
    """Decode an image, change one pixel, encode it without loss."""
    pixels = cv2.imdecode(np.frombuffer(bytes(value[0]), np.uint8), cv2.IMREAD_UNCHANGED)
    pixels[40, 60] = pixels[40, 60] + 100
    return [list(cv2.imencode(".png", pixels)[1].tobytes())]


def first(change):
    """Change the first number of a cell."""

    def edit(value):
        head = value[0]
        return [change(head), *value[1:]] if not isinstance(head, list) else [[change(head[0]), *head[1:]], *value[1:]]

    return edit


def tensor(value):
    # a union's buffer is easier to change as its own type allows: the middle of it
    (told,) = value
    told["buffer"] = [x + np.float16(0.5) if k == 7 else x for k, x in enumerate(told["buffer"])]
    return [told]


def swapped(value):
    data = np.frombuffer(bytes(value[0]), np.uint16).copy()
    ones, twos = data == 1, data == 3
    assert ones.any() and twos.any()
    data[ones], data[twos] = 3, 1
    return [list(data.tobytes())]


def label(value):
    return [value[0] + " of another kind", *value[1:]]


BLOB = "EncodedDepthImage:blob"
PLANTED = {  # name -> the edit, the entity that is named, the frame that is named
    "one pixel of d_M": (
        cell(f"{IMAGE}/residual/d_m", 3, BLOB, steps(153_920, 480)),
        "residual/d_m",
        3,
    ),
    "one NaN of d_M": (
        cell(f"{IMAGE}/residual/d_m", 3, BLOB, steps(153_920, 0)),
        "residual/d_m",
        3,
    ),
    "p_stat": (cell(f"{IMAGE}/residual/p_stat", 1, "DepthImage:buffer", half(9_000, 2)), "residual/p_stat", 1),
    "sigma_z": (
        cell(f"{IMAGE}/residual/sigma_z", 0, "DepthImage:buffer", half(9_000, 3)),
        "residual/sigma_z",
        0,
    ),
    "round-trip error": (
        cell(f"{IMAGE}/flow/fb_error", 5, BLOB, steps(40_000, 576)),
        "flow/fb_error",
        5,
    ),
    "swapped mask ids": (cell(f"{IMAGE}/instances", 2, "SegmentationImage:buffer", swapped), "instances", 2),
    "validity": (
        cell(f"{IMAGE}/validity", 2, "SegmentationImage:buffer", byte(99, lambda v: (v + 1) % 5)),
        "validity",
        2,
    ),
    "pose by 1 mm": (cell("world/camera", 4, "Transform3D:translation", first(lambda x: x + 1e-3)), "world/camera", 4),
    "rotation": (cell("world/camera", 4, "Transform3D:quaternion", first(lambda x: x + 1e-4)), "world/camera", 4),
    "pose to NaN": (cell("world/camera", 4, "Transform3D:translation", first(lambda _: np.nan)), "world/camera", 4),
    "score to infinity": (cell("world/map/observations", 3, "o", first(lambda _: np.inf)), "map/observations", 3),
    "lost pose": (without(lambda e, f: (e, f) == ("world/camera", 3)), "world/camera", 3),
    "intrinsics": (cell(IMAGE, 0, "Pinhole:image_from_camera", first(lambda x: x + 0.5)), IMAGE, 0),
    "depth pixel": (cell(f"{IMAGE}/depth", 6, BLOB, pixel), "image/depth", 6),
    "colour pixel": (cell(f"{IMAGE}/rgb", 6, "EncodedImage:blob", pixel), "image/rgb", 6),
    "arrow": (cell(f"{IMAGE}/flow/arrows", 1, "Arrows2D:vectors", first(lambda x: x + 1)), "flow/arrows", 1),
    "box": (cell(f"{IMAGE}/boxes", 1, "Boxes2D:centers", first(lambda x: x + 1)), "image/boxes", 1),
    "scalar": (cell("stats/spread", 5, "Scalars:scalars", first(lambda x: x + 1e-9)), "stats/spread", 5),
    "observed score": (cell("world/map/observations", 3, "o", first(lambda x: x + 1e-3)), "map/observations", 3),
    "score to NaN": (cell("world/map/observations", 3, "kappa", first(lambda _: float("nan"))), "map/observations", 3),
    "element label": (cell("world/map/elements", 6, "label", label), "map/elements", 6),
    "element class": (cell("world/map/elements", 6, "motion_class", lambda v: ["static", *v[1:]]), "map/elements", 6),
    "prior's source": (cell("world/map/elements", 2, "rho_source", label), "map/elements", 2),
    "query rank": (
        cell("world/map/query/things_that_moved", 6, "element_id", lambda v: v[::-1]),
        "things_that_moved",
        6,
    ),
    "feature": (cell("world/map/features", None, "feature", first(lambda x: x + 0.1)), "map/features", 0),
    "log line": (cell("log", None, "TextLog:text", label), "log", 0),
    "state": (cell("world/map/elements/1", None, "StateChange:state", lambda v: ["static", *v[1:]]), "elements/1", 2),
    "voxel colour": (cell("world/map/points", 0, "Points3D:colors", first(lambda c: c ^ 1 << 16)), "map/points", 0),
    "look": (
        cell(f"{IMAGE}/residual/d_m", None, "EncodedDepthImage:colormap", first(lambda x: x + 1)),
        "residual/d_m",
        None,
    ),
    "names of masks": (without(lambda e, f: e == f"{IMAGE}/instances" and f is None), "image/instances", None),
    "time by 1 ns": (later(f"{IMAGE}/residual/norm", 2, 1), "residual/norm", 2),
    "missing frame": (without(lambda _, f: f == 3), "world/camera", 3),
    "dropped entity": (without(lambda e, _: e == f"{IMAGE}/flow/arrows"), "flow/arrows", 0),
    "dropped row": (without(lambda e, f: (e, f) == (f"{IMAGE}/residual/norm", 4)), "residual/norm", 4),
}


@pytest.mark.parametrize("name", PLANTED)
def test_a_planted_change_is_found_where_it_is(recording, tmp_path, name):
    edit, entity, frame = PLANTED[name]
    other = rewritten(recording, tmp_path / "other.rrd", edit)
    done = vlmm_log.diff(recording, other)
    assert not done.same
    found = {e.entity: e for e in done.entities}
    named = [e for e in found if e.endswith(entity)]
    assert named, (name, list(found))
    assert found[named[0]].first.index == frame
    if name != "missing frame":
        assert len(found) == 1, list(found)
        assert done.first.at.index == frame
        assert done.first.entity == named[0]
    else:
        assert all([p.index for p in e.only_a] in ([3], [0, 3]) or e.entity == "log" for e in done.entities)
    jsonschema.validate(report(done), SCHEMA)


def test_a_changed_setting_is_named_and_nothing_else(recording, tmp_path):
    edit = cell("__properties/vlmm", None, "settings", lambda v: [v[0].replace("alpha = 0.05", "alpha = 0.01")])
    done = vlmm_log.diff(recording, rewritten(recording, tmp_path / "other.rrd", edit))
    assert [(c.name, c.a, c.b) for c in done.settings] == [("noise.alpha", 0.05, 0.01)]
    assert not (done.same or done.entities or done.first)


def test_another_input_is_named(recording, tmp_path):
    edit = cell("__properties/vlmm_end", None, "input_hash", lambda v: [v[0][::-1]])
    done = vlmm_log.diff(recording, rewritten(recording, tmp_path / "other.rrd", edit))
    assert [c.name for c in done.inputs] == ["input_hash"]
    assert not done.same


def test_another_version_is_told_and_no_difference(recording, tmp_path):
    edit = cell("__properties/vlmm", None, "versions", lambda v: [v[0].replace('"numpy": "', '"numpy": "9')])
    done = vlmm_log.diff(recording, rewritten(recording, tmp_path / "other.rrd", edit))
    assert [c.name for c in done.about] == ["version of numpy"]
    assert done.same


def test_a_stage_that_differs_beyond_what_is_recorded_is_named(recording, tmp_path):
    """Lean fields hold every other pixel; the digest of the full flow tells the rest."""

    def edit(value):
        value[1] ^= 1  # of the stages, flow comes second
        return value

    other = rewritten(recording, tmp_path / "other.rrd", cell("digests", 4, "xxh3", edit))
    done = vlmm_log.diff(recording, other)
    assert (done.first.at.index, done.first.stage, done.first.entity) == (4, "flow", "")
    assert vlmm_log.diff(recording, other, tolerance=Tolerance(1e-6)).same


def test_an_added_entity_is_found(recording, tmp_path):
    import rerun as rr

    times = [rr.TimeColumn("frame", sequence=[2]), rr.TimeColumn("time", timestamp=np.array([5], "datetime64[ns]"))]
    extra = Chunk.from_columns("/stats/new", times, rr.Scalars.columns(scalars=[1.0]))
    other = rewritten(recording, tmp_path / "other.rrd", lambda _, batch: batch, [extra])
    (found,) = vlmm_log.diff(recording, other).entities
    assert found.entity == "stats/new"
    assert [p.index for p in found.only_b] == [2]
    (found,) = vlmm_log.diff(other, recording).entities
    assert [p.index for p in found.only_a] == [2]


def test_the_order_of_stages_is_that_of_the_run(recording):
    tables = [e.value for e in open_recording(recording).entries(["digests"])]
    assert len(tables) == 7
    for table in tables:
        assert isinstance(table, Table)
        assert table.columns["stage"] == USUAL


def test_a_recording_is_the_same_as_itself_as_a_rewritten_one_and_as_its_mcap(recording, tmp_path):
    optimized = tmp_path / "optimized.rrd"
    command = [sys.executable, "-m", "rerun_cli", "rrd", "optimize", recording, "-o", optimized]
    subprocess.run(command, check=True, capture_output=True)
    for other in (recording, optimized, recording.with_suffix(".mcap")):
        done = vlmm_log.diff(recording, other)
        assert done.same, [(e.entity, e.frames[:1]) for e in done.entities]
        assert done.frames == (7, 7, 7)
        assert vlmm_log.diff(other, recording).same


def test_equal_runs_are_equal_in_every_entity_and_rerun_agrees(room, recording, tmp_path):
    again = tmp_path / "again.rrd"
    run(room, rrd=again)
    assert vlmm_log.diff(recording, again).same
    stripped = [
        rewritten(p, tmp_path / f"{k}.rrd", without(lambda e, _: "stage_ms" in e))
        for k, p in enumerate((recording, again))
    ]
    compare = [sys.executable, "-m", "rerun_cli", "rrd", "compare", "--unordered", *stripped]
    told = subprocess.run(compare, capture_output=True, text=True, check=False)
    assert told.returncode == 0, told.stderr[-2000:]


def test_what_a_stage_took_is_compared_where_it_is_asked_for(room, recording, tmp_path):
    again = tmp_path / "again.rrd"
    run(room, rrd=again)
    done = vlmm_log.diff(recording, again, choice=Choice(only=("stats/stage_ms",)))
    assert done.entities and all(e.entity.startswith("stats/stage_ms/") for e in done.entities)


def test_profiles_part_at_the_matches_and_the_noise_model_is_named_first(room, recording, tmp_path):
    other = tmp_path / "paper.rrd"
    settings = vlmm_log.Settings.load("paper", sets=[f"objects.segmenter=masks:{room / 'masks'}"])
    vlmm_log.process(room, settings=settings, rrd=other)
    done = vlmm_log.diff(recording, other)
    assert done.settings[0].name.startswith("noise.")
    assert (done.first.at.index, done.first.stage) == (0, "matches")
    assert {s.stage for s in done.stages} >= {"matches", "ego", "motion"}
    assert not {s.stage for s in done.stages} & {"input", "flow", "segments"}


def test_tolerances_by_entity(recording, tmp_path):
    d_m, pose = PLANTED["one pixel of d_M"][0], PLANTED["pose by 1 mm"][0]
    other = rewritten(recording, tmp_path / "other.rrd", lambda e, b: pose(e, d_m(e, b)))

    def names(**tolerance):
        return {e.entity for e in vlmm_log.diff(recording, other, tolerance=Tolerance(**tolerance)).entities}

    assert names() == {f"{IMAGE}/residual/d_m", "world/camera"}
    assert names(atol=0.11) == {f"{IMAGE}/residual/d_m"}  # cm
    assert names(atol=0.09) == {f"{IMAGE}/residual/d_m", "world/camera"}
    assert names(atols={"world/camera/image/residual/*": 10}) == {"world/camera"}
    assert names(atol=10) == set()
    assert vlmm_log.diff(recording, other, tolerance=Tolerance(atols={"log": 1.0})).stages == ()
    assert names(rtol=100.0, rtols={"world/camera": 0.0, IMAGE: 100.0}) == {"world/camera"}
    only = vlmm_log.diff(recording, other, choice=Choice(only=("world/camera",), ignore=(f"{IMAGE}/*",)))
    assert {e.entity for e in only.entities} == {"world/camera"}
    assert vlmm_log.diff(recording, other, choice=Choice(ignore=("world/camera",))).same  # and all below it


def test_digests_count_unless_a_tolerance_or_what_is_ignored_concerns_their_stage(recording, tmp_path):
    def edit(value):
        return [x ^ 1 for x in value]

    other = rewritten(recording, tmp_path / "other.rrd", cell("digests", 4, "xxh3", edit))

    def stages(tolerance=Tolerance(), **choice):  # noqa: B008
        return {s.stage for s in vlmm_log.diff(recording, other, tolerance=tolerance, choice=Choice(**choice)).stages}

    assert stages() == set(USUAL)
    assert stages(ignore=("log",)) == set(USUAL)
    assert stages(ignore=("world/map/query", f"{IMAGE}/query")) == set(USUAL) - {"query"}
    assert stages(Tolerance(atols={f"{IMAGE}/residual": 0.1})) == set(USUAL) - {"motion"}
    assert stages(Tolerance(0.1)) == stages(ignore=("digests",)) == stages(only=("world",)) == set()


@pytest.mark.parametrize("name", ["nosuch", "World/Map", "world/camera/image/residual/dm"])
def test_names_that_fit_nothing_are_refused(recording, name):
    for options in ({"choice": Choice(only=(name,))}, {"tolerance": Tolerance(atols={name: 1.0})}):
        with pytest.raises(InputError, match="no entity is called so; there is "):
            vlmm_log.diff(recording, recording, **options)


@pytest.mark.parametrize("text", ["x", "=1", "a=", "-1", "nan", "world/camera=inf"])
def test_tolerances_that_are_none_are_refused(text):
    with pytest.raises(InputError, match="--atol"):
        Tolerance.parse([text], [])


def test_figures_of_one_pixel(recording, tmp_path):
    other = rewritten(recording, tmp_path / "other.rrd", PLANTED["one pixel of d_M"][0])
    (entity,) = vlmm_log.diff(recording, other).entities
    (frame,) = entity.frames
    was = next(e.value.values for e in open_recording(recording).entries([entity.entity]) if e.index == 3)
    figures = frame.figures
    assert (figures.over, figures.unmatched, figures.p50, figures.p95) == (1, 0, 0, 0)
    assert figures.compared == np.isfinite(was).sum()
    assert figures.largest == pytest.approx(abs(7.5 - float(was.ravel()[153_920])), rel=1e-3)
    other = rewritten(recording, tmp_path / "nan.rrd", PLANTED["one NaN of d_M"][0])
    (frame,) = vlmm_log.diff(recording, other).entities[0].frames
    assert (frame.figures.over, frame.figures.unmatched) == (0, 1)


def test_figures_of_a_pose_and_of_masks(recording, tmp_path):
    (pose,) = vlmm_log.diff(recording, rewritten(recording, tmp_path / "a.rrd", PLANTED["pose by 1 mm"][0])).entities
    assert pose.largest == pytest.approx(0.1, abs=1e-4)
    assert pose.frames[0].figures.unit == "cm"
    assert pose.frames[0].figures.told == "0 degrees"
    (masks,) = vlmm_log.diff(
        recording, rewritten(recording, tmp_path / "b.rrd", PLANTED["swapped mask ids"][0])
    ).entities
    labels = next(e.value.values for e in open_recording(recording).entries([masks.entity]) if e.index == 2)
    assert masks.frames[0].figures.over == np.isin(labels, (1, 3)).sum()
    assert "least 0.000" in masks.frames[0].figures.told


def test_elements_are_matched_by_id_then_by_place_and_label(recording, tmp_path):
    """Ids of another run differ: what lies in the same place under the same label is the same."""
    renumbered = cell("world/map/elements", None, "element_id", lambda ids: [i + 50 for i in ids])
    done = vlmm_log.diff(recording, rewritten(recording, tmp_path / "other.rrd", renumbered))
    assert done.elements.matched == 3
    assert [(c.a, c.b, c.kinds) for c in done.elements.changes] == [(i, i + 50, ("renumbered",)) for i in (1, 2, 3)]


@pytest.mark.parametrize(
    ("component", "change", "kind"),
    [
        ("position", first(lambda x: x + 0.2), "moved"),
        ("label", label, "relabelled"),
        ("motion_class", lambda v: ["static", *v[1:]], "flipped"),
        ("speed", first(lambda x: x + 1), "changed"),
    ],
)
def test_changes_of_elements_are_told_by_kind(recording, tmp_path, component, change, kind):
    other = rewritten(recording, tmp_path / "other.rrd", cell("world/map/elements", 6, component, change))
    (found,) = vlmm_log.diff(recording, other).elements.changes
    assert (found.a, found.b, found.kinds) == (1, 1, (kind,))


TURNED = np.float32([1e-8, 0, 0, 1])  # by 1e-6 degrees
STILL = np.float32([0, 0, 0])


@pytest.mark.parametrize(
    ("a", "b"),
    [
        (Scalar(0.1), Scalar(float(np.nextafter(0.1, 1)))),
        (Scalar(0.0), Scalar(5e-324)),
        (Pose(STILL, np.float32([0, 0, 0, 1])), Pose(STILL, TURNED)),
        (Pose(STILL, TURNED), Pose(STILL + np.float32(1e-9), TURNED)),
    ],
)
def test_no_difference_is_so_small_that_it_reads_0(a, b):
    told = figure_words(figures("stats/ego_rotation", a, b, 0, 0))
    assert any(float(number) for number in re.findall(r"[-+.e\d]*\d", told)), told


def test_figures_of_an_element_are_told_in_digits_that_show_the_change(recording, tmp_path):
    nudged = cell("world/map/elements", 6, "speed", first(lambda x: np.nextafter(np.float32(x), np.float32(9))))
    (found,) = vlmm_log.diff(recording, rewritten(recording, tmp_path / "other.rrd", nudged)).elements.changes
    before, after = re.fullmatch(r"speed (\S+) -> (\S+)", found.told).groups()
    assert float(before) < float(after) < float(before) + 1e-5


def test_elements_added_and_removed(recording, tmp_path):
    def edit(name, batch):
        if name != "world/map/elements":
            return batch
        for component in [c for c in batch.schema.names if ":" not in c and c not in ("frame", "time", ROW)]:
            batch = cell(name, 6, component, lambda v: v[1:])(name, batch)
        return batch

    other = rewritten(recording, tmp_path / "other.rrd", edit)
    (change,) = vlmm_log.diff(recording, other).elements.changes
    assert (change.a, change.b, change.kinds) == (1, None, ("removed",))
    (change,) = vlmm_log.diff(other, recording).elements.changes
    assert (change.a, change.b, change.kinds) == (None, 1, ("added",))


@pytest.mark.parametrize("seed", range(20))
def test_renumbered_elements_are_matched_as_the_whole_table_of_costs_says(seed):
    """Only what is near is looked at, by groups; the textbook's form is one assignment of all to all."""
    rng = np.random.default_rng(seed)

    def elements(count, first):
        labels, places = rng.choice(["cup", "box"], count), rng.uniform(0, 2.5, (count, 3))
        return {"element_id": np.arange(first, first + count), "label": tuple(labels), "position": places}

    a, b = elements(int(rng.integers(1, 40)), 0), elements(int(rng.integers(1, 40)), 1000)
    a["position"][0], b["position"][-1, 1] = np.nan, np.inf  # as a damaged map may have them
    far = np.linalg.norm(a["position"][:, None] - b["position"][None], axis=2) / NEAR_M
    cost = far + OTHER_LABEL * (np.array(a["label"])[:, None] != np.array(b["label"])[None])
    cost = np.where((far <= 1) & (cost <= 1.5), cost, 1e6)
    wanted = [(i, j) for i, j in zip(*linear_sum_assignment(cost), strict=True) if cost[i, j] < 1e6]
    assert matched(a, b) == wanted


def test_queries_by_rank(recording, tmp_path):
    other = rewritten(recording, tmp_path / "other.rrd", PLANTED["query rank"][0])
    (query,) = vlmm_log.diff(recording, other).queries
    assert query.query == "things_that_moved"
    assert sorted(query.ranks) == [("element 1", 2, 1), ("element 3", 1, 2)] or sorted(query.ranks) == [
        ("element 1", 1, 2),
        ("element 3", 2, 1),
    ]


def test_maps_are_compared_too(room, recording, tmp_path):
    saved = recording.with_suffix(".json")
    assert vlmm_log.diff(saved, saved).same
    assert vlmm_log.diff(saved, recording).same
    run(room, "map.tau_o=100", map=tmp_path / "other.json")
    done = vlmm_log.diff(saved, tmp_path / "other.json")
    assert [c.name for c in done.settings] == ["map.tau_o"]
    assert {c.a for c in done.elements.of_kind("flipped")} == {1, 3}
    with pytest.raises(InputError, match="a map holds nothing in time"):
        vlmm_log.diff(saved, recording, rrd=tmp_path / "merged.rrd")


def test_what_is_unrelated_is_refused(recording, tmp_path):
    other_room = tmp_path / "other_room"
    render_room.write_tum(other_room, 5)
    for name in ("rgb.txt", "depth.txt", "groundtruth.txt"):  # the same scene an hour later
        text = (other_room / name).read_text()
        moved = re.sub(r"^(\d+)(?=\.)", lambda m: str(int(m[1]) + 3600), text, flags=re.MULTILINE)
        (other_room / name).write_text(moved)
    run(other_room, rrd=tmp_path / "other.rrd", map=tmp_path / "other.json")
    with pytest.raises(InputError, match="share no frame"):
        vlmm_log.diff(recording, tmp_path / "other.rrd")
    with pytest.raises(InputError, match="at different times"):
        vlmm_log.diff(recording.with_suffix(".json"), tmp_path / "other.json")
    (tmp_path / "text.rrd").write_text("no recording")
    (tmp_path / "text.mcap").write_text("no recording")
    for name, told in (
        ("text.rrd", "not a Rerun"),
        ("text.mcap", "no MCAP"),
        ("absent.rrd", "no such"),
        (".", "folder"),
    ):
        with pytest.raises(InputError, match=told):
            vlmm_log.diff(recording, tmp_path / name)
    with pytest.raises(InputError, match="is the input"):
        vlmm_log.diff(recording, recording, rrd=recording, force=True)
    for outputs, told in (({"rrd": "x.mcap"}, "x.rrd"), ({"html": "x.rrd"}, "x.html"), ({"json": ""}, "names no file")):
        with pytest.raises(InputError, match=told):
            vlmm_log.diff(recording, recording, **outputs)
    os.mkfifo(tmp_path / "pipe.html")
    with pytest.raises(InputError, match="a device or a pipe"):
        vlmm_log.diff(recording, recording, html=tmp_path / "pipe.html", force=True)


def test_a_recording_of_something_else_is_refused(recording, tmp_path):
    import rerun as rr

    rec = rr.RecordingStream("other", recording_id="x")
    rec.save(tmp_path / "foreign.rrd")
    rec.log("a", rr.TextLog("b"))
    rec.disconnect()
    with pytest.raises(InputError, match="not a recording of vlmm-log"):
        vlmm_log.diff(recording, tmp_path / "foreign.rrd")


def killed(room, tmp_path, name):
    code = (
        "import os, sys, vlmm_log\n"
        "def tell(done, expected):\n"
        "    if done == 5: os.kill(os.getpid(), 9)\n"
        "s = vlmm_log.Settings.load(sets=['objects.segmenter=masks:' + sys.argv[1] + '/masks'])\n"
        "out = sys.argv[2]\n"
        "vlmm_log.process(sys.argv[1], rrd=out + '.rrd', mcap=out + '.mcap', settings=s, progress=tell)\n"
    )
    subprocess.run([sys.executable, "-c", code, room, tmp_path / name], cwd=tmp_path, check=False)
    return [tmp_path / f"{name}{suffix}.partial" for suffix in (".rrd", ".mcap")]


def test_what_a_killed_run_left_is_compared_and_what_is_missing_told(room, recording, tmp_path):
    for partial in killed(room, tmp_path, "cut"):
        done = vlmm_log.diff(recording, partial)
        assert any("B is incomplete" in line for line in done.missing), done.missing
        assert not done.same
        assert 1 <= done.frames[1] <= 6
        assert done.frames[2] == done.frames[1]
        assert [e for e in done.entities if e.frames or e.only_b] == [], "what is there is the same"
        pose = next(e for e in done.entities if e.entity == "world/camera")
        lost = [p.index for p in pose.only_a]
        assert lost == list(range(lost[0], 7)) and lost[0] >= 1, "the end is missing, and nothing else"
        assert "what both hold is the same" in summary(done)
        assert done.elements.changes == ()


def test_the_command_its_outputs_and_exit_codes(recording, tmp_path):
    hostile = "<script>alert(1)</script>"
    edit = cell("world/map/elements", 6, "label", lambda v: [hostile, *v[1:]])
    source = tmp_path / "runs"
    source.mkdir()
    a = shutil.copy(recording, source / "a.rrd")
    b = rewritten(recording, source / "b&lt;.rrd", lambda e, x: edit(e, PLANTED["one pixel of d_M"][0](e, x)))
    done = command("diff", a, a, cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert "the same; both hold 7 pairs" in done.stdout
    done = command("diff", a, b, "--json", "d.json", "--html", "d.html", "--rrd", "d.rrd", cwd=tmp_path)
    assert done.returncode == 1, done.stderr
    assert "first divergence: frame 3, stage motion" in done.stdout
    jsonschema.validate(json.loads((tmp_path / "d.json").read_text()), SCHEMA)
    page = (tmp_path / "d.html").read_text()
    assert hostile not in page and "&lt;script&gt;" in page
    assert "b&amp;lt;.rrd" in page
    assert not re.search(r"""(src|href)=["'](?!data:|#)""", page), "the page needs nothing else"
    assert page.count("data:image/jpeg") >= 4
    verify = [sys.executable, "-m", "rerun_cli", "rrd", "verify", tmp_path / "d.rrd"]
    assert subprocess.run(verify, capture_output=True, check=False).returncode == 0
    again = command("diff", a, b, "--json", "-", cwd=tmp_path)
    assert json.loads(again.stdout)["first"]["frame"] == 3
    refused = command("diff", a, b, "--json", "d.json", cwd=tmp_path)
    assert refused.returncode == 2 and "--force" in refused.stderr
    command("diff", a, b, "--html", "e.html", cwd=tmp_path)
    assert (tmp_path / "e.html").read_text() == page, "the same bytes"
    absent = command("diff", a, "none.rrd", cwd=tmp_path)
    assert (absent.returncode, len(absent.stderr.splitlines())) == (2, 1)


def test_the_merged_recording_holds_both_and_their_difference(recording, tmp_path):
    from rerun.chunk import RrdReader

    other = rewritten(recording, tmp_path / "other.rrd", PLANTED["one pixel of d_M"][0])
    for b in (other, recording.with_suffix(".mcap")):
        vlmm_log.diff(recording, b, rrd=tmp_path / "merged.rrd", force=True)
        rows = {}
        for chunk in RrdReader(str(tmp_path / "merged.rrd")).store().stream():
            if not chunk.is_static:
                rows[chunk.entity_path] = rows.get(chunk.entity_path, 0) + chunk.num_rows
        for side in ("A", "B", "delta"):
            for entity in ("residual/d_m", "flow/tensor", "instances", "validity"):
                assert rows[f"/{side}/{IMAGE}/{entity}"] == 7, (side, entity)
            assert rows[f"/{side}/stats/flagged_share"] == 7
        for side in ("A", "B"):
            assert rows[f"/{side}/world/map/elements"] == 7
            assert rows[f"/{side}/world/camera"] == 7


def test_the_example_fails_where_d_m_moved(room, tmp_path):
    example = Path(__file__).parents[1] / "examples/diff_two_runs.py"
    for sets, code in (([], 0), (["noise.scale=2"], 1)):
        command = [sys.executable, example, room, *sets, "--atol", "0.2"]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == code, done.stderr
    assert "noise model (1)" in done.stdout


def test_settings_decide_unless_other_things_alone_are_compared(recording, tmp_path):
    edit = cell("__properties/vlmm", None, "settings", lambda v: [v[0].replace("alpha = 0.05", "alpha = 0.01")])
    other = rewritten(recording, tmp_path / "other.rrd", edit)
    for choice in (Choice(only=(f"{IMAGE}/residual/d_m",)), Choice(ignore=("settings",))):
        done = vlmm_log.diff(recording, other, choice=choice)
        assert done.same
        assert [c.name for c in done.about] == ["noise.alpha"], "told all the same"
    assert not vlmm_log.diff(recording, other, choice=Choice(only=("settings",))).same
    assert not vlmm_log.diff(recording, other, choice=Choice(ignore=("log",))).same
