"""The command line as a user meets it: exit codes, one line on stderr, and what lies on disk afterwards."""

import json
import subprocess
import sys

import numpy as np
import pytest
from command_line import command

from tum_folder import ORIGIN_NS, png, rows, write_tum_folder
from vlmm_log import cli
from vlmm_log.settings import Settings
from vlmm_log.types import InputError

STILL = rows([ORIGIN_NS - 10**8 + k * 10**8 for k in range(9)], ["0 0 0 0 0 0 1"] * 9)
GOOD = {"size": (96, 72), "frames": 6, "shift_px": 1, "groundtruth": STILL}
HEAVY = ("numpy", "rerun", "cv2", "numba", "torch", "scipy", "sklearn", "rosbags", "mcap")


def python(code, *args, cwd):
    command = [sys.executable, "-c", code, *map(str, args)]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=300, check=False)


def refused(*args, cwd, kept=()):
    """The one line with which the command line refuses; no file was left behind but those in ``kept``."""
    done = command(*args, cwd=cwd)
    assert done.returncode == 2, done
    left = [p for p in cwd.rglob("*") if p.suffix in (".rrd", ".partial")]
    assert sorted(left) == sorted(kept)
    assert not done.stdout
    assert "Traceback" not in done.stderr
    assert "internal error" not in done.stderr
    lines = done.stderr.splitlines()
    assert len(lines) == 1, done.stderr
    return lines[0]


BAD_LOGS = {  # what is wrong -> (how the folder is written, options, what is told)
    "no rgb.txt": ({"files": {"rgb.txt": None}}, [], "rgb.txt: not found"),
    "no depth.txt": ({"files": {"depth.txt": None}}, [], "depth.txt: not found"),
    "empty rgb.txt": ({"files": {"rgb.txt": ""}}, [], "rgb.txt: lists no image"),
    "empty depth.txt": ({"files": {"depth.txt": "#\n"}}, [], "depth.txt: lists no image"),
    "binary list": ({"files": {"rgb.txt": b"\x89PNG\xff\0"}}, [], "rgb.txt: cannot be read"),
    "nothing near": ({"offset_ns": 50_000_000}, [], "no colour image within 0.02 s"),
    "huge stamp": ({"files": {"depth.txt": "1e30 depth/0.png\n"}}, [], "depth"),
    "no intrinsics": ({"camera": None}, [], "no intrinsics"),
    "poor camera.txt": ({"camera": "fx 60\n"}, [], "camera.txt: lacks fy, cx, cy"),
    "camera.txt of words": ({"camera": "fx sixty\n"}, [], "camera.txt:1: write a name and a number"),
    "other size": (
        {"camera": "fx 9\nfy 9\ncx 9\ncy 9\nwidth 9\nheight 9"},
        [],
        "intrinsics (camera.txt) are for 9x9",
    ),
    "8-bit depth": ({"depth_dtype": np.uint8}, [], "depth image is 8-bit; 16-bit PNG is expected (6x)"),
    "no images": ({"files": {f"rgb/{k}.png": None for k in range(6)}}, [], "listed file is missing (6x)"),
    "empty images": ({"files": {f"depth/{k}.png": b"" for k in range(6)}}, [], "cannot be decoded (6x)"),
    "colour as depth": (
        {"files": {f"depth/{k}.png": png(np.zeros((72, 96, 3), np.uint8)) for k in range(6)}},
        [],
        "depth image has 3 channels",
    ),
    "one frame": ({"frames": 1}, [], "no pair of frames"),
    "empty window": ({}, ["--start", "9"], "no pair of frames"),
    "gap past the end": ({}, ["--gap", "6"], "no frame 6 frames later (6x)"),
}


@pytest.mark.parametrize(("written", "options", "told"), BAD_LOGS.values(), ids=BAD_LOGS)
def test_a_log_that_cannot_be_used(tum_folder, tmp_path, written, options, told):
    folder = tum_folder(**GOOD | written)
    line = refused("process", folder, *options, cwd=tmp_path)
    assert str(folder) in line
    assert told in line


def test_truncated_images(tum_folder, tmp_path):
    folder = tum_folder(**GOOD)
    for path in folder.glob("rgb/*.png"):
        path.write_bytes(path.read_bytes()[:3000])
    assert f"{folder}: no pair" in refused("process", folder, cwd=tmp_path)


