"""The real slice and its twins: the same frames from every container, the same d_M, and what reading costs.

python -m benchmarks.twins

Twins are made by `convert`; no bag of somebody else's with colour and depth was at hand. Throughput is that of reading
frames, as a ratio to decoding the same images from memory.
"""

from __future__ import annotations

import hashlib
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.data import SLICE, need
from vlmm_log import Settings, process
from vlmm_log.conversion import convert
from vlmm_log.readers import open_log
from vlmm_log.readers.images import decode_depth, decode_rgb
from vlmm_log.readers.stored import Shot, StoredImage
from vlmm_log.sinks.memory import Memory
from vlmm_log.types import Frame, Motion

EVER = 2**61
TWINS = [  # name, --to, images
    ("log.bag", "bag", "raw"),
    ("log-compressed.bag", "bag", "compressed"),
    ("log_ros2", "ros2", "raw"),
    ("log_ros2_compressed", "ros2", "compressed"),
    ("log_ros2_mcap", "ros2-mcap", "raw"),
    ("log_ros2_mcap_compressed", "ros2-mcap", "compressed"),
    ("log.mcap", "mcap", "raw"),
    ("log-compressed.mcap", "mcap", "compressed"),
    ("tum", "tum", "raw"),
]


def frames(path: Path, intrinsics: str = "") -> Iterator[Frame]:
    """All frames of a log."""
    log = open_log(path, Settings.load(options={"read.intrinsics": intrinsics}).read)
    return (f for f in log.frames(0, EVER) if isinstance(f, Frame))


def hashes(path: Path) -> list[str]:
    """One a frame, over every field but the encoded bytes, which bare pixels have none of."""
    found = []
    for f in frames(path):
        pose = b"none" if f.T_world_cam is None else f.T_world_cam.tobytes()
        head = f"{f.stamp_ns} {f.index} {f.rgb.shape} {f.depth.dtype}".encode()
        digest = hashlib.sha256(head + f.rgb.tobytes() + f.depth.tobytes() + f.K.tobytes() + pose)
        found.append(digest.hexdigest())
    return found


def d_m(path: Path) -> list[np.ndarray]:
    """d_M of every pair."""
    sink = Memory()
    process(path, settings=Settings.load(), sinks=[sink])
    return [x.d_m for _, x in sink.seen if isinstance(x, Motion)]


def seconds_read(path: Path) -> float:
    began = time.perf_counter()
    for _ in frames(path):
        pass
    return time.perf_counter() - began


def seconds_decoded(path: Path) -> float:
    """Of the same images, from memory."""
    log = open_log(path)
    shots = (shot for shot in log.shots(0, EVER) if isinstance(shot, Shot))  # type: ignore[attr-defined]
    stored: list[tuple[str, StoredImage]] = [(shot.kind, shot.load()) for shot in shots]
    units = log.units_per_meter  # type: ignore[attr-defined]
    began = time.perf_counter()
    for kind, image in stored:
        if kind == "rgb":
            decode_rgb(image)
        else:
            decode_depth(image, units, 0.1, 10.0)
    return time.perf_counter() - began


def size_mb(path: Path) -> float:
    files = path.rglob("*") if path.is_dir() else [path]
    return sum(f.stat().st_size for f in files if f.is_file()) / 1e6


def main() -> None:
    need(SLICE)
    wanted, wanted_d_m = hashes(SLICE), d_m(SLICE)
    table = Table(title=f"{len(wanted)} frames, {len(wanted_d_m)} pairs of {SLICE.name}", title_justify="left")
    for name in ("container", "images", "MB", "same frames", "same d_M", "frames/s", "time to plain decoding's"):
        table.add_column(name, justify="left" if name == "container" else "right")
    wrong = 0
    with tempfile.TemporaryDirectory() as folder:
        paths = [("TUM folder", "PNG", SLICE)]
        for name, to, images in TWINS:
            path = Path(folder) / name
            convert(SLICE, path, to=to, images=images)
            paths.append((to, images, path))
            if to == "ros2":
                paths.append(("bare .db3", images, next(path.glob("*.db3"))))
        for name, images, path in paths:
            found, found_d_m = hashes(path), d_m(path)
            same = sum(a == b for a, b in zip(found, wanted, strict=False))
            same_d_m = sum(np.array_equal(a, b, equal_nan=True) for a, b in zip(found_d_m, wanted_d_m, strict=False))
            wrong += (len(found), same, len(found_d_m), same_d_m) != (*[len(wanted)] * 2, *[len(wanted_d_m)] * 2)
            read, decoded = (min(f(path) for _ in range(3)) for f in (seconds_read, seconds_decoded))
            cells = (f"{size_mb(path):.0f}", f"{same}/{len(wanted)}", f"{same_d_m}/{len(wanted_d_m)}")
            table.add_row(name, images, *cells, f"{len(wanted) / read:.0f}", f"{read / decoded:.2f}")
    Console().print(table)
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
