"""A log by several processes: the same to the bit, whatever their number, and every end is told."""

import os
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

import render_room
import vlmm_log
from vlmm_log.sinks.memory import Memory
from vlmm_log.types import Frame, InputError, Motion, Skipped
from vlmm_log.workers.slot import Slot

QUERIES = ("things that moved", "things that never moved")
SMALL = (160, 120)  # px


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """A small room with poses, without, and with an image in its middle that cannot be read."""
    import cv2

    folder = tmp_path_factory.mktemp("logs")
    render_room.write_tum(folder / "posed", 9)
    for image in (folder / "posed").glob("*/*.png"):
        pixels = cv2.imread(str(image), cv2.IMREAD_UNCHANGED)
        cv2.imwrite(str(image), cv2.resize(pixels, SMALL, interpolation=cv2.INTER_NEAREST))
    scale = SMALL[0] / 640
    rows = [f"{name} {value * scale}" for name, value in (("fx", 525.0), ("fy", 525.0), ("cx", 319.5), ("cy", 239.5))]
    (folder / "posed/camera.txt").write_text("\n".join(rows) + "\n")
    for name in ("bare", "damaged"):
        shutil.copytree(folder / "posed", folder / name)
    (folder / "bare/groundtruth.txt").unlink()
    sorted((folder / "damaged/rgb").iterdir())[4].write_bytes(b"no image")
    return folder


def run(log, out, workers, **options):
    out.mkdir()
    sink = Memory()
    return vlmm_log.process(
        log,
        rrd=out / "a.rrd",
        map=out / "a.json",
        queries=QUERIES,
        sinks=[sink],
        workers=workers,
        **options,
    ), sink


@pytest.fixture(scope="module")
def runs(logs, tmp_path_factory):
    """Every log by one, two and three processes."""
    out = tmp_path_factory.mktemp("runs")
    return {
        (name, n): run(logs / name, out / f"{name}{n}", n) for name in ("posed", "bare", "damaged") for n in (1, 2, 3)
    }


def same(a, b):
    """Arrays, texts and numbers of two results, to the bit."""
    if isinstance(a, np.ndarray):
        assert (a.dtype, a.shape, a.tobytes()) == (b.dtype, b.shape, b.tobytes())
    elif hasattr(a, "__dataclass_fields__"):
        assert type(a) is type(b)
        for name in a.__dataclass_fields__:
            if not callable(getattr(a, name)) and not name.startswith("encoded"):
                same(getattr(a, name), getattr(b, name))
    elif isinstance(a, dict):
        assert a.keys() == b.keys()
        for key in a:
            same(a[key], b[key])
    elif isinstance(a, tuple | list):
        assert len(a) == len(b)
        for x, y in zip(a, b, strict=True):
            same(x, y)
    else:
        assert repr(a) == repr(b)


@pytest.mark.parametrize("name", ["posed", "bare", "damaged"])
@pytest.mark.parametrize("workers", [2, 3])
def test_any_number_of_workers_gives_the_same_to_the_bit(runs, name, workers):
    (one, seen), (many, seen_by_many) = runs[name, 1], runs[name, workers]
    difference = vlmm_log.diff(one.outputs[0], many.outputs[0])
    assert difference.same, difference
    assert one.outputs[1].read_bytes() == many.outputs[1].read_bytes()
    assert one.end == many.end and one.end.told == many.end.told
    assert one.run == many.run
    same(one.answers, many.answers)
    figures = [{k: v for k, v in done.summary.figures().items() if not k.endswith("_ms")} for done in (one, many)]
    assert repr(figures[0]) == repr(figures[1])
    assert one.summary.skipped == many.summary.skipped
    assert [type(r) for _, r in seen.seen] == [type(r) for _, r in seen_by_many.seen]
    for (at, a), (at_b, b) in zip(seen.seen, seen_by_many.seen, strict=True):
        assert (at.stamp_ns, at.index) == (at_b.stamp_ns, at_b.index)
        same(a, b)


def test_recordings_hold_pairs_in_the_order_of_frames(runs):
    from rerun.chunk import RrdReader

    done, _ = runs["posed", 3]
    rows = []
    for chunk in RrdReader(str(done.outputs[0])).stream():
        if chunk.entity_path == "/world/camera/image/residual/d_m" and not chunk.is_static:
            rows += chunk.to_record_batch()["frame"].to_pylist()
    assert rows == list(range(done.end.pairs))


def test_what_is_left_out_in_the_middle_is_told_in_its_place(runs):
    _, sink = runs["damaged", 2]
    order = [r.reason if isinstance(r, Skipped) else at.index for at, r in sink.seen if isinstance(r, Skipped | Motion)]
    assert sum(isinstance(x, str) for x in order[:4]) == 1
    assert runs["damaged", 2][0].end.pairs == 5


