"""Many logs: idempotence, what survives failures, engines, the manifest, and two batches compared."""

import json
import shutil
import signal
import subprocess
import sys
import threading
import time
from contextlib import closing
from importlib.util import find_spec
from pathlib import Path

import jsonschema
import pyarrow.parquet as pq
import pytest
from command_line import command

import fake_work
import vlmm_log
from tum_folder import ORIGIN_NS, rows, write_tum_folder
from vlmm_log.batches.cluster import run_ray
from vlmm_log.batches.content import content_digest, fingerprint
from vlmm_log.batches.folders import figures, folder_name, staged, write_figures
from vlmm_log.batches.local import run_local
from vlmm_log.batches.manifest import write_manifest
from vlmm_log.batches.tasks import Outcome, State, Task
from vlmm_log.compare_batches import diff_batches
from vlmm_log.fleet import _named_files
from vlmm_log.types import InputError

SCHEMA = json.loads((Path(__file__).parents[1] / "docs/manifest.schema.json").read_text())
STILL = rows([ORIGIN_NS - 10**8 + k * 10**8 for k in range(200)], ["0 0 0 0 0 0 1"] * 200)
POISON = {"depth.txt": ""}
needs_ray = pytest.mark.skipif(find_spec("ray") is None, reason="ray is not installed: pip install 'vlmm-log[ray]'")


def log(folder, **options):
    return write_tum_folder(folder, **{"size": (96, 72), "frames": 5, "groundtruth": STILL} | options)


def three(folder, poisoned=()):
    return [log(folder / f"log{k}", shift_px=k, files=POISON if k in poisoned else ()) for k in range(3)]


def states(done):
    return [str(o.state) for o in done.outcomes]


def content(out):
    """Bytes and time of change of every file."""
    return {p.relative_to(out): (p.read_bytes(), p.stat().st_mtime_ns) for p in out.rglob("*") if p.is_file()}


