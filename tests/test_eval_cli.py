"""``vlmm-log eval`` as a subprocess: exit codes, one line an error, JSON that is nothing else."""

import json
import re
import shutil
from functools import partial

import numpy as np
import pytest
from command_line import command
from small_room import write_masks, write_small_room


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs") / "room"
    write_small_room(folder)
    return folder


evaluate = partial(command, "eval")


def test_json_on_standard_output_is_nothing_else(room, tmp_path):
    done = evaluate(room, "--json", "-", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    (e,) = json.loads(done.stdout)["evaluations"]
    assert e["pixels"][0]["ap"] > 0.5 and e["things"]["elements"] == 4
    assert not list(tmp_path.iterdir())


def test_everything_at_once(room, tmp_path):
    asked = ["--ablate", "--baselines", "--association", "--pose-noise", "1.5,3"]
    asked += ["--sweep", "objects.quantile=0.5,0.9", "--gap", "1"]
    outputs = ("--calibrate", "c.json", "--html", "e.html", "--json", "e.json")
    done = evaluate(room, *asked, *outputs, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stderr == "" or "pairs" in done.stderr
    for word in ("without row-linear ego", "objects.quantile=0.9", "Khronos-style", "IDF1", "ECE of", "wrote c.json"):
        assert word in done.stdout
    assert not re.search(r"\bnan\b", done.stdout)
    again = evaluate(room, *asked, *outputs, cwd=tmp_path)
    assert again.returncode == 2 and "--force" in again.stderr
    judged = evaluate(room, "--gap", "1", "--calibration", "c.json", cwd=tmp_path)
    assert judged.returncode == 0 and "ECE of calibrated" in judged.stdout
    other = evaluate(room, "--calibration", "c.json", cwd=tmp_path)
    assert other.returncode == 2 and "keyframes.gap" in other.stderr


def test_without_movers_a_dash_is_shown(room, tmp_path):
    write_masks(tmp_path / "still", {k: np.zeros((120, 160)) for k in range(3)})
    done = evaluate(room, "--truth", "still", "--html", "e.html", cwd=tmp_path)
    assert done.returncode == 0 and "arning" not in done.stderr
    assert "–" in done.stdout and not re.search(r"\bnan\b", done.stdout)
    told = evaluate(room, "--truth", "still", "--calibrate", "c.json", cwd=tmp_path)
    assert told.returncode == 2 and "nothing to fit" in told.stderr


def test_a_segmenter_that_is_named_is_taken(room, tmp_path):
    done = evaluate(room, "--segmenter", "geometric", "--json", "-", cwd=tmp_path)
    (e,) = json.loads(done.stdout)["evaluations"]
    assert "masks" not in e["versions"]
    masks = evaluate(room, "--json", "-", cwd=tmp_path)
    assert "masks" in json.loads(masks.stdout)["evaluations"][0]["versions"]


def bare(room, out):
    """A log without truth."""
    log = shutil.copytree(room, out / "bare")
    shutil.rmtree(log / "truth")
    return log


FAULTS = {
    "no log": (lambda room, out: (out / "none",), "none"),
    "no truth": (lambda room, out: (bare(room, out),), "no truth in it"),
    "truth folder missing": (lambda room, out: (room, "--truth", "none"), "neither"),
    "unknown setting": (lambda room, out: (room, "--sweep", "noise.scael=1,2"), "nearest is noise.scale"),
    "no values": (lambda room, out: (room, "--sweep", "noise.scale"), "give a setting and its values"),
    "shared setting": (lambda room, out: (room, "--sweep", "keyframes.gap=1,2"), "all trials share"),
    "pose noise": (lambda room, out: (room, "--pose-noise", "1"), "degrees and cm"),
    "no calibration": (lambda room, out: (room, "--calibration", room / "camera.txt"), "no calibration"),
    "calibration missing": (lambda room, out: (room, "--calibration", "none.json"), "none.json"),
    "output is a folder": (lambda room, out: (room, "--html", out), "is a folder"),
    "output twice": (lambda room, out: (room, "--html", "a", "--json", "a"), "two outputs"),
    "recordings in a file": (lambda room, out: (room, "--rrd", room / "camera.txt"), "is a file"),
    "segmenter": (lambda room, out: (room, "--segmenter", "yolov"), "yolov"),
    "person": (lambda room, out: (room, "--truth", "person"), "nobody was found"),
    "no pairs": (lambda room, out: (room, "--gap", "90"), "no frame 90 frames later"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_errors_are_one_line_and_exit_2(room, tmp_path, name):
    arguments, expected = FAULTS[name]
    done = evaluate(*arguments(room, tmp_path), cwd=tmp_path)
    assert done.returncode == 2 and done.stdout == ""
    assert expected in done.stderr and "internal error" not in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1, done.stderr
