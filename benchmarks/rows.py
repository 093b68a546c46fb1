"""What a benchmark measured: rows of figures, printed as they come, kept so that a change is seen."""

from __future__ import annotations

import json
import platform
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class Row:
    """One figure."""

    name: str
    value: float
    unit: str
    note: str = ""  # what it is compared with, what was asked


def milliseconds(work: Callable[[], object], repeats: int = 15) -> float:
    """Median time of a call, after one that warms up."""
    work()
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        work()
        times.append(1e3 * (time.perf_counter() - began))
    return float(np.median(times))


def shown(part: str, rows: Iterable[Row], before: dict[str, float] | None = None) -> Iterator[Row]:
    """The rows, each printed when it is there, with its change since an earlier run."""
    print(f"\n{part}")
    for row in rows:
        old = (before or {}).get(f"{part}: {row.name}")
        change = "" if not old else f"{row.value / old - 1:+.0%}"
        print(f"  {row.name:44s} {row.value:10.2f} {row.unit:8s} {change:>6s}  {row.note}".rstrip(), flush=True)
        yield row


def machine() -> str:
    """What the figures are of: the processor and how many cores."""
    name = platform.processor() or platform.machine()
    about = Path("/proc/cpuinfo")
    if about.exists():
        lines = (line.partition(":") for line in about.read_text().splitlines())
        name = next((value.strip() for key, _, value in lines if key.strip() == "model name"), name)
    return f"{name}, {cores()} cores"


def cores() -> int:
    """How many this process may use."""
    import os

    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def last(history: Path, form: str) -> dict[str, float]:
    """The figures of the last run of the same form on a machine like this one; none if there was none."""
    if not history.exists():
        return {}
    runs = [json.loads(line) for line in history.read_text().splitlines()]
    same = [run["figures"] for run in runs if (run["machine"], run["form"]) == (machine(), form)]
    return dict(same[-1]) if same else {}


def remember(history: Path, form: str, figures: dict[str, float], version: str) -> None:
    """Append a run to the history: a line of JSON."""
    when = datetime.now(UTC).isoformat(timespec="seconds")
    run = {"when": when, "version": version, "machine": machine(), "form": form, "figures": figures}
    with history.open("a") as file:
        file.write(json.dumps(run) + "\n")
