"""What recordings and the closing table take: no more than is new, and nothing of what could not be written."""

import json
import threading
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from small_room import write_small_room
from test_rrd_file import largest_file

import vlmm_log
import vlmm_log.sinks.mcap
from vlmm_log.background import empty_background, grown, summed
from vlmm_log.elements import OBSERVATION, Sightings, Tracked, WorldMap
from vlmm_log.entries import Entry, LabelNames, LogLine
from vlmm_log.outputs import replacing
from vlmm_log.protocols import Moment
from vlmm_log.sinks.content import Content
from vlmm_log.sinks.map_entries import MapEntries
from vlmm_log.sinks.recorder import Recorder, Recording
from vlmm_log.sinks.summary import Summary
from vlmm_log.types import InputError, Motion, RunEnd, Segments

VOXEL_M = 0.05


def corridor(k, width=40, height=60, step=4):
    """The wall that is seen at a step along it."""
    x, y = np.meshgrid(np.arange(k * step, k * step + width), np.arange(height), indexing="ij")
    cells = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], -1).astype(np.int64)
    return summed(cells, np.ones((len(cells), 4), np.int64), VOXEL_M)


def test_a_background_that_grows_no_more_is_logged_no_more():
    clouds, entries, logged = (empty_background(VOXEL_M),), MapEntries(), []
    for k in (*range(150), *range(150)):
        clouds = grown(clouds, corridor(k))
        world = WorldMap({}, {}, clouds)
        logged += [len(v.points) for name, v in entries.of_world(world, k) if name == "world/map/points"]
    whole = len(world.background.cells)
    assert sorted(set(logged)) == logged  # each larger than the one before
    assert whole > logged[-1] > whole / 1.6
    assert sum(logged) < 6 * whole
    assert [len(v.points) for _, v in entries.rest()] == [whole]


def shown(ids):
    """A frame in which elements of a name each are seen."""
    n = len(ids)
    labels = np.arange(n + 1, dtype=np.int32)[None]
    segments = Segments(labels, ("cup",) * n, np.ones(n, np.float32), np.full(n, -1, np.int64))
    boxes = np.zeros((n, 4), np.int32)
    sightings = Sightings(segments, np.zeros(n, OBSERVATION), boxes, np.ones(n, bool))
    return Tracked(sightings, np.zeros((n, 1), np.float32), np.array(ids, np.int64), np.ones(n, np.float32))


@pytest.mark.parametrize("n", [50, 2000])
def test_the_last_names_of_masks_are_those_of_all_frames(n):
    """The last ones hold for all times; told with each new one, they were the square of what was seen."""
    entries, told, known = MapEntries(), 0, {}
    for k in range(n):
        ids = range(k + 1, k + 6) if k < n - 1 else [n + 5]
        for name, value in entries.of_tracked(shown(ids)):
            if isinstance(value, LabelNames):
                assert name.endswith("/instances")
                known = {number: text for number, text, _ in value.classes}
                told += len(known)
        if k < 250:
            assert {i: known.get(i) for i in ids} == {i: f"{i} cup" for i in ids}
        assert known.keys() >= set(range(1, k - 65))
    for _, value in entries.rest():
        known = {number: text for number, text, _ in value.classes}
    assert known == {0: "", **{i: f"{i} cup" for i in (*range(1, n + 4), n + 5)}}
    assert list(entries.rest()) == []
    assert told < 256**2 + 10 * n


def motion(pixels, d_m):
    valid = np.ones((48, 64), np.uint8)
    d, residual = np.full((48, 64), np.nan, np.float32), np.full((3, 48, 64), np.nan, np.float32)
    for y, x in pixels:
        valid[y, x], d[y, x], residual[:, y, x] = 0, d_m, d_m * 0.01
    return Motion(residual, d, d.copy(), valid, 2.8, lambda _: None)


EVERY = [(y, x) for y in range(48) for x in range(64)]
FEW = [(1, 1), (2, 3)]  # between those that medians are taken of


def test_a_pair_of_few_pixels_takes_no_median_away():
    summary = Summary()
    for d_m, pixels in ((9, EVERY), (1, FEW), (1, EVERY), (2, EVERY), (3, EVERY)):
        summary.write(motion(pixels, d_m), Moment(0, 0, 1.0))
    figures = summary.figures()
    assert figures["residual_median_m"] == pytest.approx(0.025 * 3**0.5)
    assert figures["static_d_m2_median"] == pytest.approx(6.5)
    json.dumps(figures, allow_nan=False)


def test_a_table_of_few_pixels_alone_leaves_out_what_it_does_not_know():
    summary = Summary()
    summary.write(motion(FEW, 2.0), Moment(0, 0, 1.0))
    assert "calibrating_noise_scale" not in summary.figures()
    json.dumps(summary.figures(), allow_nan=False)


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rooms") / "room"
    write_small_room(folder)
    return folder


def test_a_run_on_a_full_disk_leaves_no_thread(room, tmp_path):
    before = threading.active_count()
    with largest_file(100_000):
        for _ in range(3):
            with pytest.raises(InputError, match="cannot be written") as told:
                vlmm_log.process(room, rrd=tmp_path / "a.rrd", mcap=tmp_path / "a.mcap", force=True)
            assert isinstance(told.value.__cause__, OSError)
    assert threading.active_count() == before


def test_where_the_second_recording_cannot_begin_nothing_is_left_of_the_first(room, tmp_path, monkeypatch):
    def refused(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(vlmm_log.sinks.mcap, "open_mcap", refused)
    with pytest.raises(InputError, match=r"a\.mcap: cannot be written: No space"):
        vlmm_log.process(room, rrd=tmp_path / "a.rrd", mcap=tmp_path / "a.mcap")
    assert list(tmp_path.iterdir()) == []


@dataclass
class Refusing:
    """A container on a disk that takes nothing."""

    ended: list = field(default_factory=list)

    def put(self, _):
        raise OSError(28, "No space left on device")

    def pair_begins(self):
        pass

    def finish(self, end):
        self.ended.append(end)


@pytest.mark.parametrize("pairs", [0, 3])
def test_every_recording_is_let_go_whatever_is_refused(tmp_path, monkeypatch, pairs):
    def refused(*_, **__):
        raise OSError(30, "Read-only file system")

    containers = [Refusing(), Refusing()]
    recordings = [Recording(tmp_path / name, c) for name, c in zip("ab", containers, strict=True)]
    with pytest.raises(InputError, match="No space"):
        Recorder(recordings, dense=False)  # its first words
    monkeypatch.setattr(Refusing, "put", lambda *_: None)
    recorder = Recorder(recordings, dense=False)
    monkeypatch.undo()
    monkeypatch.setattr(Path, "unlink", refused)
    monkeypatch.setattr(Content, "rest", lambda *_: [Entry("log", LogLine("rest", "INFO"), None, None)])
    with pytest.raises(InputError, match=r"a\.partial: cannot be written") as told:
        recorder.close(RunEnd(complete=True, input_hash="", frames=pairs, pairs=pairs))
    assert told.value.__notes__ == [f"then: {told.value}".replace("a.partial", "b.partial")]
    assert [[end.complete for end in c.ended] for c in containers] == [[False], [False]]
    assert [r.written for r in recordings] == ([r.partial for r in recordings] if pairs else [None, None])


def test_outputs_may_lie_in_folders_that_are_not_there_yet(tmp_path):
    paths = [tmp_path / "a" / "figures.json", tmp_path / "b" / "page.html"]
    with replacing(*paths, force=False) as partials:
        for partial in partials:
            partial.write_text("whole")
    assert [path.read_text() for path in paths] == ["whole", "whole"]
