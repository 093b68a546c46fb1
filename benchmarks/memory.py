"""Peak memory of `process` against the length of the log: it must not grow with it.

    python -m benchmarks.memory [PAIRS]

One run over the real slice (else the rendered room), forth and back again and again: the peak after 100 pairs and at
the end. A process of its own, a lean recording written.
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
import json, sys
from pathlib import Path
from benchmarks.memory import Repeated
from benchmarks.peak import peak_mib
from vlmm_log import process
from vlmm_log.heap import keep_pages
from vlmm_log.readers import open_log
keep_pages()
peaks = {}
def told(done, expected):
    peaks[done] = peak_mib()
source, times, out = sys.argv[1], int(sys.argv[2]), (sys.argv[3:] or [None])[0]
process(Repeated(open_log(source), times), rrd=out, progress=told)
size = Path(out).stat().st_size / 1e6 if out else 0.0
print(json.dumps([peaks[100], max(peaks), peaks[max(peaks)], size]))
"""


@dataclass(frozen=True)
class Repeated:
    """A log forth and back, so many times, as if its camera swung."""

    log: Log
    times: int

    def __getattr__(self, name: str) -> object:
        return getattr(self.log, name)

    def count(self, start_ns: int, stop_ns: int) -> int:
        """See protocols.Log."""
        return self.times * self.log.count(start_ns, stop_ns)

    def frames(self, start_ns: int, stop_ns: int) -> Iterator[Frame | Skipped]:
        """See protocols.Log."""
        stamps: list[int] = []
        for frame in _frames(self.log, start_ns, stop_ns):
            stamps.append(frame.stamp_ns)
            yield frame
        now_ns, index, before_ns = frame.stamp_ns, frame.index, frame.stamp_ns
        for turn in range(1, self.times):
            for stamp_ns in (stamps[::-1] if turn % 2 else stamps)[1:]:
                since = stamp_ns - stamps[0]
                frame = next(_frames(self.log, since, since + 1))
                now_ns, index, before_ns = now_ns + abs(stamp_ns - before_ns), index + 1, stamp_ns
                yield replace(frame, stamp_ns=now_ns, index=index)


def _frames(log: Log, start_ns: int, stop_ns: int) -> Iterator[Frame]:
    return (f for f in log.frames(start_ns, stop_ns) if isinstance(f, Frame))


def measured(pairs: int = 1000) -> Iterator[Row]:
    """Peak memory of long runs, with a recording and without; nothing in a short form."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        source = SLICE if SLICE.exists() else room(folder, EARLY)
        for what, out in (("recorded", [folder / "long.rrd"]), ("unrecorded", [])):
            arguments = [sys.executable, "-c", RUN, source, str(-(-pairs // 100)), *out]
            told = subprocess.run(arguments, capture_output=True, text=True, check=True, cwd=ROOT).stdout
            early, count, late, size = json.loads(told)
            yield Row(f"{what}: peak after {EARLY} pairs", early, "MiB")
            yield Row(f"{what}: peak after {count} pairs", late, "MiB", f"{late / early:.3f} of it, at most 1.05 asked")
            if out:
                yield Row("recording of them", size / count, "MB", "a pair")


if __name__ == "__main__":
    asked = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    list(shown("memory against length", measured(pairs=asked)))
