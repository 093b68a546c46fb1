"""The whole run: the seam, the recording, interruption."""

import json

import numpy as np
import pytest

import render_room
import vlmm_log
from vlmm_log.elements import Instances, Sightings, Tracked, WorldMap
from vlmm_log.pipeline.matches import Matches
from vlmm_log.sinks.memory import Memory
from vlmm_log.types import Ego, Features, FlowField, FramePair, InputError, Motion, Odometry, Segments, Skipped

IMAGE = "/world/camera/image"
PER_PAIR = [
    "/world/camera",
    *(f"{IMAGE}/{p}" for p in ("rgb", "depth", "validity")),
    *(f"{IMAGE}/flow/{p}" for p in ("color", "arrows", "tensor", "fb_error")),
    *(f"{IMAGE}/residual/{p}" for p in ("d_m", "norm", "sigma_z", "p_stat", "vectors", "covariance")),
    *(f"/stats/{p}" for p in ("inlier_share", "ego_rotation", "ego_translation", "median_d_m", "valid_share")),
    *(f"/stats/{p}" for p in ("flagged_share", "spread", "row_rotation", "row_translation", "median_residual")),
    *(
        f"/stats/stage_ms/{p}"
        for p in ("flow", "matches", "ego", "motion", "segments", "aggregate", "associate", "map")
    ),
    *(f"{IMAGE}/{p}" for p in ("instances", "boxes")),
    *(f"/world/map/{p}" for p in ("observations", "elements")),
]


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs") / "room"
    render_room.write_tum(folder, 7)
    return folder


def motions(memory):
    return [r for _, r in memory.seen if isinstance(r, Motion)]


def test_every_stage_is_seen_once_a_pair_and_in_order(room):
    memory = Memory()
    done = vlmm_log.process(room, sinks=[memory])
    kinds = [type(r) for _, r in memory.seen if not isinstance(r, Skipped)]
    stages = [FlowField, Segments, Matches, Ego, Motion, Features, Instances, Odometry, Sightings, Tracked, WorldMap]
    assert kinds == [FramePair, *stages] * 4
    assert [at.index for at, r in memory.seen if isinstance(r, Motion)] == [0, 1, 2, 3]
    assert done.end == memory.end
    assert (done.end.frames, done.end.pairs, done.end.complete) == (7, 4, True)
    assert done.summary.skipped["no frame 3 frames later"] == 3


def test_results_do_not_depend_on_who_watches_or_on_what_came_before(room, tmp_path):
    alone, watched, late = Memory(), Memory(), Memory()
    a = vlmm_log.process(room, sinks=[alone])
    b = vlmm_log.process(room, sinks=[watched], rrd=tmp_path / "a.rrd")
    later = vlmm_log.Settings.load(sets=["read.start_s=0.09"])
    vlmm_log.process(room, sinks=[late], settings=later)
    assert a.end.input_hash == b.end.input_hash
    for x, y in zip(motions(alone), motions(watched), strict=True):
        assert x.d_m.tobytes() == y.d_m.tobytes()
    assert motions(late)[0].d_m.tobytes() == motions(alone)[3].d_m.tobytes()


def test_the_input_hash_sees_one_pixel(room, tmp_path):
    import shutil

    import cv2

    other = tmp_path / "room"
    shutil.copytree(room, other)
    image = sorted((other / "rgb").iterdir())[2]
    pixels = cv2.imread(str(image))
    pixels[5, 5, 0] ^= 1
    cv2.imwrite(str(image), pixels)
    assert vlmm_log.process(other).end.input_hash != vlmm_log.process(room).end.input_hash


def entities(rrd):
    """Entity -> number of rows that are not static."""
    from rerun.chunk import RrdReader

    rows = {}
    for chunk in RrdReader(str(rrd)).store().stream():
        if not chunk.is_static:
            rows[chunk.entity_path] = rows.get(chunk.entity_path, 0) + chunk.num_rows
    return rows


