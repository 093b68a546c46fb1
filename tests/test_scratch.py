"""Temporary folders: no living process loses one, and of a killed one nothing stays."""

import gc
import subprocess
import sys
from pathlib import Path

from vlmm_log.scratch import scratch

KILLED = """
import os, signal, sys
from pathlib import Path
from vlmm_log.scratch import scratch
folder = scratch(Path(sys.argv[1]))
(Path(folder.name) / "deep").mkdir()
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_what_a_killed_process_left_is_removed_by_the_next(tmp_path):
    subprocess.run([sys.executable, "-c", KILLED, tmp_path], check=False)
    assert len(list(tmp_path.iterdir())) == 1
    held = scratch(tmp_path)
    assert [str(p) for p in tmp_path.iterdir()] == [held.name]


def test_what_is_in_use_stays(tmp_path):
    one, other = scratch(tmp_path), scratch(tmp_path)
    assert {Path(one.name), Path(other.name)} == set(tmp_path.iterdir())
    one.cleanup()
    assert {Path(other.name)} == set(tmp_path.iterdir())
    del other
    gc.collect()
    assert not list(tmp_path.iterdir())


def test_what_is_no_folder_of_ours_stays(tmp_path):
    for name in ("theirs", "vlmm-log-kept"):
        (tmp_path / name).mkdir()
    (tmp_path / "vlmm-log-run-file").touch()
    (tmp_path / "vlmm-log-run-link").symlink_to(tmp_path / "theirs")
    scratch(tmp_path).cleanup()
    assert {p.name for p in tmp_path.iterdir()} == {"theirs", "vlmm-log-kept", "vlmm-log-run-file", "vlmm-log-run-link"}