def test_a_path_that_is_no_log(tum_folder, tmp_path):
    folder = tum_folder()
    for path, told in (
        (tmp_path / "nowhere", "no such file"),
        (folder / "rgb.txt", "no known kind"),
        (tmp_path, "log"),
    ):
        line = refused("process", path, cwd=tmp_path)
        assert str(path) in line
        assert told in line
    assert line.endswith("take one: log")


def test_a_gap_that_holds_too_many_frames(tum_folder, tmp_path):
    folder = tum_folder(size=(32, 32), frames=303, step_ns=1_000_000, offset_ns=0)
    assert "'9s' spans more than 300 frames" in refused("process", folder, "--gap", "9s", cwd=tmp_path)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--set", "keyframes.gapp=3"], "nearest is keyframes.gap"),
        (["--set", "nope=1"], "--set nope=1: no setting nope"),
        (["--set", "nope"], "table.name=value"),
        (["--set", "noise.alpha=2"], "out of range"),
        (["--set", "ego.model=a\nb"], "ego.model"),
        (["--set", "noise.alpha=" + "9" * 400], "noise.alpha"),
        (["--profile", "nope"], "no such profile"),
        (["--settings", "nowhere.toml"], "nowhere.toml"),
        (["--settings", "log/rgb/0.png"], "log/rgb/0.png: not a TOML file"),
        (["--flow", "nope"], "'nope' is not one of 'dis', 'raft'"),
        (["--flow", "raft", "--weights", "nowhere.pth"], "nowhere.pth: no such weights"),
        (["--flow", "raft", "--weights", "log"], "no RAFT weights"),
        (["--rrd"], "'--rrd' requires an argument"),
        (["--start", "soon"], "--start"),
        (["--stop", "nan"], "stop"),
        (["--gap", "x"], "keyframes.gap = 'x'"),
        (["--gap", "0"], "keyframes.gap"),
        (["--gap", "0s"], "keyframes.gap = '0s'"),
        (["--gap", "301"], "keyframes.gap = 301"),
        (["--gap", "²"], "keyframes.gap"),
        (["--intrinsics", "1,2,3"], "--intrinsics 1,2,3"),
        (["--intrinsics", "nowhere.txt"], "--intrinsics nowhere.txt"),
        (["--rrd", "log"], "log: is a folder"),
        (["--rrd", "log/rgb.txt/a.rrd"], "log/rgb.txt"),
        (["--nope"], "--nope"),
        (["extra"], "extra"),
    ],
    ids=lambda x: " ".join(x)[:40] if isinstance(x, list) else "",
)
def test_options_that_cannot_be_used(tum_folder, tmp_path, options, told):
    tum_folder(**GOOD)
    assert told in refused("process", "log", *options, cwd=tmp_path)


@pytest.mark.parametrize("args", [["nope"], ["process"], ["--nope"]])
def test_a_command_that_cannot_be_used(tmp_path, args):
    assert refused(*args, cwd=tmp_path).startswith("vlmm-log")


@pytest.mark.parametrize("name", ["read.stop_s", "read.association_s", "read.pose_gap_s", "read.depth_max_m"])
def test_a_limit_may_be_infinite(tum_folder, tmp_path, name):
    tum_folder(**GOOD)
    done = command("process", "log", "--set", f"{name}=inf", cwd=tmp_path)
    assert (done.returncode, (tmp_path / "log.rrd").is_file()) == (0, True), done.stderr


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """A folder with a log in it, and what processing it as JSON printed."""
    folder = tmp_path_factory.mktemp("good")
    write_tum_folder(folder / "log", **GOOD, files={"depth/5.png": b""})
    return folder, command("process", "log", "--rrd", "a.rrd", "--json", cwd=folder)


def no_constant(name):
    raise AssertionError(f"{name} is no JSON")


def test_a_good_run(good):
    folder, done = good
    assert (done.returncode, done.stderr) == (0, "")
    report = json.loads(done.stdout, parse_constant=no_constant)
    assert report["figures"]["pairs"] == 2
    assert 0 < report["figures"]["coverage"] <= 1
    assert report["skipped"] == {"depth image cannot be decoded": 1, "no frame 3 frames later": 3}
    assert len(bytes.fromhex(report["input_hash"])) == 32
    assert (report["complete"], report["frames"], report["reader"], report["outputs"]) == (
        True,
        5,
        "tum",
        ["a.rrd"],
    )
    assert (folder / "a.rrd").stat().st_size > 10_000
    assert not (folder / "a.rrd.partial").exists()


