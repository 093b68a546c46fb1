"""The same bytes, whatever the machine around is set to: one room through every command, one setting at a time."""

import locale
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from mcap.reader import make_reader
from small_room import write_small_room

RUNNER = Path(__file__).with_name("all_outputs.py")
PLAIN = {
    "TZ": "UTC",
    "LC_ALL": "C",
    "PYTHONHASHSEED": "0",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "OPENCV_FOR_THREADS_NUM": "1",
}
TIMES = "stats/stage_ms"


def run(folder, room, workers=1, **changes):
    """Every output, in a folder of its own."""
    folder.mkdir(parents=True)
    shutil.copytree(room, folder / "room")
    command = [sys.executable, str(RUNNER), str(workers)]
    environment = os.environ | PLAIN | changes
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return held(folder)


def held(folder):
    """File -> what must be equal: all bytes, but for what a stage took."""
    files = {p.name: p for p in folder.iterdir() if p.is_file()}
    reads = {".rrd": chunks, ".mcap": messages, ".txt": lines}
    return {name: reads.get(p.suffix, Path.read_bytes)(p) for name, p in sorted(files.items())}


def chunks(rrd):
    from rerun.chunk import RrdReader

    rows = []
    for chunk in RrdReader(str(rrd)).store().stream():
        batch = chunk.to_record_batch()
        kept = {c: batch[c].to_pylist() for c in batch.schema.names if "RowId" not in c}
        if not chunk.entity_path.startswith(f"/{TIMES}"):
            rows.append(repr((chunk.entity_path, kept)))
    return sorted(rows)


def messages(mcap):
    with mcap.open("rb") as file:
        reader = make_reader(file)
        told = [(m.name, m.metadata) for m in reader.iter_metadata()]
        rows = [(c.topic, m.log_time, m.sequence, m.data) for _, c, m in reader.iter_messages()]
    return told, [row for row in rows if not row[0].startswith(f"/{TIMES}")]


def lines(text):
    return [line for line in text.read_text("utf-8").splitlines() if " ms " not in line]


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs") / "room"
    write_small_room(folder)
    return folder


@pytest.fixture(scope="module")
def plain(room, tmp_path_factory):
    outputs = run(tmp_path_factory.mktemp("plain") / "x", room)
    assert len(outputs) == 21 and all(outputs.values())
    assert '  "matches": 4,' in outputs["query.txt"]
    return outputs


def assert_same(outputs, plain):
    assert outputs.keys() == plain.keys()
    assert [name for name in plain if outputs[name] != plain[name]] == []


def test_two_workers(room, plain, tmp_path):
    assert_same(run(tmp_path / "x", room, workers=2), plain)


def test_elsewhere(room, plain, tmp_path):
    changes = {"TZ": "Asia/Kathmandu", "PYTHONHASHSEED": "1"}
    changes |= {"OMP_NUM_THREADS": "2", "OPENBLAS_NUM_THREADS": "2", "OPENCV_FOR_THREADS_NUM": "2"}
    assert_same(run(tmp_path / "another place, ünnamed" / "und tiefer", room, **changes), plain)


def test_a_decimal_comma(room, plain, tmp_path):
    assert_same(run(tmp_path / "x", room, **comma(tmp_path)), plain)


def comma(folder):
    """What sets a locale that writes 1,5: the machine's own, or one made of its sources."""
    name = "de_DE.UTF-8"
    before = locale.setlocale(locale.LC_NUMERIC)
    try:
        locale.setlocale(locale.LC_NUMERIC, name)
        return {"LC_ALL": name}
    except locale.Error:
        make = shutil.which("localedef")
    finally:
        locale.setlocale(locale.LC_NUMERIC, before)
    command = [make, "-i", "de_DE", "-f", "UTF-8", folder / name]
    made = make and subprocess.run(command, capture_output=True, check=False)
    if not made or made.returncode > 1 or not (folder / name).is_dir():
        pytest.skip(f"{name} is neither installed nor can it be made")
    return {"LC_ALL": name, "LOCPATH": str(folder)}
