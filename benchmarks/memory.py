"""Peak memory of `process` against the length of the log: it must not grow with it.

    python -m benchmarks.memory [PAIRS]

One run over the real slice (else the rendered room), again and again, its stamps going on: the peak after 100 pairs
and at the end. A process of its own, a lean recording written.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from benchmarks.data import ROOT, SLICE, room
from benchmarks.rows import Row, shown
from vlmm_log.protocols import Log
from vlmm_log.types import Frame, Skipped

EARLY = 100  # pairs
RUN = """
import json, resource, sys
from pathlib import Path
from benchmarks.memory import Repeated
from vlmm_log import process
from vlmm_log.heap import keep_pages
from vlmm_log.readers import open_log
keep_pages()
peaks = {}
def told(done, expected):
    peaks[done] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
source, out, times = sys.argv[1], sys.argv[2], int(sys.argv[3])
process(Repeated(open_log(source), times), rrd=out, progress=told)
print(json.dumps([peaks[100], max(peaks), peaks[max(peaks)], Path(out).stat().st_size / 1e6]))
"""


@dataclass(frozen=True)
class Repeated:
    """A log over and over, as if its camera went round."""

    log: Log
    times: int

    def __getattr__(self, name: str) -> object:
        return getattr(self.log, name)

    def count(self, start_ns: int, stop_ns: int) -> int:
        """See protocols.Log."""
        return self.times * self.log.count(start_ns, stop_ns)

    def frames(self, start_ns: int, stop_ns: int) -> Iterator[Frame | Skipped]:
        """See protocols.Log."""
        late_ns, later, last = 0, 0, None
        for _ in range(self.times):
            for item in self.log.frames(start_ns, stop_ns):
                if isinstance(item, Frame):
                    last = replace(item, stamp_ns=item.stamp_ns + late_ns, index=item.index + later)
                    yield last
            if last is not None:  # the next round begins a thirtieth of a second later
                first_ns, first = self._first(start_ns, stop_ns)
                late_ns, later = last.stamp_ns + 33_000_000 - first_ns, last.index + 1 - first

    def _first(self, start_ns: int, stop_ns: int) -> tuple[int, int]:
        frame = next(f for f in self.log.frames(start_ns, stop_ns) if isinstance(f, Frame))
        return frame.stamp_ns, frame.index


def measured(short: bool = False, pairs: int = 1000) -> Iterator[Row]:
    """Peak memory of one long run."""
    pairs = 2 * EARLY if short else pairs
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        source = SLICE if SLICE.exists() else room(folder, EARLY)
        arguments = [sys.executable, "-c", RUN, source, folder / "long.rrd", str(-(-pairs // 100))]
        told = subprocess.run(arguments, capture_output=True, text=True, check=True, cwd=ROOT).stdout
        early, count, late, size = json.loads(told)
    yield Row(f"peak after {EARLY} pairs", early, "MiB")
    yield Row(f"peak after {count} pairs", late, "MiB", f"{late / early:.3f} of it, at most 1.05 asked")
    yield Row("recording of them", size / count, "MB", "a pair")


if __name__ == "__main__":
    asked = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    list(shown("memory against length", measured(pairs=asked)))
