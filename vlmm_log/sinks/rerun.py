"""Results as a Rerun recording. The only room that knows Rerun, with blueprint.py."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr

from vlmm_log.elements import Tracked, WorldMap
from vlmm_log.protocols import Moment, Result
from vlmm_log.queries import Answer
from vlmm_log.sinks.blueprint import IMAGE, default_blueprint
from vlmm_log.sinks.footer import finish
from vlmm_log.sinks.rerun_map import MapLog
from vlmm_log.sinks.rerun_pair import log_flow, log_images, log_looks, log_motion
from vlmm_log.sinks.scalars import ScalarColumns
from vlmm_log.sinks.stages import stage_of
from vlmm_log.types import (
    Ego,
    FlowField,
    Frame,
    FramePair,
    InputError,
    Motion,
    Odometry,
    Run,
    RunEnd,
    Segments,
    Skipped,
)

PAIRS_A_FLUSH = 16
UP = {
    "+z": rr.ViewCoordinates.RIGHT_HAND_Z_UP,
    "+y": rr.ViewCoordinates.RIGHT_HAND_Y_UP,
    "-y": rr.ViewCoordinates.RIGHT_HAND_Y_DOWN,
}


class Rerun:
    """Writes one recording beside ``path`` and renames it once it is complete.

    An interrupted run's recording stays as ``path`` + ".partial", readable; one without a pair is removed.
    """

    def __init__(self, path: Path, run: Run, *, recording_id: str, dense: bool) -> None:
        rr.set_strict_mode(True)
        self.path, self.partial = path, path.with_name(path.name + ".partial")
        self.written: Path | None = None  # once closed: where the recording lies, None if it holds no pair
        self._dense = dense
        self._pair: FramePair | None = None
        self._pairs = 0
        self._K: np.ndarray[Any, Any] | None = None
        self._rec = rr.RecordingStream(
            "vlmm-log",
            recording_id=recording_id,
            send_properties=False,  # the time of day it would send makes equal runs differ
            batcher_config=rr.ChunkBatcherConfig(flush_tick=1e6, flush_num_bytes=1 << 20),
        )
        self._stats, self._map = ScalarColumns(self._rec), MapLog(self._rec)
        self._rec.set_log_time_enabled(False)  # nothing but the input decides what is written
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._rec.save(self.partial, default_blueprint=default_blueprint())
        except (OSError, RuntimeError) as e:
            raise InputError(f"{path}: cannot be written: {e}") from e
        self._begin(run)

    def write(self, result: Result, at: Moment) -> None:
        """Log one result at its frame and time. Raises InputError where the disk takes no more."""
        try:
            self._write(result, at)
        except (OSError, RuntimeError) as e:  # Rerun reports a failed write of its own thread as RuntimeError
            raise self._unwritable(e) from e

    def _write(self, result: Result, at: Moment) -> None:
        rec = self._rec
        self._at(at.stamp_ns, at.index)
        stage = stage_of(result)
        if stage is not None:
            self._stat(f"stage_ms/{stage}", at, at.elapsed_ms)
        match result:
            case FramePair():
                self._keep()
                self._pair = result
                self._camera(result.first)
                log_images(rec, result.first)
            case Skipped():
                self._log(f"{result.what}: {result.reason}", "WARN")
            case FlowField():
                log_flow(rec, result, dense=self._dense)
            case Segments():
                for note in result.notes:
                    self._log(note, "WARN")
            case Ego():
                self._ego(result, at)
            case Motion():
                self._motion(result, at)
            case Odometry():
                T = result.T_world_first
                rec.log("world/camera", rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3]))
            case Tracked():
                self._map.tracked(result)
            case WorldMap():
                self._map.world(result, at)
            case Answer():
                self._map.answer(result)
            case _:
                pass

    def close(self, end: RunEnd) -> None:
        """Send what is batched, write the footer, and put the finished recording in its place.

        Raises InputError where it could not be written whole; then nothing is replaced.
        """
        try:
            self._finish(end)
        except (OSError, RuntimeError) as e:
            raise self._unwritable(e) from e
        if not end.pairs:
            self.partial.unlink(missing_ok=True)
        elif end.complete:
            self.partial.replace(self.path)
            self.written = self.path
        else:
            self.written = self.partial

    def _finish(self, end: RunEnd) -> None:
        for told in end.told:
            self._log(told, "INFO")
        self._stats.flush()
        self._map.finish()
        self._rec.flush()  # that it is complete stands behind all that makes it so
        self._rec.send_property(
            "vlmm_end",
            rr.AnyValues(complete=end.complete, input_hash=end.input_hash, frames=end.frames, pairs=end.pairs),
        )
        finish(self._rec, self.partial)

    def _unwritable(self, e: Exception) -> InputError:
        return InputError(f"{self.partial}: cannot be written, is the disk full? ({e})")

    def _begin(self, run: Run) -> None:
        rec = self._rec
        rec.send_recording_name(run.source)
        rec.send_property(
            "vlmm",
            rr.AnyValues(
                source=run.source,
                reader=run.reader,
                settings=run.settings,
                versions=json.dumps(run.versions),
                has_poses=run.has_poses,
                world_up=run.world_up,
                notes=json.dumps(run.notes),
            ),
        )
        versions = ", ".join(f"{name} {version}" for name, version in run.versions.items())
        text = f"# {run.source}\n\n{versions}\n\n" + "".join(f"- {n}\n" for n in run.notes)
        document = rr.TextDocument(f"{text}\n```toml\n{run.settings}```\n", media_type="text/markdown")
        rec.log("run", document, static=True)
        rec.log("world", UP[run.world_up], static=True)
        log_looks(rec)
        rec.flush()  # settings and looks are on disk before the first pair, whatever comes

    def _at(self, stamp_ns: int, index: int | None) -> None:
        if index is None:
            self._rec.disable_timeline("frame")
        else:
            self._rec.set_time("frame", sequence=index)
        self._rec.set_time("time", timestamp=np.datetime64(stamp_ns, "ns"))

    def _log(self, text: str, level: str) -> None:
        self._rec.log("log", rr.TextLog(text, level=level))

    def _keep(self) -> None:
        """Now and then put everything on disk: small entities would wait for a mebibyte, and a kill would take all."""
        self._pairs += 1
        if self._pairs == 2 or self._pairs % PAIRS_A_FLUSH == 0:
            self._stats.flush()
            self._map.flush()
            self._rec.flush()

    def _camera(self, frame: Frame) -> None:
        if self._K is None or not np.array_equal(frame.K, self._K):
            size = [frame.rgb.shape[1], frame.rgb.shape[0]]
            camera = rr.Pinhole(image_from_camera=frame.K, resolution=size, camera_xyz=rr.ViewCoordinates.RDF)
            self._rec.log(IMAGE, camera)
            self._K = frame.K

    def _ego(self, ego: Ego, at: Moment) -> None:
        self._stat("inlier_share", at, ego.inlier_share)
        self._stat("spread", at, ego.spread)
        self._stat("ego_rotation", at, float(np.linalg.norm(ego.correction[:3])))
        self._stat("ego_translation", at, float(np.linalg.norm(ego.correction[3:])))
        self._stat("row_rotation", at, float(np.linalg.norm(ego.row_twist[:3])))
        self._stat("row_translation", at, float(np.linalg.norm(ego.row_twist[3:])))
        if not ego.reliable:
            share = f"{ego.matches} matches, inlier share {ego.inlier_share:.2f}"
            self._log(f"ego_unreliable: {share}; do not trust this pair", "WARN")

    def _motion(self, motion: Motion, at: Moment) -> None:
        self._stat("valid_share", at, motion.valid_share)
        if motion.valid_share:
            self._stat("median_d_m", at, float(np.sqrt(motion.static_d_m2_median)))
            self._stat("flagged_share", at, motion.flagged_share)
            self._stat("median_residual", at, motion.median_norm)
        else:
            self._log("no pixel of this pair could be scored", "WARN")
        assert self._pair is not None, "a pair comes before its motion"
        log_motion(self._rec, self._pair, motion, dense=self._dense)

    def _stat(self, name: str, at: Moment, value: float) -> None:
        self._stats.add(f"stats/{name}", at, value)
