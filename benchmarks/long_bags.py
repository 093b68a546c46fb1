"""Reading long bags: peak memory and time of `info`, of a late window and of all frames, on 1 GB and more a container.

python -m benchmarks.long_bags [GB]

The bags hold the frames of the real slice (else of the rendered room) over and over, raw, with later stamps.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.data import ROOT, SLICE, need
from vlmm_log.conversion import convert
from vlmm_log.readers import open_log
from vlmm_log.readers.folder import FolderLog
from vlmm_log.readers.poses import Link, Poses, Trajectory
from vlmm_log.readers.stored import Shot
from vlmm_log.types import Skipped

FRAME_MB = 640 * 480 * (3 + 4) / 1e6
RUN = """
import sys, time
from benchmarks.peak import peak_mib
t = time.perf_counter()
from vlmm_log import Settings, open_log
from vlmm_log.survey import info
from vlmm_log.types import Frame
what, path = sys.argv[1:]
imported = time.perf_counter() - t
t = time.perf_counter()
if what == "info":
    n = info(path).frames
else:
    log = open_log(path, Settings.load().read)
    window = (0, 2**61) if what == "all" else (10**9 * 12, 10**9 * 13)
    n = sum(isinstance(f, Frame) for f in log.frames(*window))
print(n, time.perf_counter() - t, peak_mib())
"""


@dataclass
class Repeated:
    """A log again and again, each time later."""

    log: FolderLog
    times: int

    def __getattr__(self, name: str) -> object:
        return getattr(self.log, name)

    @property
    def period_ns(self) -> int:
        """Of one turn."""
        return self.log.rgb[-1].stamp_ns - self.log.rgb[0].stamp_ns + 33_000_000

    @property
    def poses(self) -> Poses | None:
        """The same way again and again."""
        found = self.log.poses
        if found is None:
            return None
        t = found.moving[0]
        inside = (t.stamps_ns >= self.log.origin_ns) & (t.stamps_ns < self.log.origin_ns + self.period_ns)
        stamps = np.concatenate([t.stamps_ns[inside] + k * self.period_ns for k in range(self.times)])
        again = Trajectory(
            stamps, np.tile(t.positions[inside], (self.times, 1)), np.tile(t.quaternions[inside], (self.times, 1))
        )
        return replace(found, links=(Link(again),))

    def shots(self, start_ns: int, stop_ns: int) -> Iterator[Shot | Skipped]:
        """All images of all turns."""
        for k in range(self.times):
            for shot in self.log.shots(start_ns, stop_ns):
                if isinstance(shot, Shot):
                    yield replace(shot, stamp_ns=shot.stamp_ns + k * self.period_ns)


def measured(what: str, path: Path) -> tuple[int, float, float]:
    """Frames, seconds and peak MiB of a process of its own."""
    command = [sys.executable, "-c", RUN, what, str(path)]
    n, seconds, mib = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT).stdout.split()
    return int(n), float(seconds), float(mib)


def main() -> None:
    need(SLICE)
    log = open_log(SLICE)
    assert isinstance(log, FolderLog)
    times = round(float(sys.argv[1] if len(sys.argv) > 1 else 1.1) * 1000 / (FRAME_MB * len(log.rgb)))
    table = Table(title=f"{times} times {SLICE.name}", title_justify="left")
    for name in ("container", "GB", "info s", "MiB", "1 s, 12 s in: frames", "s", "MiB", "all: frames", "s", "MiB"):
        table.add_column(name, justify="right")
    with tempfile.TemporaryDirectory() as folder:
        for name, to in (("long.bag", "bag"), ("long_ros2", "ros2"), ("long.mcap", "mcap")):
            path = Path(folder) / name
            convert(Repeated(log, times), path, to=to)  # type: ignore[arg-type]
            files = path.rglob("*") if path.is_dir() else [path]
            cells = [to, f"{sum(f.stat().st_size for f in files) / 1e9:.2f}"]
            for what in ("info", "window", "all"):
                n, seconds, mib = measured(what, path)
                cells += ([] if what == "info" else [str(n)]) + [f"{seconds:.2f}", f"{mib:.0f}"]
            table.add_row(*cells)
    Console().print(table)


if __name__ == "__main__":
    main()
