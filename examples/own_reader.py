"""A reader of one's own: arrays in an .npz become a log, and the log is processed.

    python examples/own_reader.py MY.npz OUT.rrd

MY.npz holds rgb (N, H, W, 3) u8, depth (N, H, W) m, K (3, 3) px, stamps_ns (N,) ascending and poses (N, 4, 4)
camera-to-world. A log is any object with what vlmm_log.protocols.Log lists; nothing is inherited or registered.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from vlmm_log import process
from vlmm_log.types import Frame, Skipped


class Arrays:
    """The log."""

    has_poses = True
    world_up = "+z"  # the axis of the poses' world that points up

    def __init__(self, path: Path) -> None:
        self.name = path.name
        self.arrays = dict(np.load(path))  # whole, in memory: enough for an example
        self.stamps = [int(t) for t in self.arrays["stamps_ns"]]
        self.notes = [f"{len(self.stamps)} frames of {path.name}: depth in metres, poses camera-to-world"]

    def count(self, start_ns: int, stop_ns: int) -> int:
        """How many frames lie in the window."""
        return sum(start_ns <= t - self.stamps[0] < stop_ns for t in self.stamps)

    def frames(self, start_ns: int, stop_ns: int) -> Iterator[Frame | Skipped]:
        """Frames with start_ns <= time since the first one < stop_ns; what is not used is told, with the reason."""
        a = self.arrays
        for k, stamp in enumerate(self.stamps):
            if not start_ns <= stamp - self.stamps[0] < stop_ns:
                continue
            if not np.isfinite(a["poses"][k]).all():
                yield Skipped(stamp, f"frame {k}", "pose is not finite", k)
                continue
            depth = np.where(a["depth"][k] > 0, a["depth"][k], np.nan).astype(np.float32)  # NaN: unseen
            yield Frame(stamp, k, a["rgb"][k].copy(), depth, a["K"].copy(), a["poses"][k].copy())


if __name__ == "__main__":
    source, recording = sys.argv[1:]
    done = process(Arrays(Path(source)), rrd=recording, progress=lambda k, of: print(f"pair {k} of {of}"))
    print(f"{done.end.pairs} pairs, {len(done.map.world.elements)} elements: {done.outputs[0]}")
