"""Pseudo-truth by another flow: RAFT's d_M under the default settings, for logs whose camera moves and that have none.

    python -m benchmarks.raft_truth OUT LOG... [--gap 1] [--intrinsics ...]

Writes OUT/LOG/000012.png: 255 where d_M is above 4, 0 where it is below 2.8, 128 else and where it was not scored. What
is judged by it is how near another flow or noise model comes to RAFT: a direction, not a result. Needs RAFT's weights.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from benchmarks.data import WEIGHTS, frames
from benchmarks.real_check import MOVING, STATIC, measured
from vlmm_log.models.raft import Raft
from vlmm_log.pipeline.flow import estimate_flow
from vlmm_log.settings import FlowSettings, Settings
from vlmm_log.types import Float32, FramePair, UInt8


def masks(d_m: Float32) -> UInt8:
    """(H, W) 0, 128, 255."""
    out = np.full(d_m.shape, 128, np.uint8)
    with np.errstate(invalid="ignore"):
        out[d_m < STATIC] = 0
        out[d_m > MOVING] = 255
    return out


def write(out: Path, logs: Sequence[Path], gap: int, intrinsics: str) -> None:
    """Masks of all pairs of all logs."""
    raft = Raft(FlowSettings(estimator="raft", weights=str(WEIGHTS)))
    for path in logs:
        log = frames(path, intrinsics)
        folder = out / path.name
        folder.mkdir(parents=True, exist_ok=True)
        for a, b in zip(log, log[gap:], strict=False):
            pair = FramePair(a, b)
            _, motion = measured(pair, estimate_flow(pair, raft), Settings())
            cv2.imwrite(str(folder / f"{a.index:06d}.png"), masks(motion.d_m))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("logs", type=Path, nargs="+")
    parser.add_argument("--gap", type=int, default=1)
    parser.add_argument("--intrinsics", default="")
    arguments = parser.parse_args()
    write(arguments.out, arguments.logs, arguments.gap, arguments.intrinsics)
    print(f"wrote {len(arguments.logs)} folders to {arguments.out}")


if __name__ == "__main__":
    main()
