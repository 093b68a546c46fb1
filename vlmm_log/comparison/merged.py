"""Two recordings and their difference as one: A, B and delta side by side under one timeline."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import rerun as rr

from vlmm_log.comparison.alignment import Match
from vlmm_log.comparison.merged_blueprint import merged_blueprint
from vlmm_log.comparison.words import readable
from vlmm_log.depth_pixels import metres
from vlmm_log.entries import DepthMap, Entry, LabelNames, Labels, Raster, Scalar, Value
from vlmm_log.recording import Recording
from vlmm_log.sinks.map_entries import CLEAR
from vlmm_log.sinks.pair_entries import IMAGE, Range
from vlmm_log.sinks.redrawn import Redrawn
from vlmm_log.sinks.rerun import UP
from vlmm_log.sinks.rerun_values import RerunValues
from vlmm_log.sinks.rrd_file import RrdFile

SIDES = ("A", "B")
DIFFERS = LabelNames(((0, "same", CLEAR), (1, "differs", (213, 94, 0))))
RANGES: Mapping[str, Range] = {  # of the differences
    f"{IMAGE}/residual/d_m": (0.0, 4.0, "magma"),
    f"{IMAGE}/residual/norm": (0.0, 0.1, "magma"),
    f"{IMAGE}/residual/sigma_z": (0.0, 0.05, "magma"),
    f"{IMAGE}/residual/p_stat": (0.0, 1.0, "magma"),
    f"{IMAGE}/flow/fb_error": (0.0, 2.0, "magma"),
    f"{IMAGE}/flow/tensor": (0.0, 4.0, "magma"),
    f"{IMAGE}/depth": (0.0, 0.1, "magma"),
}
MASKS = (f"{IMAGE}/validity", f"{IMAGE}/instances")


class Merged:
    """Writes matches as they come. ``finish`` makes the file whole."""

    def __init__(self, path: Path, recordings: tuple[Recording, Recording]) -> None:
        rr.set_strict_mode(True)
        ids = "\n".join(f"{r.run.recording_id} {readable(Path(r.path.name))}" for r in recordings)
        self._rec = rr.RecordingStream(
            "vlmm-log-diff",  # another application: viewers remember how each was arranged
            recording_id=f"diff-{hashlib.sha256(ids.encode()).hexdigest()[:12]}",
            send_properties=False,
            batcher_config=rr.ChunkBatcherConfig(flush_tick=1e6, flush_num_bytes=1 << 20),
        )
        self._sides = [RerunValues(self._rec, f"{side}/") for side in SIDES]
        self._delta = RerunValues(self._rec, "delta/", RANGES)
        self._file = RrdFile(self._rec, path, merged_blueprint())
        self._rec.send_recording_name(" | ".join(readable(Path(r.path.name)) for r in recordings))
        for recording, side in zip(recordings, SIDES, strict=True):
            self._rec.log(f"{side}/world", UP[recording.run.world_up], static=True)
        self._drawn = [Redrawn(values) for values in self._sides]
        for entity in MASKS:
            self._delta.put(Entry(entity, DIFFERS, None, None))

    def take(self, match: Match) -> None:
        """Write what both have, and how far it is apart."""
        at = match.at
        for side, value in enumerate((match.a, match.b)):
            if value is not None:
                late_ns = match.late_ns if side and match.a is not None else 0
                stamp_ns = None if at.stamp_ns is None else at.stamp_ns + late_ns
                self._drawn[side].put(Entry(match.entity, value, stamp_ns, at.index))
        if match.a is not None and match.b is not None and at.stamp_ns is not None:
            delta = _delta(match.a, match.b)
            if delta is not None:
                self._delta.put(Entry(match.entity, delta, at.stamp_ns, at.index))

    def finish(self, told: str) -> None:
        """Write what is to read of the difference (Markdown) and the footer. Raises OSError where the disk refused."""
        for values, drawn in zip(self._sides, self._drawn, strict=True):
            drawn.rest()
            values.flush()
        self._delta.flush()
        self._rec.log("diff", rr.TextDocument(told, media_type="text/markdown"), static=True)
        self._file.finish()

    def close(self) -> None:
        """Let go of the file."""
        self._file.close()


def _delta(a: Value, b: Value) -> Value | None:
    """How far two values are apart, as something to look at; None where there is no such thing."""
    match a, b:
        case Raster(x, channels), Raster(y, _) if x.shape == y.shape and (not channels or channels == ("u", "v")):
            apart = np.abs(x.astype(np.float32) - y.astype(np.float32))
            apart = np.hypot(*apart) if channels else apart
            return Raster(np.clip(apart, 0, 65504).astype(np.float16))
        case Labels(x), Labels(y) if x.shape == y.shape:
            return Labels((x != y).astype(np.uint8))
        case DepthMap(), DepthMap():
            try:
                u, v = metres(a), metres(b)
            except ValueError:
                return None
            return Raster(np.abs(u - v).astype(np.float16)) if u.shape == v.shape else None
        case Scalar(x), Scalar(y):
            return Scalar(y - x)
        case _:
            return None