def test_an_existing_output_is_kept_unless_forced(good):
    folder, first = good
    out = folder / "a.rrd"
    before = out.read_bytes()
    line = refused("process", "log", "--rrd", "a.rrd", cwd=folder, kept=[out])
    assert "a.rrd: exists; give --force" in line
    assert out.read_bytes() == before
    bad = refused("process", "log", "--rrd", "a.rrd", "--force", "--start", "9", cwd=folder, kept=[out])
    assert "no pair of frames" in bad
    assert out.read_bytes() == before
    done = command("process", "log", "--rrd", "a.rrd", "--force", "--gap", "2", "--json", cwd=folder)
    assert done.returncode == 0
    assert out.read_bytes() != before
    again, once = json.loads(done.stdout), json.loads(first.stdout)
    assert (again["figures"]["pairs"], again["input_hash"]) == (3, once["input_hash"])


def test_a_good_run_without_poses_is_as_quiet(tum_folder, tmp_path):
    tum_folder(**GOOD | {"groundtruth": None})
    done = command("process", "log", "--rrd", "a.rrd", "--json", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert "no poses" in json.loads(done.stdout)["notes"]


def test_without_a_named_output_it_is_named_after_the_log(good, tmp_path):
    folder, _ = good
    done = command("process", folder / "log", "--profile", "paper", "--start", "0.1", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert "wrote log.rrd" in done.stdout
    assert "coverage (pixels scored)" in done.stdout
    assert "noted: depth image cannot be decoded" in done.stdout
    assert "wrote log.rrd" in done.stdout
    assert [p.name for p in tmp_path.iterdir()] == ["log.rrd"]


@pytest.mark.parametrize("args", [["--help"], ["process", "--help"], ["--version"]])
def test_help_is_light(tmp_path, args):
    code = "import sys; from vlmm_log.cli import main; main(); print(*sys.modules, file=sys.stderr)"
    done = python(code, *args, cwd=tmp_path)
    assert done.returncode == 0
    assert "vlmm-log" in done.stdout
    loaded = done.stderr.split()
    assert "vlmm_log.cli" in loaded
    assert not set(HEAVY) & set(loaded)


def test_labels_cannot_steer_the_terminal():
    from vlmm_log.commands.telling import printable

    assert printable("Stuhl \u6905 [bold]") == "Stuhl \u6905 [bold]"
    assert printable("a\x1b[2Jb\u202ec\n") == "a\\u001b[2Jb\\u202ec\\u000a"


def test_an_encoding_that_lacks_letters_is_no_error(tum_folder, tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONIOENCODING", "latin-1")
    tum_folder("Stuhl_\u6905", **GOOD)
    run = "from vlmm_log.cli import main; main()"
    done = python(run, "info", "Stuhl_\u6905", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("Stuhl_\\u6905 (tum)")
    assert python(run, "info", "\u6905", cwd=tmp_path).stderr == "vlmm-log: \\u6905: no such file or folder\n"


def test_what_cannot_be_raised_is_told_where_it_is_ours(monkeypatch, capsys):
    class HalfMade:
        def __init__(self, at_end):
            self.at_end = at_end

        def __del__(self):
            self.at_end()

    monkeypatch.setattr(sys, "unraisablehook", cli._unraisable)
    HalfMade(lambda: {}["of a library"])
    assert capsys.readouterr().err == ""
    HalfMade(lambda: Settings.load(sets=["no.such=1"]))
    assert "no.such" in capsys.readouterr().err


def test_memory_that_a_library_lacks_is_no_full_disk():
    def error(cause):
        e = InputError("a new thread.rrd: cannot be written")
        e.__cause__ = cause
        return cli._told(e)

    assert error(None) == error(OSError(28, "No space left on device")) == "a new thread.rrd: cannot be written"
    assert error(OSError(13, "Permission denied", "a new thread.rrd")) == "a new thread.rrd: cannot be written"
    missing = OSError("Failed to spawn background thread: Resource temporarily unavailable (os error 11)")
    assert error(missing).startswith("out of memory (a new thread.rrd: cannot be written): ")
