"""Peak memory of `process` on the first 20 and on 120 frames: it must not grow with the log's length.

python -m benchmarks.memory
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.data import SLICE

ROOT = Path(__file__).resolve().parents[1]
RUN = """
import resource, sys, vlmm_log
s = vlmm_log.Settings.load(sets=[f"read.stop_s={sys.argv[3]}"])
done = vlmm_log.process(sys.argv[1], rrd=sys.argv[2], settings=s)
print(done.end.frames, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


def peak(source: Path, stop_s: float, folder: Path) -> tuple[int, float]:
    """Frames read and peak resident memory, MiB, of a process of its own."""
    out = folder / f"{stop_s}.rrd"
    arguments = [sys.executable, "-c", RUN, str(source), str(out), str(stop_s)]
    frames, kib = subprocess.run(arguments, capture_output=True, text=True, check=True, cwd=folder).stdout.split()
    return int(frames), int(kib) / 1024


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        source = SLICE
        if not source.exists():
            source = folder / "room"
            subprocess.run([sys.executable, str(ROOT / "examples/render_room.py"), str(source), "120"], check=True)
        peak(source, 0.3, folder)  # compiles
        few, many = peak(source, 0.69, folder), peak(source, 1e9, folder)
    for frames, mib in (few, many):
        print(f"{frames:4d} frames: peak {mib:.0f} MiB")
    print(f"ratio {many[1] / few[1]:.3f} (at most 1.05)")


if __name__ == "__main__":
    main()
