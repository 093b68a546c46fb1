"""Pairs a second of `process`, images decoded and a lean recording written, against the paper written plainly.

    python -m benchmarks.pairs

The real slice, else the rendered room. Each run is a process of its own, kept to its cores; its first pairs do not
count.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from benchmarks import naive
from benchmarks.data import SLICE, WEIGHTS, frames, room
from benchmarks.rows import Row, cores, shown
from vlmm_log.models.load import load_models
from vlmm_log.settings import FlowSettings, Settings
from vlmm_log.types import FramePair

WARM = 20  # pairs
RUN = """
import json, os, resource, sys, time
from vlmm_log import process
from vlmm_log.heap import keep_pages
source, out, cores, workers = sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4])
if __name__ == "__main__":
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, set(sorted(os.sched_getaffinity(0))[:cores]))
    keep_pages()
    times = []
    began = time.perf_counter()
    told = lambda done, expected: times.append(time.perf_counter())
    done = process(source, rrd=out, force=True, workers=workers, progress=told)
    spent = {name[:-3]: value for name, value in done.summary.figures().items() if name.endswith("_ms")}
    print(json.dumps({"times": times, "began": began, "stages": spent}))
"""


def rate(source: Path, cores: int, workers: int, folder: Path) -> tuple[float, dict[str, float]]:
    """Pairs a second once warm, and the stages' medians in ms."""
    script = folder / "run.py"  # a file: workers import it
    script.write_text(RUN)
    out = folder / f"{cores}_{workers}.rrd"
    arguments = [sys.executable, str(script), str(source), str(out), str(cores), str(workers)]
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}  # as the command has it
    told = json.loads(subprocess.run(arguments, capture_output=True, text=True, check=True, env=environment).stdout)
    times = told["times"]
    return (len(times) - 1 - WARM) / (times[-1] - times[WARM]), told["stages"]


def plain(source: Path, pairs: int = 2) -> float:
    """Seconds a pair of the plain implementation, images decoded."""
    segment = load_models(Settings())[0].segment
    began = time.perf_counter()
    logged = frames(source, most=pairs + 3)
    decoded = (time.perf_counter() - began) / len(logged)
    rng, spent = np.random.default_rng(0), []
    for first, second in zip(logged, logged[3:], strict=False):
        began = time.perf_counter()
        pair = FramePair(first, second)
        naive.objects(naive.d_m(pair, rng), segment(first))
        spent.append(time.perf_counter() - began)
    return float(np.median(spent)) + decoded


def of_raft(source: Path) -> float | None:
    """What RAFT at full size takes beyond Farneback's flow, both ways on one thread, s; None where it is absent."""
    if not WEIGHTS.is_dir() or find_spec("torchvision") is None:
        return None
    import torch

    from vlmm_log.models.raft import Raft

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    raft = Raft(FlowSettings(estimator="raft", weights=str(WEIGHTS), raft_scale=1.0))
    a, b = frames(source, most=4)[::3]
    began = time.perf_counter()
    raft(a, b)
    middle = time.perf_counter()
    naive.flow(FramePair(a, b))
    torch.set_num_threads(threads)
    return 2 * middle - began - time.perf_counter()


def measured() -> Iterator[Row]:
    """Throughput by cores and workers, and what a first run costs."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        source = SLICE if SLICE.exists() else room(folder, 60)
        seconds = plain(source)
        yield Row("the paper written plainly, Farneback's flow", 1 / seconds, "pairs/s")
        one, stages = rate(source, 1, 1, folder)
        note = f"{one * seconds:.0f} times the plain one, 50 asked; at least 14 asked"
        by_raft = of_raft(source)
        if by_raft is not None:
            literal = seconds + by_raft
            told = f"one core is {one * literal:.0f} times it"
            yield Row("the paper written plainly, RAFT as printed", 1 / literal, "pairs/s", told)
        yield Row("one core", one, "pairs/s", note)
        yield Row("one worker, all cores", rate(source, cores(), 1, folder)[0], "pairs/s")
        for workers in range(2, cores() + 1):
            many, _ = rate(source, workers, workers, folder)
            yield Row(f"{workers} workers on {workers} cores", many, "pairs/s", f"{many / one:.2f} times one core")
        for stage, ms in stages.items():
            yield Row(f"one core, {stage}", ms, "ms", "preempted by decoding and writing")
        again = seconds_of_a_run(source, folder, folder / "kernels")
        first = seconds_of_a_run(source, folder, folder / "other kernels", times=1)
        yield Row(
            "a first run, beyond the next one's time", first - again, "s", "at most 3 asked; compiles the kernels"
        )


def seconds_of_a_run(source: Path, folder: Path, cache: Path, times: int = 2) -> float:
    """The last of some runs over the first pairs, with a cache of kernels of their own."""
    command = [sys.executable, "-c", "from vlmm_log.cli import main; main()", "process", str(source)]
    command += ["--rrd", str(folder / "short.rrd"), "--force", "--stop", "0.3"]
    for _ in range(times):
        began = time.perf_counter()
        subprocess.run(command, check=True, capture_output=True, env=os.environ | {"XDG_CACHE_HOME": str(cache)})
        spent = time.perf_counter() - began
    return spent


if __name__ == "__main__":
    list(shown("pairs a second", measured()))
