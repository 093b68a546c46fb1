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
from pathlib import Path

import numpy as np

from benchmarks import naive
from benchmarks.data import SLICE, frames, room
from vlmm_log.models.load import load_models
from vlmm_log.settings import Settings
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
    done = process(source, rrd=out, workers=workers, progress=lambda done, expected: times.append(time.perf_counter()))
    spent = {name[:-3]: value for name, value in done.summary.figures().items() if name.endswith("_ms")}
    print(json.dumps({"times": times, "began": began, "stages": spent}))
"""


def rate(source: Path, cores: int, workers: int, folder: Path) -> tuple[float, dict[str, float]]:
    """Pairs a second once warm, and the stages' medians in ms."""
    script = folder / "run.py"  # a file: workers import it
    script.write_text(RUN)
    out = folder / f"{cores}_{workers}.rrd"
    arguments = [sys.executable, str(script), str(source), str(out), str(cores), str(workers)]
    told = json.loads(subprocess.run(arguments, capture_output=True, text=True, check=True).stdout)
    times = told["times"]
    return (len(times) - 1 - WARM) / (times[-1] - times[WARM]), told["stages"]


def plain(source: Path, pairs: int = 2) -> float:
    """Seconds a pair of the plain implementation, images decoded."""
    segment = load_models(Settings())[0].segment
    began = time.perf_counter()
    logged = frames(source, pairs + 3)
    decoded = (time.perf_counter() - began) / len(logged)
    rng, spent = np.random.default_rng(0), []
    for first, second in zip(logged, logged[3:], strict=False):
        began = time.perf_counter()
        pair = FramePair(first, second)
        naive.objects(naive.d_m(pair, rng), segment(first))
        spent.append(time.perf_counter() - began)
    return float(np.median(spent)) + decoded


def main() -> None:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        source = SLICE if SLICE.exists() else room(folder, 80)
        seconds = plain(source)
        print(f"{source.name}, {cores} cores")
        print(f"  the paper written plainly     {1 / seconds:7.2f} pairs/s")
        one, stages = rate(source, 1, 1, folder)
        print(
            f"  one core                      {one:7.2f} pairs/s   {one * seconds:.0f} times the plain one (50 asked)"
        )
        free, _ = rate(source, cores, 1, folder)
        print(f"  one worker, all cores         {free:7.2f} pairs/s   {free / one:.2f} times one core")
        for workers in range(2, cores + 1):
            many, _ = rate(source, workers, workers, folder)
            print(
                f"  {workers} workers on {workers} cores         {many:7.2f} pairs/s   {many / one:.2f} times one core"
            )
        print("  stages on one core, ms: " + ", ".join(f"{name} {ms:.1f}" for name, ms in stages.items()))


if __name__ == "__main__":
    main()