def properties(rrd):
    """ "name:field" -> value of the recording's properties."""
    from rerun.chunk import RrdReader

    told = {}
    for chunk in RrdReader(str(rrd)).store().stream().filter(content="/__properties/**"):
        batch = chunk.to_record_batch()
        for column in batch.schema.names:
            told[f"{chunk.entity_path.rsplit('/', 1)[-1]}:{column.rsplit(':', 1)[-1]}"] = batch[column].to_pylist()[0][
                0
            ]
    return told


@pytest.mark.parametrize("dense", [False, True])
def test_the_recording_holds_every_entity_for_every_pair(room, tmp_path, dense):
    import subprocess
    import sys

    out = tmp_path / "room.rrd"
    settings = vlmm_log.Settings.load(sets=["log.dense=true"] if dense else [])
    done = vlmm_log.process(room, rrd=out, settings=settings)
    assert done.outputs == (out,)
    rows = entities(out)
    expected = [*PER_PAIR, *([f"{IMAGE}/residual/tensor"] if dense else [])]
    assert {path: rows.get(path) for path in expected} == dict.fromkeys(expected, 4)
    verify = subprocess.run([sys.executable, "-m", "rerun_cli", "rrd", "verify", out], capture_output=True, check=False)
    assert verify.returncode == 0, verify.stderr
    assert dense or out.stat().st_size / 4 < 3.5e6  # rendered grain does not compress: the real slice is smaller


def test_the_recording_tells_settings_versions_and_input(room, tmp_path):
    out = tmp_path / "room.rrd"
    done = vlmm_log.process(room, rrd=out)
    told = properties(out)
    assert vlmm_log.Settings.load(sets=()).to_toml() == told["vlmm:settings"]
    assert told["vlmm_end:input_hash"] == done.end.input_hash
    assert told["vlmm_end:complete"] is True
    versions = json.loads(told["vlmm:versions"])
    assert versions["vlmm-log"] == vlmm_log.__version__
    assert {"opencv-python-headless", "movability table"} <= versions.keys()


def test_interrupted_runs_leave_a_readable_partial(room, tmp_path):
    from rerun.chunk import RrdReader

    out = tmp_path / "room.rrd"

    def press_ctrl_c(done, _expected):
        if done == 2:
            raise KeyboardInterrupt

    done = vlmm_log.process(room, rrd=out, progress=press_ctrl_c)
    assert not done.end.complete
    assert not out.exists()
    (partial,) = done.outputs
    assert partial.name == "room.rrd.partial"
    seen = {c.entity_path for c in RrdReader(str(partial)).stream()}
    assert f"{IMAGE}/residual/d_m" in seen
    assert "/stats/median_d_m" in seen


def test_a_failing_run_keeps_the_good_output(room, tmp_path):
    out = tmp_path / "room.rrd"
    vlmm_log.process(room, rrd=out)
    before = out.read_bytes()

    class Broken(Memory):
        def write(self, result, at):
            super().write(result, at)
            if len(motions(self)) > most:
                raise InputError("no room left")

    most = 2
    with pytest.raises(InputError, match="no room left") as e:
        vlmm_log.process(room, rrd=tmp_path / "other.rrd", sinks=[Broken()])
    assert e.value.__notes__ == [f"what was written until then is kept as {tmp_path / 'other.rrd.partial'}"]
    assert entities(tmp_path / "other.rrd.partial")[f"{IMAGE}/residual/d_m"] >= most
    most = 0

    with pytest.raises(InputError, match="no room left"):
        vlmm_log.process(room, rrd=out, force=True, sinks=[Broken()])
    assert out.read_bytes() == before
    assert not (tmp_path / "room.rrd.partial").exists()  # it held no pair
    with pytest.raises(InputError, match="--force"):
        vlmm_log.process(room, rrd=out)


