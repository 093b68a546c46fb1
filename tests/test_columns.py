"""Values that go to Rerun in columns: all of them arrive, in order, whenever they are sent."""

import numpy as np
import pytest
import rerun as rr
from rerun.chunk import RrdReader

from vlmm_log import rvl
from vlmm_log.entries import Arrows, Entry, Picture, Pose, Raster, Scalar, States, Steps
from vlmm_log.recording.rrd_values import values
from vlmm_log.sinks.rerun_values import RerunValues

RNG = np.random.default_rng(0)


def arrows(n, color):
    return Arrows(RNG.random((n, 2)).astype(np.float32), RNG.random((n, 2)).astype(np.float32), color)


MADE = {
    "scalar": lambda k: Scalar(k / 7),
    "picture": lambda k: Picture(bytes([k]) * (5 + k), "image/png" if k % 2 else "image/jpeg"),
    "steps": lambda _: Steps(rvl.encode_steps(RNG.random((9, 12)).astype(np.float32), 0.25), 0.25),
    "half": lambda k: Raster(np.full((2, 3, 4), k, np.float16), ("u", "v")),
    "single": lambda k: Raster(np.full((6, 3, 4), k, np.float32), ("xx", "xy", "xz", "yy", "yz", "zz")),
    "arrows": lambda k: arrows(k % 3, (1, 2, 3)),
    "colourless": lambda k: arrows(k % 3, None),
    "pose": lambda k: Pose(np.full(3, k, np.float32), np.array([0, 0, 0, 1], np.float32)),
    "states": lambda k: States(("moving", "still") if k % 2 else ("static", "unseen")),
}


def stream(path):
    rec = rr.RecordingStream("vlmm-log", recording_id="x", send_properties=False)
    rec.save(path)
    return rec, RerunValues(rec)


def read(path):
    found = {}
    for chunk in RrdReader(str(path)).stream():
        batch = chunk.to_record_batch()
        if "frame" not in batch.schema.names:
            continue
        names = [n for n in batch.schema.names if ":" in n]
        for row in range(batch.num_rows):
            cells = {n: batch.column(n)[row].values for n in names if batch.column(n)[row].is_valid}
            frame = batch.column("frame")[row].as_py()
            found.setdefault(chunk.entity_path.lstrip("/"), {})[frame] = next(iter(values(cells)))
    return found


def same(a, b):
    match a:
        case Scalar() | Picture() | States():
            return a == b or vars(a) == vars(b)
        case Steps():
            return np.array_equal(rvl.decode_steps(a.image, a.step), b.values, equal_nan=True)
        case Raster():
            return a.channels == b.channels and a.values.dtype == b.values.dtype and np.array_equal(a.values, b.values)
        case Arrows():
            return np.array_equal(a.origins, b.origins) and np.array_equal(a.vectors, b.vectors)
        case Pose():
            return np.array_equal(a.translation, b.translation) and np.array_equal(a.quaternion, b.quaternion)


@pytest.mark.parametrize("flushed", [(), (1,), (3, 4, 20)])
def test_all_values_arrive_as_they_were(tmp_path, flushed):
    rec, sink = stream(tmp_path / "a.rrd")
    put = {name: {k: make(k) for k in range(30)} for name, make in MADE.items()}
    for k in range(30):
        for name, rows in put.items():
            sink.put(Entry(name, rows[k], 10**18 + k, k))
        if k in flushed:
            sink.flush(least=5)
    sink.flush()
    rec.flush()
    rec.disconnect()
    found = read(tmp_path / "a.rrd")
    for name, rows in put.items():
        assert sorted(found[name]) == list(rows), name
        assert all(same(rows[k], found[name][k]) for k in rows), name


def test_short_histories_wait_and_dense_fields_do_not(tmp_path):
    rec, sink = stream(tmp_path / "a.rrd")
    for k in range(4):
        sink.put(Entry("history", Scalar(k), k, k))
        sink.put(Entry("field", MADE["steps"](k), k, k))
    sink.flush(least=5)
    rec.flush()
    assert set(read(tmp_path / "a.rrd")) == {"field"}
    sink.flush()
    rec.flush()
    rec.disconnect()
    assert len(read(tmp_path / "a.rrd")["history"]) == 4


def test_large_values_go_at_once(tmp_path):
    rec, sink = stream(tmp_path / "a.rrd")
    sink.put(Entry("large", Picture(bytes(200_000), "image/png"), 5, 5))
    rec.flush()
    assert len(read(tmp_path / "a.rrd")["large"][5].data) == 200_000
    rec.disconnect()


def test_rows_lie_in_the_order_of_their_frames_also_where_some_are_too_large_to_wait(tmp_path):
    rec, put = stream(tmp_path / "a.rrd")
    for k in range(6):
        put.put(Entry("x", Picture(bytes((1 << 18) if k % 3 == 2 else 9), "image/png"), 10 * k, k))
    put.flush()
    rec.disconnect()
    assert list(read(tmp_path / "a.rrd")["x"]) == list(range(6))
