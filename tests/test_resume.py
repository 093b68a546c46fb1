"""A run that goes on where an earlier one ended: equal to one that was never interrupted, or refused."""

import os
import shutil
import signal
import sqlite3
import subprocess
import sys
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from test_workers import logs as small_logs
from test_workers import same

import vlmm_log
from vlmm_log.elements import OBSERVATION
from vlmm_log.models.load import load_models
from vlmm_log.pipeline.run import Tally, keyframe_pairs
from vlmm_log.resuming.packing import pack, unpack
from vlmm_log.settings import Settings
from vlmm_log.sinks.content import told
from vlmm_log.sinks.summary import noted
from vlmm_log.types import FramePair, InputError, Motion
from vlmm_log.workers.worker import Looked, looked_at

logs = small_logs
QUERIES = ("things that moved",)


@pytest.fixture(scope="module")
def whole(logs, tmp_path_factory):
    """Runs that nothing interrupted."""
    out = tmp_path_factory.mktemp("whole")
    return {name: processed(logs / name, out / name) for name in ("posed", "bare", "damaged")}


def processed(log, out, **options):
    options.setdefault("map", out / "a.json")
    return vlmm_log.process(log, rrd=out / "a.rrd", queries=QUERIES, **options)


def interrupted(log, out, pairs, **options):
    """A run that Ctrl-C ends after so many pairs."""

    def told(done, _expected):
        if done == pairs:
            signal.raise_signal(signal.SIGINT)

    done = processed(log, out, resume=True, progress=told, **options)
    assert not done.end.complete and done.end.pairs == pairs
    assert (out / "a.rrd.partial").exists() and (out / "a.rrd.journal").exists()
    return done


@pytest.mark.parametrize("name", ["posed", "bare", "damaged"])
@pytest.mark.parametrize("workers", [(1, 1), (1, 2), (2, 1)])
def test_a_resumed_run_equals_an_uninterrupted_one(logs, whole, tmp_path, name, workers):
    before, after = workers
    interrupted(logs / name, tmp_path, 2, workers=before)
    done = processed(logs / name, tmp_path, resume=True, workers=after)
    assert 2 <= done.resumed < done.end.pairs
    one = whole[name]
    assert vlmm_log.diff(one.outputs[0], done.outputs[0]).same
    assert one.outputs[1].read_bytes() == done.outputs[1].read_bytes()
    assert (one.end, one.run, one.summary.skipped) == (done.end, done.run, done.summary.skipped)
    same(one.answers, done.answers)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.json", "a.rrd"]


def test_twice_interrupted_and_by_sigterm(logs, whole, tmp_path):
    interrupted(logs / "posed", tmp_path, 1)
    interrupted(logs / "posed", tmp_path, 3)

    def told(done, _expected):
        if done == 4:
            signal.raise_signal(signal.SIGTERM)

    assert not processed(logs / "posed", tmp_path, resume=True, progress=told).end.complete
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    done = processed(logs / "posed", tmp_path, resume=True)
    assert done.resumed == 5  # the one in hand was finished, and kept
    assert vlmm_log.diff(whole["posed"].outputs[0], done.outputs[0]).same


def test_what_cannot_be_gone_on_with_is_refused_and_kept(logs, tmp_path):
    interrupted(logs / "posed", tmp_path, 2)
    kept = (tmp_path / "a.rrd.journal").read_bytes()
    other = Settings.load(sets=["gate.fb_px=2.5"])
    for log, options, why in (
        ("posed", {"settings": other}, "another settings"),
        ("bare", {}, "another source"),
        ("posed", {"resume": False}, r"a\.rrd\.partial: exists"),
    ):
        with pytest.raises(InputError, match=why):
            processed(logs / log, tmp_path, **{"resume": True, **options})
    assert (tmp_path / "a.rrd.journal").read_bytes() == kept


