"""What reading frames costs from each container, and what a command costs before it does anything.

    python -m benchmarks.containers

Reading as a ratio to the library's own decoding of the same images, from memory. Containers are written by `convert`.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from benchmarks.data import SLICE, room
from benchmarks.rows import Row, shown
from benchmarks.twins import seconds_decoded, seconds_read
from vlmm_log.conversion import convert

KINDS = (("log.bag", "bag"), ("log_ros2", "ros2"), ("log.mcap", "mcap"))
REPEATS = 3


def seconds(*arguments: str) -> float:
    """The fastest of some calls of the command."""
    command = [sys.executable, "-c", "from vlmm_log.cli import main; main()", *arguments]
    times = []
    for _ in range(REPEATS):
        began = time.perf_counter()
        subprocess.run(command, check=True, capture_output=True)
        times.append(time.perf_counter() - began)
    return min(times)


def measured() -> Iterator[Row]:
    """Reading, `--help`, `info`."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        source = SLICE if SLICE.exists() else room(folder, 20)
        paths = [("TUM folder", source)]
        for file, kind in KINDS:
            convert(source, folder / file, to=kind, images="compressed")
            paths.append((kind, folder / file))
        for kind, path in paths:
            read, decoded = (min(f(path) for _ in range(REPEATS)) for f in (seconds_read, seconds_decoded))
            yield Row(f"frames read from {kind}", read / decoded, "times", "plain decoding of the images")
        yield Row("vlmm-log --help", seconds("--help"), "s", "at most .5 asked")
        for kind, path in paths:
            yield Row(f"vlmm-log info, {kind}", seconds("info", str(path)), "s")


if __name__ == "__main__":
    list(shown("containers", measured()))
