"""The examples as scripts, from a folder that is not the repository. The simulator's and the viewer's need theirs."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import vlmm_log
from vlmm_log.types import Frame

EXAMPLES = Path(__file__).parents[1] / "examples"


def run(name, *arguments, cwd):
    command = [sys.executable, EXAMPLES / name, *map(str, arguments)]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    folder = tmp_path_factory.mktemp("examples")
    done = run("render_room.py", "room", 7, cwd=folder)
    assert (done.returncode, done.stdout) == (0, "wrote room\n"), done.stderr
    return folder / "room"


def test_from_python_tells_the_log_the_map_and_the_first_difference(room, tmp_path):
    done = run("from_python.py", room, "out", "things that never moved", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    lines = done.stdout.splitlines()
    assert lines[0] == "room: 7 frames, 0 left out; poses: True"
    assert any(line.startswith("  pairs ") for line in lines)
    assert any(line.startswith("things that never moved: ") for line in lines)
    assert lines[-1] == "the runs part at frame 0, stage matches"
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"before.rrd", "after.rrd", "map.json"}


def test_from_python_says_in_a_line_what_it_cannot_use(tmp_path):
    done = run("from_python.py", tmp_path / "none", "out", cwd=tmp_path)
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    assert str(tmp_path / "none") in done.stderr


def test_own_reader_processes_arrays(room, tmp_path):
    frames = [item for item in vlmm_log.open_log(room).frames(0, 2**62) if isinstance(item, Frame)]
    arrays = {name: np.stack([getattr(f, name) for f in frames]) for name in ("rgb", "depth")}
    arrays |= {"K": frames[0].K, "stamps_ns": np.array([f.stamp_ns for f in frames])}
    poses = np.stack([f.T_world_cam for f in frames])
    poses[1] = np.nan  # it is told, and left out
    np.savez(tmp_path / "my.npz", poses=poses, **arrays)
    done = run("own_reader.py", "my.npz", "my.rrd", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1].endswith("elements: my.rrd")
    assert vlmm_log.load_map(tmp_path / "my.rrd").end.frames == 6