def test_a_log_that_changed_meanwhile_is_refused_from_its_first_new_frame(logs, tmp_path):
    log = shutil.copytree(logs / "posed", tmp_path / "posed")
    interrupted(log, tmp_path, 3)
    recorded = (tmp_path / "a.rrd.partial").read_bytes()
    images = sorted((log / "rgb").iterdir())
    shutil.copyfile(images[0], images[4])
    with pytest.raises(InputError, match=r"of another log \(other images or poses from frame 1 on\)"):
        processed(log, tmp_path, resume=True)
    for image in images[4:]:
        image.unlink()
    with pytest.raises(InputError, match=r"of another log \(it ends before\)"):
        processed(log, tmp_path, resume=True)
    assert (tmp_path / "a.rrd.partial").read_bytes() == recorded


def test_a_run_that_ended_between_its_outputs_goes_on(logs, whole, tmp_path, monkeypatch):
    """What lies in its place already is its own; another one's needs force."""

    def killed(*_arguments, **_options):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr(vlmm_log.api, "save_map", killed)
        processed(logs / "posed", tmp_path, resume=True)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.rrd", "a.rrd.journal"]
    (tmp_path / "other.json").write_text("good")
    with pytest.raises(InputError, match=r"other\.json: exists"):
        processed(logs / "posed", tmp_path, resume=True, map=tmp_path / "other.json")
    (tmp_path / "other.json").unlink()
    done = processed(logs / "posed", tmp_path, resume=True)
    assert done.resumed == done.end.pairs
    assert vlmm_log.diff(whole["posed"].outputs[0], done.outputs[0]).same
    assert whole["posed"].outputs[1].read_bytes() == done.outputs[1].read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.json", "a.rrd"]


