"""What `diff` costs on two recordings of about 100 MB, equal and not, as a ratio to plainly decoding both files.

python -m benchmarks.diff
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median

from benchmarks.data import ROOT, SLICE, need

STOP_S = 1.9  # of the slice: 58 pairs, 100 MB
REPEATS = 3
DIFF = """
import sys, time
from benchmarks.peak import peak_mib
began = time.perf_counter()
import vlmm_log
done = vlmm_log.diff(sys.argv[1], sys.argv[2])
print(time.perf_counter() - began, peak_mib(), int(done.same))
"""
DECODE = """
import sys, time
from benchmarks.peak import peak_mib
began = time.perf_counter()
from pathlib import Path
import cv2, numpy as np
from vlmm_log.entries import DepthMap, EncodedImage, Picture
from vlmm_log.recording import open_recording
for path in sys.argv[1:3]:
    recording = open_recording(Path(path))
    for entry in recording.entries(recording.entities):
        match entry.value:
            case Picture(data, _) | DepthMap(EncodedImage(data, _), _):
                cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
print(time.perf_counter() - began, peak_mib(), 1)
"""


def measured(code: str, a: Path, b: Path) -> tuple[float, float, bool]:
    """Median seconds of processes of their own, imports included; the largest memory, MiB; whether all was the same."""
    runs = []
    for _ in range(REPEATS):
        told = subprocess.run(
            [sys.executable, "-c", code, a, b], capture_output=True, text=True, check=True, cwd=ROOT
        ).stdout
        seconds, mib, same = told.split()
        runs.append((float(seconds), float(mib), bool(int(same))))
    return median(r[0] for r in runs), max(r[1] for r in runs), all(r[2] for r in runs)


def record(folder: Path, name: str, *arguments: str) -> Path:
    """A recording of the slice's first seconds."""
    out = folder / name
    kind = "--rrd" if out.suffix == ".rrd" else "--mcap"
    command = [sys.executable, "-c", "from vlmm_log.cli import main; main()", "process", SLICE, kind, out]
    subprocess.run([*command, "--stop", str(STOP_S), *arguments], check=True, capture_output=True, cwd=folder)
    return out


def main() -> None:
    need(SLICE)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        a, again = record(folder, "a.rrd"), record(folder, "again.rrd")
        paper, mcap = record(folder, "paper.rrd", "--profile", "paper"), record(folder, "a.mcap")
        print(", ".join(f"{path.name} {path.stat().st_size / 1e6:.0f} MB" for path in (a, again, paper, mcap)))
        print(f"{'':34} {'s':>6} {'of decoding':>12} {'MiB':>6}")
        for what, b, same in (
            ("equal runs", again, True),
            ("paper against default", paper, False),
            ("rrd, mcap", mcap, True),
        ):
            decoding, _, _ = measured(DECODE, a, b)
            seconds, mib, found = measured(DIFF, a, b)
            assert found == same, f"{what}: same {found}"
            print(f"{what:34} {seconds:6.2f} {seconds / decoding:12.2f} {mib:6.0f}")


if __name__ == "__main__":
    main()
