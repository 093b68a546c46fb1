"""Truth of a fixed camera, from depth alone: no flow, nothing of the method.

    python -m benchmarks.difference_truth LOG OUT [--gap 3] [--intrinsics ...]

Writes OUT/000012.png for each frame that has a partner ``gap`` frames later. The background is the median depth of all
frames. 255 where something before it is gone (depth grew by more than four standard deviations and 3 cm), 0 where depth
and grey level stayed, or where something came before the background, 128 where neither is sure: depth edges, what has
no depth, things before the background whose border moved: their inside may look the same and have moved along.
``vlmm-log eval LOG --truth OUT`` takes it.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.data import frames
from vlmm_log.types import Float32, Frame, UInt8

STATIC, IGNORE, MOVING = 0, 128, 255
SIGMAS, LEAST_M = 4.0, 0.03
GREY = 12.0  # levels of a 5x5 mean: a surface whose colour stayed
LEAST_PX = 60  # of a moving region
LEAST_FRAMES = 10  # that make a background
RIM = 0.03  # of a surface's pixels


def sigma_z(z: Float32) -> Float32:
    """Nguyen, Izadi, Lovell 2012, m."""
    return np.asarray(0.0012 + 0.0019 * (z - 0.4) ** 2, np.float32)


def background(log: list[Frame]) -> Float32:
    """Median depth (H, W) m; infinite where no frame saw any: nothing is known to be behind what comes there."""
    stack = np.stack([f.depth for f in log])
    stack[:, np.isnan(stack).all(axis=0)] = np.inf
    return np.asarray(np.nanmedian(stack, axis=0), np.float32)


def truth(a: Frame, b: Frame, behind: Float32) -> UInt8:
    """(H, W) of the first frame."""
    limit = np.maximum(LEAST_M, SIGMAS * np.sqrt(2.0) * sigma_z(np.fmax(a.depth, b.depth)))
    with np.errstate(invalid="ignore"):
        left = b.depth - a.depth > limit
        came = a.depth - b.depth > limit
        same = np.abs(b.depth - a.depth) <= limit / 2
        before = behind - a.depth > limit / 2
    grey = [cv2.blur(cv2.cvtColor(f.rgb, cv2.COLOR_RGB2GRAY).astype(np.float32), (5, 5)) for f in (a, b)]
    out = np.full(a.depth.shape, IGNORE, np.uint8)
    out[(same & (np.abs(grey[0] - grey[1]) < GREY)) | came] = STATIC
    edge = edges(a.depth, limit)
    moving = large(cv2.morphologyEx((left & before).astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)))
    out[edge | inside(moving, before)] = IGNORE
    out[moving] = MOVING
    return out


def inside(moving: NDArray[np.bool_], before: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Things before the background whose border moved."""
    _, labels = cv2.connectedComponents(before.astype(np.uint8), connectivity=4)
    reach = cv2.dilate(labels.astype(np.uint16), np.ones((9, 9), np.uint8))  # rims lie in the edges' bands
    touched = np.bincount(reach[moving], minlength=labels.max() + 1)
    share = touched / np.maximum(np.bincount(labels.ravel(), minlength=labels.max() + 1), 1)
    share[0] = 0.0
    return np.asarray((share > RIM)[labels])


def edges(depth: Float32, limit: Float32) -> NDArray[np.bool_]:
    """Within three pixels of a depth edge, or of what has no depth."""
    kernel = np.ones((7, 7), np.uint8)
    filled = np.nan_to_num(depth, nan=0.0)
    return np.asarray(cv2.dilate(filled, kernel) - cv2.erode(filled, kernel) > 2 * np.nan_to_num(limit, nan=LEAST_M))


def large(mask: UInt8) -> NDArray[np.bool_]:
    """Connected regions that are no specks."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    kept = stats[:, cv2.CC_STAT_AREA] >= LEAST_PX
    kept[0] = False
    return np.asarray(kept[labels])


def write(log: list[Frame], out: Path, gap: int) -> int:
    """Masks of all frames that have a partner; how many."""
    if len(log) < LEAST_FRAMES:
        sys.exit(f"{len(log)} frames make no background; it takes {LEAST_FRAMES}")
    out.mkdir(parents=True, exist_ok=True)
    behind = background(log)
    for a, b in zip(log, log[gap:], strict=False):
        cv2.imwrite(str(out / f"{a.index:06d}.png"), truth(a, b, behind))
    return max(len(log) - gap, 0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("log", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--gap", type=int, default=3)
    parser.add_argument("--intrinsics", default="")
    arguments = parser.parse_args()
    count = write(frames(arguments.log, arguments.intrinsics), arguments.out, arguments.gap)
    print(f"wrote {count} masks to {arguments.out}")


if __name__ == "__main__":
    main()