def test_a_damaged_row_and_all_after_it_are_looked_at_again(logs, whole, tmp_path):
    interrupted(logs / "posed", tmp_path, 4)
    rows = sqlite3.connect(tmp_path / "a.rrd.journal")
    data = bytearray(rows.execute("SELECT looked FROM pairs WHERE turn = 1").fetchone()[0])
    data[len(data) // 2] ^= 1
    with rows:
        rows.execute("UPDATE pairs SET looked = ? WHERE turn = 1", (bytes(data),))
    rows.close()
    done = processed(logs / "posed", tmp_path, resume=True)
    assert done.resumed == 1
    assert vlmm_log.diff(whole["posed"].outputs[0], done.outputs[0]).same


def test_nothing_is_lost_by_a_run_that_stops_before_its_first_pair(logs, tmp_path):
    interrupted(logs / "posed", tmp_path, 2)
    log = shutil.copytree(logs / "posed", tmp_path / "posed")
    images = sorted((log / "rgb").iterdir())
    kept = images[0].read_bytes()
    shutil.copyfile(images[4], images[0])
    with pytest.raises(InputError, match="from frame 0 on"):
        processed(log, tmp_path, resume=True)
    images[0].write_bytes(kept)
    assert processed(log, tmp_path, resume=True).resumed == 3


@pytest.mark.parametrize(
    "edit",
    [
        "UPDATE pairs SET looked = NULL WHERE turn = 0",
        "UPDATE pairs SET looked = 'text' WHERE turn = 0",
        "UPDATE pairs SET xxh3 = 'ffff' WHERE turn = 0",
        "DELETE FROM pairs WHERE turn = 0",
    ],
)
def test_a_row_that_is_no_packed_pair_is_looked_at_again(logs, tmp_path, edit):
    interrupted(logs / "posed", tmp_path, 2)
    edited(tmp_path / "a.rrd.journal", edit)
    done = processed(logs / "posed", tmp_path, resume=True)
    assert done.resumed == 0 and done.end.complete


@pytest.mark.parametrize(
    "edit", ["UPDATE run SET told = 'no JSON'", "DROP TABLE pairs; CREATE TABLE pairs (other TEXT)"]
)
def test_another_database_is_refused(logs, tmp_path, edit):
    interrupted(logs / "posed", tmp_path, 2)
    edited(tmp_path / "a.rrd.journal", edit)
    with pytest.raises(InputError, match=r"a\.rrd\.journal: cannot be used"):
        processed(logs / "posed", tmp_path, resume=True)


def test_somebody_elses_database_is_left_as_it_is(logs, tmp_path):
    edited(tmp_path / "theirs.db", "CREATE TABLE theirs (x)")
    before = (tmp_path / "theirs.db").read_bytes()
    (tmp_path / "a.rrd.journal").symlink_to(tmp_path / "theirs.db")
    with pytest.raises(InputError, match="of no run"):
        processed(logs / "posed", tmp_path, resume=True)
    assert (tmp_path / "theirs.db").read_bytes() == before and (tmp_path / "a.rrd.journal").is_symlink()


def edited(path, edit):
    rows = sqlite3.connect(path)
    rows.executescript(edit)
    rows.close()


def test_a_pipe_or_a_folder_in_the_journals_place(logs, tmp_path):
    os.mkfifo(tmp_path / "a.rrd.journal")
    with pytest.raises(InputError, match="a device or a pipe"):
        processed(logs / "posed", tmp_path, resume=True)
    (tmp_path / "a.rrd.journal").unlink()
    (tmp_path / "a.rrd.journal").mkdir()
    with pytest.raises(InputError, match="is a folder"):
        processed(logs / "posed", tmp_path, resume=True)


@pytest.mark.parametrize("content", [b"no database at all" * 100, b"SQLite format 3\0" + bytes(3000)])
def test_a_journal_that_is_none(logs, tmp_path, content):
    (tmp_path / "a.rrd.journal").write_bytes(content)
    with pytest.raises(InputError, match=r"a\.rrd\.journal: cannot be used .*remove it to start anew"):
        processed(logs / "posed", tmp_path, resume=True)


def test_two_runs_at_one_output(logs, tmp_path):
    interrupted(logs / "posed", tmp_path, 1)
    rows = sqlite3.connect(tmp_path / "a.rrd.journal", isolation_level=None)
    rows.execute("BEGIN EXCLUSIVE")
    with pytest.raises(InputError, match="is another run at it"):
        processed(logs / "posed", tmp_path, resume=True)
    rows.close()


def test_an_output_that_is_there_needs_force_still(logs, tmp_path):
    (tmp_path / "a.rrd").write_bytes(b"good")
    with pytest.raises(InputError, match=r"a\.rrd: exists"):
        processed(logs / "posed", tmp_path, resume=True)
    assert [path.name for path in tmp_path.iterdir()] == ["a.rrd"]


def test_resume_asks_for_an_output_and_for_no_sinks(logs, tmp_path):
    with pytest.raises(InputError, match="needs an output"):
        vlmm_log.process(logs / "posed", resume=True)
    with pytest.raises(InputError, match="sinks of your own"):
        vlmm_log.process(logs / "posed", rrd=tmp_path / "a.rrd", resume=True, sinks=[object()])


def test_a_run_that_fails_before_its_first_pair_keeps_nothing(logs, tmp_path):
    with pytest.raises(InputError, match="no pair"):
        processed(logs / "posed", tmp_path / "new", resume=True, settings=Settings.load(sets=["read.stop_s=0.01"]))
    assert not list((tmp_path / "new").iterdir())


def test_the_command_tells_how_to_go_on(logs, tmp_path):
    code = (
        "import contextlib, os, signal, sys\n"
        "from vlmm_log.cli import main\n"
        "sys.modules['vlmm_log.commands.process'].progress = lambda what, **_: contextlib.nullcontext("
        "lambda done, _: done == 2 and os.kill(os.getpid(), signal.SIGTERM))\n"
        "main()"
    )
    command = [sys.executable, "-c", code, "process", str(logs / "posed"), "--rrd", "a.rrd", "--resume"]
    first = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert first.returncode == 130
    assert "interrupted: the same command goes on from here" in first.stderr
    command[2] = "from vlmm_log.cli import main; main()"
    second = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert second.returncode == 0, second.stderr
    assert "went on after 3 pairs of an earlier run" in second.stderr


# ---- packing


@pytest.fixture(scope="module")
def shown(logs):
    """What a pair of the small room shows."""
    s = Settings.load(sets=["log.dense=true"])
    models = load_models(s)[0]
    frames = vlmm_log.open_log(logs / "posed").frames(0, 10**18)
    pair = next(p for p in keyframe_pairs(frames, s, Tally()) if isinstance(p, FramePair))
    return looked_at(pair, partial(_both, True), models, s)


def _both(dense, result, pair):
    return [noted(result), told(result, pair, dense=dense)]


def test_what_a_pair_shows_survives_to_the_bit(shown):
    again = unpack(pack(shown))
    assert isinstance(again, Looked) and pack(again) == pack(shown)
    same(again.look, shown.look)
    same(again.made, shown.made)
    for array in _arrays(again.look):
        assert not array.flags.writeable
        assert array.base is None or isinstance(array.base, bytes) or array.base.base is not None


def _arrays(value):
    if isinstance(value, np.ndarray):
        yield value
    elif hasattr(value, "__dataclass_fields__"):
        for name in value.__dataclass_fields__:
            yield from _arrays(getattr(value, name))


KINDS = ("<f4", "<f8", "<f2", "u1", "<u2", "<i4", "<i8", "?")


SHAPES = array_shapes(min_dims=0, max_dims=3, min_side=0)


@given(st.sampled_from(KINDS).flatmap(lambda kind: arrays(kind, SHAPES)), st.booleans())
def test_arrays_keep_bits_shape_and_how_they_lie(array, turned):
    array = array.T if turned else array
    again = unpack(pack(array))
    same(again, array)
    assert (again.flags.c_contiguous, again.flags.f_contiguous) == (array.flags.c_contiguous, array.flags.f_contiguous)


PLAIN = st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.text(), st.binary())


