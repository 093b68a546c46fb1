"""The file of a Rerun recording: whole, or told."""

import resource
import signal
import threading
from contextlib import contextmanager

import numpy as np
import pytest
import rerun as rr
from rerun.chunk import RrdReader

from vlmm_log.sinks.rrd_file import RrdFile


def stream():
    return rr.RecordingStream("test", recording_id="test", send_properties=False)


def filled(rec, megabytes):
    noise = np.random.default_rng(0)  # which nothing compresses
    for k in range(megabytes):
        rec.set_time("frame", sequence=k)
        rec.log("image", rr.Image(noise.integers(0, 256, (1 << 10, 1 << 10), np.uint8)))


def writers():
    return [t for t in threading.enumerate() if t.name.startswith("writer of")]


@contextmanager
def largest_file(size):
    """No file of this process may grow beyond it."""
    before, ignored = resource.getrlimit(resource.RLIMIT_FSIZE), signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, ignored)


def test_all_that_was_logged_is_there_and_the_footer(tmp_path):
    rec = stream()
    with RrdFile(rec, tmp_path / "a.rrd") as file:
        filled(rec, 3)
        file.flush()
        filled(rec, 5)
        file.finish()
    rows = [c.num_rows for c in RrdReader(str(tmp_path / "a.rrd")).store().stream() if c.entity_path == "/image"]
    assert sum(rows) == 8
    assert not writers()


@pytest.mark.parametrize("size", [0, 100, 1 << 20, 5 << 20])
def test_a_refused_write_is_told_and_nobody_waits(tmp_path, size):
    rec = stream()
    with largest_file(size):
        file = RrdFile(rec, tmp_path / "a.rrd")
        filled(rec, 12)
        with pytest.raises(OSError, match="File too large"):
            file.finish()
    with pytest.raises(OSError, match="File too large"):  # and again
        file.flush()
    file.close()
    assert (tmp_path / "a.rrd").stat().st_size <= size
    assert not writers()


def test_a_stream_that_ends_without_its_footer_is_told(tmp_path):
    rec = stream()
    file = RrdFile(rec, tmp_path / "a.rrd")
    rec.save(tmp_path / "other.rrd")  # goes elsewhere
    for thread in writers():
        thread.join(60)  # it ends the file, whole
    (tmp_path / "a.rrd").write_bytes(b"not whole" * 9)
    with pytest.raises(OSError, match="its footer is missing"):
        file.finish()


def test_a_stream_that_cannot_open_its_end_is_told(tmp_path):
    class Unwilling:
        def save(self, path, default_blueprint):
            raise RuntimeError(f"{path}: no such file")

    with pytest.raises(OSError, match="no such file"):
        RrdFile(Unwilling(), tmp_path / "a.rrd")
    for thread in writers():
        thread.join(10)
    assert not writers()