def test_a_sinks_results_stay_read_only_and_give_covariances(runs):
    motions = [[r for _, r in runs["posed", n][1].seen if isinstance(r, Motion)] for n in (1, 2)]
    for one, other in zip(*motions, strict=True):
        assert not other.d_m.flags.writeable
        same(one.covariances(4), other.covariances(4))


def test_an_error_in_a_worker_is_the_one_that_one_process_raises(logs, tmp_path):
    import cv2

    shutil.copytree(logs / "posed/masks", tmp_path / "masks")
    masks = sorted((tmp_path / "masks").glob("*.png"))
    cv2.imwrite(str(masks[3]), np.zeros((5, 5), np.uint8))  # of another size: an error of the segmenter
    s = vlmm_log.Settings.load(sets=[f"objects.segmenter=masks:{tmp_path / 'masks'}"])
    told = []
    for n in (1, 2):
        with pytest.raises(InputError, match="mask is 5x5") as e:
            run(logs / "posed", tmp_path / str(n), n, settings=s)
        told.append(str(e.value))
        assert (tmp_path / str(n) / "a.rrd.partial").exists()  # the three pairs before it
    assert told[0] == told[1]


class Own:
    """A log that cannot be pickled, and may fail."""

    name, has_poses, world_up, notes = "own", False, "-y", []

    def __init__(self, frames, fails=False):
        self._frames, self._fails = frames, fails
        self.unpicklable = lambda: None

    def count(self, start_ns, stop_ns):
        return len(self._frames)

    def frames(self, start_ns, stop_ns):
        yield from self._frames
        if self._fails:
            raise InputError("the log ends in nothing")


@pytest.fixture(scope="module")
def frames(logs):
    return [f for f in vlmm_log.open_log(logs / "posed").frames(0, 10**12) if isinstance(f, Frame)]


def test_a_log_of_ones_own_need_not_be_picklable(frames):
    done = [vlmm_log.process(Own(frames), workers=n) for n in (1, 2)]
    assert done[0].end == done[1].end
    same(done[0].map.world.columns, done[1].map.world.columns)


def test_an_error_of_the_log_comes_after_the_pairs_before_it(frames):
    sink = Memory()
    with pytest.raises(InputError, match="ends in nothing"):
        vlmm_log.process(Own(frames, fails=True), sinks=[sink], workers=2)
    assert sum(isinstance(r, Motion) for _, r in sink.seen) == len(frames) - 3


def test_a_killed_worker_ends_the_run_and_keeps_what_was_written(frames, tmp_path):
    import multiprocessing

    def kill(done, _expected):
        if done == 2:
            for child in multiprocessing.active_children():
                os.kill(child.pid, signal.SIGKILL)

    with pytest.raises(InputError, match=r"worker process ended unasked \(SIGKILL\)") as e:
        vlmm_log.process(Own(frames * 3), rrd=tmp_path / "a.rrd", workers=2, progress=kill)
    assert "\n" not in str(e.value)
    assert e.value.__notes__ == [f"what was written until then is kept as {tmp_path / 'a.rrd.partial'}"]
    assert not multiprocessing.active_children()


def test_ctrl_c_leaves_a_readable_partial_and_no_process(logs, tmp_path):
    from rerun.chunk import RrdReader

    command = [sys.executable, "-c", "from vlmm_log.cli import main; main()", "process", str(logs / "posed")]
    command += ["--rrd", "a.rrd", "--workers", "2", "--set=ego.hypotheses=100000"]  # slow
    process = subprocess.Popen(
        command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    partial = tmp_path / "a.rrd.partial"
    until = time.monotonic() + 60
    while process.poll() is None and time.monotonic() < until:
        if partial.exists() and partial.stat().st_size > 2e5:  # it holds a pair
            break
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to all of them
    out, err = process.communicate(timeout=60)  # until nobody holds its pipes: no worker is left
    assert process.returncode == 130, (process.returncode, out, err)
    assert "Traceback" not in err, err
    assert "interrupted" in out
    assert not (tmp_path / "a.rrd").exists()
    assert any(c.entity_path.endswith("/d_m") for c in RrdReader(str(partial)).stream())


@pytest.mark.parametrize("workers", [0, 10_000])
def test_none_and_far_too_many_workers_are_refused(logs, workers):
    with pytest.raises(InputError, match=f"workers = {workers}: give 1 to"):
        vlmm_log.process(logs / "posed", workers=workers)


def test_messages_come_out_of_a_slot_as_they_went_in(tmp_path):
    writer, reader = Slot(tmp_path / "slot"), Slot(tmp_path / "slot")
    big = np.arange(300_000.0).reshape(3, -1)
    for message in ((), {"a": np.zeros((0, 3), np.float32)}, [big, b"\x00\xff", "text", big.T], [np.int8([1])], big):
        got = reader.get(writer.put(message))
        same(message, got)
    assert not got.flags.writeable and got.flags.aligned
    assert got.base is not None and got.base.nbytes == big.nbytes  # it keeps nothing else in memory
    writer.close()
    reader.close()