@given(st.recursive(PLAIN, lambda x: st.one_of(st.lists(x), st.lists(x).map(tuple), st.dictionaries(st.text(), x))))
def test_plain_values_keep_value_and_type(value):
    again = unpack(pack(value))
    assert type(again) is type(value) and repr(again) == repr(value)


@pytest.mark.parametrize("value", [np.float64(0.1), np.float32("nan"), np.int64(-3), np.zeros(3, OBSERVATION)[0:1]])
def test_numpys_scalars_and_rows_stay_what_they_are(value):
    again = unpack(pack(value))
    assert type(again) is type(value) and repr(again) == repr(value)


def test_no_other_type_is_kept():
    zeros = np.zeros((2, 2), np.float32)
    motion = Motion(np.zeros((3, 2, 2), np.float32), zeros, zeros, np.zeros((2, 2), np.uint8), 2.8, lambda stride: None)
    for value in (motion, object(), lambda: 0, np.array([object()]), np.zeros(1, "f4,f4"), {1, 2}):
        with pytest.raises(TypeError, match="not of the types that a run keeps"):
            pack(value)


@given(st.data())
def test_damaged_bytes_are_refused_or_values(shown, data):
    good = pack(shown.made)
    at = data.draw(st.integers(0, min(len(good), 20_000) - 1))
    bad = bytearray(good)
    bad[at] = data.draw(st.integers(0, 255))
    try:
        value = unpack(bytes(bad[: data.draw(st.sampled_from([len(good), at, at + 1]))]))
    except ValueError:
        return
    pack(value)  # of known types alone


def test_a_cut_is_always_refused(shown):
    good = pack(shown.look)
    for size in (0, 1, 7, 8, 100, len(good) // 2, len(good) - 1):
        with pytest.raises(ValueError, match=r"not what a run keeps|Expecting|Unterminated|reshape|buffer"):
            unpack(good[:size])