def start(*args, cwd):
    command = [sys.executable, "-c", "from vlmm_log.cli import main; main()", *map(str, args)]
    return subprocess.Popen(command, cwd=cwd, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def run(*args, cwd):
    done = command(*args, cwd=cwd)
    return done.returncode, done.stdout, done.stderr


def read_manifest(out):
    told = json.loads((out / "manifest.json").read_text())
    jsonschema.validate(told, SCHEMA)
    return told["tasks"]


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """Three logs, the second one poisoned, and their batch by two workers."""
    folder = tmp_path_factory.mktemp("batch")
    sources = three(folder, poisoned=[1])
    return sources, vlmm_log.batch(sources, folder / "out", workers=2)


def test_one_poisoned_log_is_told_and_the_others_are_done(finished):
    sources, done = finished
    assert states(done) == ["done", "failed", "done"]
    assert done.complete
    good, bad, _ = read_manifest(done.out)
    assert good["source"] == str(sources[0])
    assert (good["state"], good["pairs"], good["error"]) == ("done", 2, None)
    assert good["folder"].startswith("log0-")
    assert good["hash"][:12] == good["folder"][-12:]
    assert (bad["state"], bad["folder"], bad["pairs"]) == ("failed", None, None)
    assert str(sources[1] / "depth.txt") in bad["error"]
    assert sorted(p.name for p in (done.out / good["folder"]).iterdir()) == ["figures.json", "map.json", "run.rrd"]
    assert not list(done.out.glob("*.partial*"))


def test_a_second_call_runs_nothing_and_changes_no_byte(tmp_path):
    sources = three(tmp_path)
    vlmm_log.batch(sources, tmp_path / "out", workers=1)
    before = content(tmp_path / "out")
    told = []
    again = vlmm_log.batch(sources, tmp_path / "out", workers=1, progress=lambda k, n: told.append((k, n)))
    assert states(again) == ["skipped"] * 3
    assert told == [(1, 3), (2, 3), (3, 3)]
    after = content(tmp_path / "out")
    assert {p: b for p, (b, _) in after.items()} == {p: b for p, (b, _) in before.items()}
    inside = [p for p in after if len(p.parts) > 1]
    assert all(after[p] == before[p] for p in inside)
    jsonschema.validate({k: v for k, v in again.report().items() if k in SCHEMA["properties"]}, SCHEMA)


def test_the_rerun_of_a_mended_log_runs_only_that_one(finished, tmp_path):
    sources, done = finished
    out = shutil.copytree(done.out, tmp_path / "out")
    mended = log(tmp_path / "log1", shift_px=1)
    again = vlmm_log.batch([sources[0], mended, sources[2]], out, workers=1)
    assert states(again) == ["skipped", "done", "skipped"]


def test_what_is_changed_is_made_anew_beside_what_there_was(finished, tmp_path):
    sources, done = finished
    out = shutil.copytree(done.out, tmp_path / "out")
    before = content(out)
    other = vlmm_log.batch(sources[:1], out, settings=vlmm_log.Settings.load(sets=["keyframes.gap=2"]), workers=1)
    asked = vlmm_log.batch(sources[:1], out, queries=["things that moved"], recordings=(), workers=1)
    folders = {o.folder for o in (*done.of(State.DONE), *other.outcomes, *asked.outcomes)}
    assert states(other) == states(asked) == ["done"]
    assert len(folders) == 4
    assert not (out / asked.outcomes[0].folder / "run.rrd").exists()
    inside = [p for p in before if len(p.parts) > 1]
    assert all(content(out)[p] == before[p] for p in inside)


def test_a_torn_output_is_made_anew(finished, tmp_path):
    sources, done = finished
    out = shutil.copytree(done.out, tmp_path / "out")
    torn = out / done.outcomes[0].folder / "map.json"
    whole = torn.read_bytes()
    torn.write_bytes(whole[:-9])
    assert states(vlmm_log.batch(sources[:1], out, workers=1)) == ["done"]
    assert torn.read_bytes() == whole
    assert sorted(p.name for p in out.glob("*.partial*")) == []


def test_any_number_of_workers_makes_the_same(finished, tmp_path):
    sources, done = finished
    alone = vlmm_log.batch(sources, tmp_path / "out", workers=1)
    for a, b in zip(done.outcomes, alone.outcomes, strict=True):
        assert (a.state, a.folder, a.hash, a.error) == (b.state, b.folder, b.hash, b.error)
        if a.folder:
            x, y = done.out / a.folder, alone.out / b.folder
            assert (x / "map.json").read_bytes() == (y / "map.json").read_bytes()
            assert untimed(a.row) == untimed(b.row)
    compared = diff_batches(done.out, alone.out)
    assert [log.verdict for log in compared.logs] == ["same", "failed in both", "same"]
    assert compared.same


def untimed(row):
    return {name: value for name, value in row.items() if not name.endswith("_ms")}


def test_summary_has_a_row_a_log(finished):
    sources, done = finished
    table = pq.read_table(done.out / "summary.parquet").to_pylist()
    assert [row["source"] for row in table] == [str(s) for s in sources]
    assert [row["state"] for row in table] == ["done", "failed", "done"]
    good, bad, _ = table
    assert (good["pairs"], good["frames"], good["reader"]) == (2, 5, "tum")
    assert good["elements"] == good["static"] + good["movable_static"] + good["moving"]
    assert (good["movers"], bad["movers"], bad["pairs"]) == ([], None, None)
    assert good["static_d_m2_median"] == done.outcomes[0].row["static_d_m2_median"]


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
@pytest.mark.parametrize(("how", "code"), [(signal.SIGINT, 130), (signal.SIGKILL, -signal.SIGKILL)])
def test_an_interrupted_call_goes_on_where_it_was(tmp_path, how, code):
    sources = [log(tmp_path / "first"), *(log(tmp_path / name, frames=40) for name in ("second", "third"))]
    out = tmp_path / "out"
    process = start("batch", *sources, "--out", out, "--workers", 1, cwd=tmp_path)
    deadline = time.monotonic() + 120
    manifest = out / "manifest.json"  # written while the second log is begun already
    while not (manifest.exists() and list(out.glob("second-*.partial-*"))) and time.monotonic() < deadline:
        time.sleep(0.01)
    process.send_signal(how)
    _, err = process.communicate(timeout=60)
    assert process.returncode == code, err
    assert "Traceback" not in err
    assert [t["state"] for t in read_manifest(out)] == ["done", "pending", "pending"]
    assert states(vlmm_log.batch(sources, out, workers=1)) == ["skipped", "done", "done"]
    assert not list(out.glob("*.partial*"))


def tasks(folder, *kinds):
    return [Task(f"{folder}/{k}", str(folder), "", (kind,)) for k, kind in enumerate(kinds)]


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_a_worker_that_dies_is_its_logs_failure_alone(tmp_path):
    asked = tasks(tmp_path, "fine", "die", "abort", "exit", "print", "fine")
    with closing(run_local(asked, fake_work.work, workers=2)) as ended:
        found = {o.name: o for o in ended}
    assert [str(found[str(k)].state) for k in range(6)] == ["done", "failed", "failed", "failed", "done", "done"]
    assert [found[k].error for k in "123"] == [
        "its process was ended by SIGKILL: out of memory?",
        "its process was ended by SIGABRT",
        "its process ended with exit code 7; what it said is above",
    ]
    assert {found[k].row["threads"] for k in "045"} == {"1"}


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
@pytest.mark.parametrize(("retries", "state"), [(0, "failed"), (1, "done")])
def test_retries_are_for_logs_whose_process_died(tmp_path, retries, state):
    with closing(run_local(tasks(tmp_path, "die once"), fake_work.work, workers=1, retries=retries)) as ended:
        assert [str(o.state) for o in ended] == [state]


def test_no_worker_outlives_a_killed_parent(tmp_path):
    code = (
        "import sys, fake_work; from vlmm_log.batches.local import run_local; "
        "from vlmm_log.batches.tasks import Task; "
        "list(run_local([Task('/a', sys.argv[1], '', ('tick',))], fake_work.work, workers=1))"
    )
    paths = f"import sys; sys.path[:] = {sys.path!r}; "
    parent = subprocess.Popen([sys.executable, "-c", paths + code, str(tmp_path)])
    ticks = tmp_path / "ticks"
    deadline = time.monotonic() + 60
    while not ticks.exists() and time.monotonic() < deadline:
        time.sleep(0.01)
    parent.kill()
    parent.wait()
    time.sleep(0.5)
    last = ticks.read_text()
    time.sleep(0.2)
    assert ticks.read_text() == last


def test_the_first_to_finish_stays(tmp_path):
    """Two machines that make the same: as Ray may, when it takes one for lost."""
    folder = tmp_path / folder_name("a [log]\u202e", "0123456789abcdef")
    assert folder.name == "a__log__-0123456789ab"
    for who in ("first", "second"):
        with staged(folder) as staging:
            (staging / "map.json").write_text(who)
            write_figures(staging, {"hash": "h"})
    assert (folder / "map.json").read_text() == "first"
    assert figures(folder, "h")["files"] == {"map.json": 5}
    assert figures(folder, "another") is None
    assert [p.name for p in tmp_path.iterdir()] == [folder.name]


def test_the_digest_sees_names_and_bytes_through_links(tmp_path):
    log(tmp_path / "a")
    log(tmp_path / "b")
    assert content_digest(tmp_path / "a") == content_digest(tmp_path / "b")
    shutil.move(tmp_path / "b/rgb", tmp_path / "rgb")
    (tmp_path / "b/rgb").symlink_to(tmp_path / "rgb")
    assert content_digest(tmp_path / "a") == content_digest(tmp_path / "b")
    (tmp_path / "b/itself").symlink_to(tmp_path / "b")
    assert content_digest(tmp_path / "a") == content_digest(tmp_path / "b")
    image = bytearray((tmp_path / "rgb/1.png").read_bytes())
    image[-1] ^= 1
    (tmp_path / "rgb/1.png").write_bytes(image)
    assert content_digest(tmp_path / "a") != content_digest(tmp_path / "b")
    assert fingerprint({"a": "1", "b": "2"}) == fingerprint({"b": "2", "a": "1"}) != fingerprint({"a": "1b", "": "2"})


def test_masks_of_each_log(tmp_path):
    import cv2
    import numpy as np

    sources = []
    for k in range(2):
        source = log(tmp_path / f"log{k}")
        (source / "masks").mkdir()
        (source / "masks/labels.txt").write_text(f"1 thing{k}\n")
        for i in range(5):
            mask = np.zeros((72, 96), np.uint8)
            mask[20:60, 20:70] = 1
            cv2.imwrite(str(source / f"masks/{i:06d}.png"), mask)
        sources.append(source)
    s = vlmm_log.Settings.load(sets=["objects.segmenter=masks:{source}/masks"])
    done = vlmm_log.batch(sources, tmp_path / "out", settings=s, workers=1)
    assert states(done) == ["done", "done"]
    maps = [vlmm_log.load_map(done.out / o.folder / "map.json") for o in done.outcomes]
    assert [m.world.elements[1].label for m in maps] == ["thing0", "thing1"]


REFUSED = {
    "no such source": (["nowhere"], "nowhere: no such file or folder"),
    "a file for OUT": (["log", "--out", "log/rgb.txt"], "rgb.txt: is a file"),
    "OUT in a log": (["log", "--out", "log/out"], "lies in the log"),
    "engine": (["log", "--engine", "slurm"], "there are local, ray and ray:ADDRESS"),
    "query": (["log", "--query", "the chair that moved during the scan"], "during"),
    "setting": (["log", "--set", "keyframes.gpa=2"], "nearest is keyframes.gap"),
    "gpus": (["log", "--gpus", "0.5"], "is for engine ray"),
    "no source": ([], "Missing argument 'SOURCE"),
}


@pytest.mark.parametrize(("args", "told"), REFUSED.values(), ids=REFUSED)
def test_calls_that_cannot_be_used(tmp_path, args, told):
    log(tmp_path / "log")
    args = args if "--out" in args else [*args, "--out", "out"]
    code, out, err = run("batch", *args, cwd=tmp_path)
    assert (code, out) == (2, "")
    assert told in err
    assert len(err.splitlines()) == 1
    assert not (tmp_path / "out").exists()
    assert not (tmp_path / "log/out").exists()


def test_ray_that_is_missing(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(InputError, match=r"pip install 'vlmm-log\[ray\]'"):
        run_ray([], fake_work.work, address="", workers=1)


@pytest.mark.skipif(sys.platform == "win32", reason="flock")
def test_one_batch_at_a_time(tmp_path):
    import fcntl

    source = log(tmp_path / "log")
    (tmp_path / "out").mkdir()
    with (tmp_path / "out/.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        with pytest.raises(InputError, match="another batch writes there"):
            vlmm_log.batch([source], tmp_path / "out")


def test_the_command_tells_what_failed_without_steering_the_terminal(tmp_path):
    good, bad = log(tmp_path / "a [bold]"), log(tmp_path / "b\u202e", files=POISON)
    code, out, err = run("batch", good, bad, tmp_path / "gone", good, "--out", "out", "--workers", 1, cwd=tmp_path)
    assert code == 1, err
    assert "a [bold]" in out
    assert "\u202e" not in out
    assert "b\\u202e" in out
    assert "gone: no such file or folder" in out
    assert "3 logs: 1 done, 2 failed" in out
    code, out, _ = run("batch", good, "--out", "out", "--json", cwd=tmp_path)
    assert code == 0
    assert [t["state"] for t in json.loads(out)["tasks"]] == ["skipped"]


def test_two_batches_are_compared_log_by_log(finished, tmp_path):
    sources, done = finished
    other = vlmm_log.batch(
        sources[:1], tmp_path / "out", settings=vlmm_log.Settings.load(sets=["noise.scale=2"]), workers=1
    )
    code, out, _ = run("diff", done.out, other.out, cwd=tmp_path)
    assert code == 1
    assert "log0: different: settings: 1 differ: noise model (1); first divergence: frame 0" in out
    assert "log2: only in A" in out
    assert run("diff", done.out, done.out, cwd=tmp_path)[0] == 0
    code, out, _ = run("diff", done.out, other.out, "--json", "-", cwd=tmp_path)
    assert (code, json.loads(out)["same"]) == (1, False)
    empty = tmp_path / "empty"
    empty.mkdir()
    (empty / "manifest.json").write_text('{"format": "vlmm-log batch", "version": 1, "tasks": []}')
    code, _, err = run("diff", done.out, empty, cwd=tmp_path)
    assert (code, len(err.splitlines())) == (2, 1)
    assert "share no log" in err


def test_what_waits_or_is_absent_is_not_said_to_have_failed(finished, tmp_path):
    _, done = finished
    good = done.outcomes[0]
    before = {
        "a": [Outcome("/x/broken", State.FAILED, "no such file"), Outcome("/x/late", State.PENDING)],
        "b": [Outcome("/x/broken", State.FAILED, "no such file"), Outcome("/x/absent", State.PENDING)],
    }
    for name, others in before.items():
        shutil.copytree(done.out / good.folder, tmp_path / name / good.folder)
        write_manifest(tmp_path / name, [good, *others])
    compared = diff_batches(tmp_path / "a", tmp_path / "b")
    verdicts = ["same", "failed in both", "done in neither", "done in neither"]
    assert [log.verdict for log in compared.logs] == verdicts
    assert not compared.same


def test_a_file_that_is_called_like_a_setting_s_value_is_not_read(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("default", "table", "words", "none"):
        (tmp_path / name).mkdir()
    (tmp_path / "camera.txt").write_text("fx 60")
    s = vlmm_log.Settings.load(sets=["read.intrinsics=camera.txt", "objects.segmenter=masks:none"])
    assert [(name, path.name) for name, path in _named_files(s)] == [
        ("read.intrinsics", "camera.txt"),
        ("objects.segmenter", "none"),
    ]


def test_a_process_that_cannot_be_started_fails_its_log_alone(tmp_path, monkeypatch):
    def refused(*_, **__):
        raise OSError(11, "Resource temporarily unavailable")

    monkeypatch.setattr("vlmm_log.batches.local.subprocess.Popen", refused)
    done = vlmm_log.batch([log(tmp_path / "log")], tmp_path / "out", workers=1)
    assert states(done) == ["failed"]
    assert "no process can be started: Resource temporarily unavailable" in done.outcomes[0].error


def test_a_worker_without_a_process_leaves_its_task_to_the_others(tmp_path, monkeypatch):
    start, started, starting = subprocess.Popen, [], threading.Lock()

    def once(*args, **more):
        with starting:
            if started:
                raise OSError(11, "Resource temporarily unavailable")
            started.append(start(*args, **more))
            return started[0]

    monkeypatch.setattr("vlmm_log.batches.local.subprocess.Popen", once)
    with closing(run_local(tasks(tmp_path, *["fine"] * 8), fake_work.work, workers=3)) as ended:
        assert [str(o.state) for o in ended] == ["done"] * 8
    started.clear()
    with closing(run_local(tasks(tmp_path, "fine", "die", "fine", "fine"), fake_work.work, workers=1)) as ended:
        found = {o.name: o for o in ended}  # it was the last
    assert [str(found[k].state) for k in "0123"] == ["done", "failed", "failed", "failed"]
    assert {found[k].error for k in "23"} == {
        "no process can be started: Resource temporarily unavailable; give fewer --workers"
    }


@needs_ray
def test_ray_makes_the_same(finished, tmp_path):
    sources, done = finished
    by_ray = vlmm_log.batch(sources, tmp_path / "out", engine="ray", workers=2)
    assert states(by_ray) == ["done", "failed", "done"]
    assert [o.hash for o in by_ray.outcomes] == [o.hash for o in done.outcomes]
    again = vlmm_log.batch(sources, tmp_path / "out", engine="ray", workers=2)
    assert states(again) == ["skipped", "failed", "skipped"]
    assert diff_batches(done.out, by_ray.out).same


@needs_ray
def test_a_cluster_that_does_not_answer():
    with pytest.raises(InputError, match="no cluster answers there"):
        list(run_ray(tasks("/", "fine"), fake_work.work, address="127.0.0.1:1", workers=1))


@needs_ray
def test_ray_outlives_a_worker_that_dies(tmp_path):
    asked = tasks(tmp_path, "fine", "die", "fine")
    with closing(run_ray(asked, fake_work.work, address="", workers=1)) as ended:
        found = {o.name: o for o in ended}
    assert [str(found[str(k)].state) for k in range(3)] == ["done", "failed", "done"]
    assert "WorkerCrashedError" in found["1"].error
