"""Broken files of every format, for as long as one likes: what is refused, read, and what should never happen.

    python -m benchmarks.fuzz [--minutes M] [--seed S] [--only TEXT]

The formats and mutations are those of tests/test_fuzz.py. Each format's inputs are read in a process of its own, with
a limit of memory and one of time for each input; who dies is counted and named by its seed. Exit code 1: something
crashed or hung. Linux only.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.data import ROOT
from vlmm_log.types import InputError

sys.path[:0] = [str(ROOT / "tests")]
from fuzzed import FORMATS, MESSAGES, Format, apply, contents, limited, watched  # noqa: E402

SPARE = 3 << 30  # bytes of addresses that an input may take
CHILD = 400  # inputs that one process reads: Rerun keeps threads of every recording that it wrote
SECONDS = 20  # an input may take
KINDS = ("refused", "losses told", "whole", "crash", "hang")


@dataclass
class Tried:
    """What came of a format's inputs."""

    counts: Counter[str] = field(default_factory=Counter)
    seed: int = 0  # the next one
    most_mib: float = 0.0
    slowest: tuple[float, int] = (0.0, 0)  # s, seed
    crashes: dict[str, int] = field(default_factory=dict)  # what happened -> the first seed

    def take(self, told: str, seed: int, seconds: float, mib: float) -> None:
        """One input."""
        kind, _, more = told.partition(": ")
        self.counts[kind] += 1
        self.seed = seed + 1
        self.most_mib = max(self.most_mib, mib)
        self.slowest = max(self.slowest, (seconds, seed))
        if more:
            self.crashes.setdefault(more, seed)


def outcome(form: Format, whole: dict[str, bytes], folder: Path, seed: int) -> str:
    """What came of one input: one of KINDS, a crash with where."""
    apply(form, whole, folder, np.random.default_rng(seed))
    try:
        with watched(folder), limited(SPARE):
            return "losses told" if form.read(folder) else "whole"
    except InputError as e:
        return "refused" if "\n" not in str(e) else f"crash: several lines: {e!r:.100}"
    except Exception as e:  # noqa: BLE001  this is what is looked for
        at = traceback.extract_tb(e.__traceback__)[-1]
        return f"crash: {type(e).__name__}: {str(e).splitlines()[:1]} at {Path(at.filename).name}:{at.lineno}"


def most_memory() -> float:
    """MiB that this process had at most, as the kernel tells it since it was started."""
    status = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in status if line.startswith("VmHWM")) / 1024


def read_many(name: str, sample: Path, first: int, until: float) -> None:
    """The child: inputs from a seed on, a line before and after each."""
    form = next(f for f in (*FORMATS, MESSAGES) if f.name == name)
    whole = contents(sample)
    channel = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what a library prints is no outcome
    with tempfile.TemporaryDirectory(prefix="vlmm-log-") as room:
        form.read(Path(shutil.copytree(sample, Path(room) / "whole")))
        for seed in range(first, first + CHILD):
            if time.time() > until:
                break
            print(json.dumps(seed), file=channel, flush=True)
            folder = Path(room) / "input"
            signal.alarm(SECONDS)
            began = time.perf_counter()
            told = outcome(form, whole, folder, seed)
            seconds = time.perf_counter() - began
            signal.alarm(0)
            shutil.rmtree(folder)
            mib = most_memory()
            print(json.dumps([told, seed, seconds, mib]), file=channel, flush=True)


def turn(form: Format, sample: Path, tried: Tried, until: float) -> None:
    """Children, one after another as they die, until a time."""
    while time.time() < until:
        command = [sys.executable, "-m", "benchmarks.fuzz", "--child", form.name, str(sample)]
        command += ["--seed", str(tried.seed), "--until", str(until)]
        environment = os.environ | {"OPENCV_LOG_LEVEL": "OFF", "RUST_BACKTRACE": "0"}
        done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
        begun = None
        for line in map(json.loads, done.stdout.splitlines()):
            if isinstance(line, list):
                tried.take(*line)
            begun = line if isinstance(line, int) else None
        if done.returncode and begun is None:
            sys.exit(f"{form.name}: its child ended: {done.stderr[-2000:]}")
        if begun is not None:
            hung = done.returncode == -signal.SIGALRM
            last = (done.stderr.strip().splitlines() or ["no word"])[-1][:100]
            tried.take(f"hang: {SECONDS} s" if hung else f"crash: ended by {-done.returncode}: {last}", begun, 0.0, 0.0)


def shown(results: dict[str, Tried]) -> Table:
    """The table."""
    table = Table(title=f"{sum(t.counts.total() for t in results.values())} broken inputs")
    for title in ("format", "tried", *KINDS, "most MiB", "slowest s", "its seed"):
        table.add_column(title, justify="left" if title == "format" else "right")
    for name, t in results.items():
        counts = [str(t.counts[kind]) for kind in KINDS]
        slowest = (f"{t.slowest[0]:.2f}", str(t.slowest[1]))
        table.add_row(name, str(t.counts.total()), *counts, f"{t.most_mib:.0f}", *slowest)
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=8.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="formats whose names hold this text")
    parser.add_argument("--child", nargs=2, metavar=("FORMAT", "SAMPLE"), help=argparse.SUPPRESS)
    parser.add_argument("--until", type=float, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.child:
        read_many(asked.child[0], Path(asked.child[1]), asked.seed, asked.until)
        return
    forms = [form for form in (*FORMATS, MESSAGES) if asked.only in form.name]
    results = {form.name: Tried(seed=asked.seed) for form in forms}
    with tempfile.TemporaryDirectory(prefix="vlmm-log-") as room:
        samples = {form.name: Path(room) / str(k) for k, form in enumerate(forms)}
        for form in forms:
            samples[form.name].mkdir()
            form.files(samples[form.name])
        for form in forms:
            turn(form, samples[form.name], results[form.name], time.time() + 60 * asked.minutes / len(forms))
    Console(width=140).print(shown(results))
    for name, tried in results.items():
        for what, seed in tried.crashes.items():
            print(f"{name}, seed {seed}: {what}")
    sys.exit(any(tried.crashes for tried in results.values()))


if __name__ == "__main__":
    main()
