"""The end of a Rerun recording: whether it came whole onto the disk."""

from __future__ import annotations

import os
from pathlib import Path

import rerun as rr

PATIENCE_S = 60.0  # Rerun's writer may end on a full disk without a word to who waits for it
FOOTER = b"RRF2FOOT"  # starts the last twelve bytes of a whole recording


def finish(rec: rr.RecordingStream, path: Path) -> None:
    """Write what waits and the footer. Raises OSError or RuntimeError where the disk did not take it."""
    rec.flush(timeout_sec=PATIENCE_S)
    rec.disconnect()  # writes the footer, and only prints if it cannot
    with path.open("rb") as f:
        f.seek(-len(FOOTER) - 4, os.SEEK_END)
        if not f.read().startswith(FOOTER):
            raise OSError("its footer is missing")
        os.fsync(f.fileno())
