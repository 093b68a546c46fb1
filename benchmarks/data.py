"""Where real recordings and weights lie: ../shared, or the folders that VLMM_LOG_DATA and VLMM_LOG_WEIGHTS name."""

from __future__ import annotations

import os
import sys
from itertools import islice
from pathlib import Path

from vlmm_log.readers import open_log
from vlmm_log.settings import ReadSettings
from vlmm_log.types import Frame

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "examples")]
import render_room  # noqa: E402
import textbook  # noqa: E402, F401  for benchmarks

SHARED = ROOT.parent / "shared"
DATA = Path(os.environ.get("VLMM_LOG_DATA", SHARED / "data"))
WEIGHTS = Path(os.environ.get("VLMM_LOG_WEIGHTS", SHARED / "weights"))
SLICE = DATA / "rgbd_dataset_freiburg1_rpy_225_345"
MOVING_PAIRS = DATA / "moving_pairs"
NOMINAL = "525,525,319.5,239.5"  # the sensor's nominal intrinsics: moving_pairs come without


def need(path: Path) -> None:
    """End with a reason where a real recording is absent."""
    if not path.exists():
        sys.exit(f"skipped: {path} is not here; VLMM_LOG_DATA can name the folder that holds it")


def frames(path: Path, intrinsics: str = "", most: int | None = None) -> list[Frame]:
    """The first frames of a log; all, unless told how many."""
    log = open_log(path, ReadSettings(intrinsics=intrinsics))
    return list(islice((f for f in log.frames(0, 10**18) if isinstance(f, Frame)), most))


def room(folder: Path, count: int) -> Path:
    """A rendered sequence of so many frames, where no real one is at hand."""
    render_room.write_tum(folder / "room", count)
    return folder / "room"
