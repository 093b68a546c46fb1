"""The folders in which things are kept between runs, of this user."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path


def cache_folder(kind: str) -> Path:
    """The folder for "weights", "features", "kernels": below XDG_CACHE_HOME, LOCALAPPDATA or ~/.cache."""
    base = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA")
    return (Path(base) if base else Path.home() / ".cache") / "vlmm-log" / kind


def kernels_folder(room: Path) -> Path:
    """The folder for a room's kernels: named by a digest of all of it, as they are compiled into one another."""
    digest = hashlib.sha256(b"".join(path.read_bytes() for path in sorted(room.glob("*.py"))))
    return cache_folder("kernels") / digest.hexdigest()[:16]