def test_a_log_without_poses_is_processed(room, tmp_path):
    import shutil

    bare = tmp_path / "bare"
    shutil.copytree(room, bare)
    (bare / "groundtruth.txt").unlink()
    with_poses, without = Memory(), Memory()
    vlmm_log.process(room, sinks=[with_poses])
    assert vlmm_log.process(bare, sinks=[without], rrd=tmp_path / "bare.rrd").end.pairs == 4
    for a, b in zip(motions(with_poses), motions(without), strict=True):
        assert np.nanmedian(np.abs(a.d_m - b.d_m) / a.d_m) < 0.1


def test_ctrl_c_keeps_what_was_written_and_exits_130(room, tmp_path):
    import signal
    import subprocess
    import sys

    command = [sys.executable, "-c", "from vlmm_log.cli import main; main()", "process", str(room), "--rrd", "a.rrd"]
    slow = {"flow.dis_preset": "medium", "ego.hypotheses": "100000"}
    command += [f"--set={name}={value}" for name, value in slow.items()]
    process = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    partial = tmp_path / "a.rrd.partial"
    while process.poll() is None and not (partial.exists() and partial.stat().st_size > 2_000_000):
        pass
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130, (process.returncode, out, err)
    assert "Traceback" not in err
    assert "interrupted" in out
    assert not (tmp_path / "a.rrd").exists()
    assert entities(partial)[f"{IMAGE}/residual/d_m"] >= 1


def test_a_failing_close_is_told_even_where_the_caller_handles_another_error(room):
    class Unclosable(Memory):
        def close(self, end):
            raise InputError("cannot be closed")

    try:
        raise ValueError("the caller's own")
    except ValueError:
        with pytest.raises(InputError, match="cannot be closed"):
            vlmm_log.process(room, sinks=[Unclosable()])


def test_an_interrupted_runs_partial_is_not_overwritten_unasked(room, tmp_path):
    (tmp_path / "a.rrd.partial").write_bytes(b"half a recording")
    with pytest.raises(InputError, match=r"a\.rrd\.partial: exists"):
        vlmm_log.process(room, rrd=tmp_path / "a.rrd")
    vlmm_log.process(room, rrd=tmp_path / "a.rrd", force=True)
    assert not (tmp_path / "a.rrd.partial").exists()


def test_equal_runs_give_equal_recordings_but_for_the_time_taken(room, tmp_path):
    from rerun.chunk import RrdReader

    def values(rrd):
        held = {}
        for chunk in RrdReader(str(rrd)).store().stream():
            batch = chunk.to_record_batch()
            kept = [c for c in batch.schema.names if "RowId" not in c]
            if not chunk.entity_path.startswith("/stats/stage_ms"):
                held.setdefault(chunk.entity_path, []).append({c: batch[c].to_pylist() for c in kept})
        return {path: sorted(map(repr, rows)) for path, rows in held.items()}

    for name in ("a.rrd", "b.rrd"):
        vlmm_log.process(room, rrd=tmp_path / name)
    assert values(tmp_path / "a.rrd") == values(tmp_path / "b.rrd")


@pytest.mark.parametrize("scale", [0.5, 2.0])
def test_the_printed_scale_calibrates_whatever_scale_the_run_had(room, scale):
    plain = vlmm_log.process(room).summary.figures()["calibrating_noise_scale"]
    other = vlmm_log.process(room, settings=vlmm_log.Settings.load(sets=[f"noise.scale={scale}"]))
    assert other.summary.figures()["calibrating_noise_scale"] == pytest.approx(plain, rel=0.1)


def test_ego_off_needs_poses(room, tmp_path):
    import shutil

    bare = tmp_path / "bare"
    shutil.copytree(room, bare)
    (bare / "groundtruth.txt").unlink()
    with pytest.raises(InputError, match="no poses, and ego"):
        vlmm_log.process(bare, settings=vlmm_log.Settings.load(sets=["ego.model=off"]))
