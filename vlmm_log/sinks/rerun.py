"""Results as a Rerun recording. The only room that knows Rerun, with blueprint.py."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from vlmm_log.protocols import Moment
from vlmm_log.sinks import views
from vlmm_log.sinks.blueprint import IMAGE, default_blueprint
from vlmm_log.types import Ego, FlowField, Frame, FramePair, InputError, Motion, Result, Run, RunEnd, Skipped

FOOTER = b"RRF2FOOT"  # starts the last twelve bytes of a whole recording
ROWS_A_BATCH = 32  # scalars are sent in columns: 100 times cheaper than one by one
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
        self._dense, self._has_poses = dense, run.has_poses
        self._pair: FramePair | None = None
        self._K: np.ndarray[Any, Any] | None = None
        self._rows: dict[str, list[tuple[int, int, float]]] = {}
        self._rec = rr.RecordingStream(
            "vlmm-log",
            recording_id=recording_id,
            send_properties=False,  # the time of day it would send makes equal runs differ
            batcher_config=rr.ChunkBatcherConfig(flush_tick=1e6, flush_num_bytes=1 << 20),
        )
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
        self._at(at.stamp_ns, at.index)
        match result:
            case FramePair():
                self._pair = result
                self._frame(result.first)
            case Skipped():
                self._log(f"{result.what}: {result.reason}", "WARN")
            case FlowField():
                self._stat("stage_ms/flow", at, at.elapsed_ms)
                self._flow(result)
            case Ego():
                self._ego(result, at)
            case Motion():
                self._motion(result, at)
            case _:
                self._stat("stage_ms/matches", at, at.elapsed_ms)

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
        self._send_rows()
        self._rec.send_property(
            "vlmm_end",
            rr.AnyValues(complete=end.complete, input_hash=end.input_hash, frames=end.frames, pairs=end.pairs),
        )
        self._rec.flush()
        self._rec.disconnect()  # writes the footer, and only prints if it cannot
        with self.partial.open("rb") as f:
            f.seek(-len(FOOTER) - 4, os.SEEK_END)
            if not f.read().startswith(FOOTER):
                raise OSError("its footer is missing")
            os.fsync(f.fileno())

    def _unwritable(self, e: Exception) -> InputError:
        return InputError(f"{self.partial}: cannot be written, is the disk full? ({e})")

    def _begin(self, run: Run) -> None:
        rec = self._rec
        rec.send_recording_name(run.source)
        versions = ", ".join(f"{name} {version}" for name, version in run.versions.items())
        rec.send_property(
            "vlmm", rr.AnyValues(source=run.source, reader=run.reader, settings=run.settings, versions=versions)
        )
        text = f"# {run.source}\n\n{versions}\n\n" + "".join(f"- {n}\n" for n in run.notes)
        document = rr.TextDocument(f"{text}\n```toml\n{run.settings}```\n", media_type="text/markdown")
        rec.log("run", document, static=True)
        rec.log("world", UP[run.world_up], static=True)
        if not run.has_poses:
            rec.log("world/camera", rr.Transform3D(translation=[0, 0, 0]), static=True)
        ranges: dict[str, tuple[float, float, Literal["turbo", "viridis", "magma"]]] = {
            "residual/d_m": (0.0, 8.0, "turbo"),
            "residual/norm": (0.0, 0.3, "turbo"),
            "residual/sigma_z": (0.0, 0.1, "viridis"),
            "residual/p_stat": (0.0, 1.0, "viridis"),
            "flow/fb_error": (0.0, 2.0, "magma"),
        }
        for path, (low, high, colors) in ranges.items():
            look = rr.DepthImage.from_fields(meter=1.0, colormap=colors, depth_range=[low, high])
            rec.log(f"{IMAGE}/{path}", look, static=True)
        classes = [(int(v), v.name.lower(), color) for v, color in views.VALIDITY_COLORS.items()]
        rec.log(f"{IMAGE}/validity", rr.AnnotationContext(classes), static=True)

    def _at(self, stamp_ns: int, index: int | None) -> None:
        if index is None:
            self._rec.disable_timeline("frame")
        else:
            self._rec.set_time("frame", sequence=index)
        self._rec.set_time("time", timestamp=np.datetime64(stamp_ns, "ns"))

    def _log(self, text: str, level: str) -> None:
        self._rec.log("log", rr.TextLog(text, level=level))

    def _frame(self, frame: Frame) -> None:
        rec = self._rec
        if self._K is None or not np.array_equal(frame.K, self._K):
            size = [frame.rgb.shape[1], frame.rgb.shape[0]]
            camera = rr.Pinhole(image_from_camera=frame.K, resolution=size, camera_xyz=rr.ViewCoordinates.RDF)
            rec.log(IMAGE, camera)
            self._K = frame.K
        if frame.T_world_cam is not None:
            T = frame.T_world_cam
            rec.log("world/camera", rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3]))
        elif self._has_poses:  # nowhere, rather than where it was last
            rec.log("world/camera", rr.Clear(recursive=False))
        rgb, depth = frame.encoded_rgb, frame.encoded_depth
        if rgb is None:
            rec.log(f"{IMAGE}/rgb", rr.Image(frame.rgb).compress(jpeg_quality=90))
        else:
            rec.log(f"{IMAGE}/rgb", rr.EncodedImage(contents=rgb.data, media_type=rgb.media_type))
        if depth is None:
            millimetres = np.nan_to_num(frame.depth * np.float32(1e3)).astype(np.uint16)
            rec.log(f"{IMAGE}/depth", rr.DepthImage(millimetres, meter=1e3))
        else:
            encoded = rr.EncodedDepthImage(blob=depth.data, media_type=depth.media_type, meter=depth.units_per_meter)
            rec.log(f"{IMAGE}/depth", encoded)

    def _flow(self, flow: FlowField) -> None:
        rec = self._rec
        _, jpeg = cv2.imencode(".jpg", views.flow_color(flow.forward)[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 85])
        rec.log(f"{IMAGE}/flow/color", rr.EncodedImage(contents=jpeg.tobytes(), media_type="image/jpeg"))
        origins, vectors = views.arrows(flow.forward)
        rec.log(f"{IMAGE}/flow/arrows", rr.Arrows2D(origins=origins, vectors=vectors))
        names = ["height", "width", "uv"]
        if self._dense:
            rec.log(f"{IMAGE}/flow/tensor", rr.Tensor(flow.forward, dim_names=names))
            rec.log(f"{IMAGE}/flow/fb_error", rr.DepthImage(flow.fb_error))
        else:
            rec.log(f"{IMAGE}/flow/tensor", rr.Tensor(views.half(flow.forward[::2, ::2]), dim_names=names))
            rec.log(f"{IMAGE}/flow/fb_error", rr.DepthImage(views.half(flow.fb_error[::2, ::2])))

    def _ego(self, ego: Ego, at: Moment) -> None:
        self._stat("stage_ms/ego", at, at.elapsed_ms)
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
        rec, path = self._rec, f"{IMAGE}/residual"
        self._stat("stage_ms/motion", at, at.elapsed_ms)
        self._stat("valid_share", at, motion.valid_share)
        if motion.valid_share:
            self._stat("median_d_m", at, float(np.sqrt(motion.static_d_m2_median)))
            self._stat("flagged_share", at, motion.flagged_share)
            self._stat("median_residual", at, motion.median_norm)
        else:
            self._log("no pixel of this pair could be scored", "WARN")
        validity = rr.SegmentationImage(motion.validity)
        rec.log(f"{IMAGE}/validity", validity)
        thin = motion.covariances(1 if self._dense else 4)
        if self._dense:
            rec.log(f"{path}/d_m", rr.DepthImage(motion.d_m))
            rec.log(f"{path}/p_stat", rr.DepthImage(motion.p_stat))
            rec.log(f"{path}/norm", rr.DepthImage(motion.norm))
            rec.log(f"{path}/sigma_z", rr.DepthImage(thin.sigma_z))
            rec.log(f"{path}/tensor", rr.Tensor(motion.residual, dim_names=["xyz", "height", "width"]))
            covariance: NDArray[np.floating] = thin.upper
        else:
            rec.log(f"{path}/d_m", rr.DepthImage(views.half(motion.d_m)))
            rec.log(f"{path}/p_stat", rr.DepthImage(views.half(motion.p_stat[::2, ::2])))
            rec.log(f"{path}/norm", rr.DepthImage(views.half(motion.norm[::2, ::2])))
            rec.log(f"{path}/sigma_z", rr.DepthImage(views.half(thin.sigma_z)))
            covariance = views.half(thin.upper * 1e4)  # cm^2: metres squared underflow half precision
        rec.log(f"{path}/covariance", rr.Tensor(covariance, dim_names=["xx_xy_xz_yy_yz_zz", "height", "width"]))
        if self._pair is not None:
            origins, vectors = views.moved_arrows(motion, self._pair.first, self._pair.second)
            rec.log(f"{path}/vectors", rr.Arrows2D(origins=origins, vectors=vectors, colors=[230, 159, 0]))

    def _stat(self, name: str, at: Moment, value: float) -> None:
        rows = self._rows.setdefault(name, [])
        rows.append((at.index or 0, at.stamp_ns, value))
        if len(rows) >= ROWS_A_BATCH:
            self._send(name, rows)
            rows.clear()

    def _send_rows(self) -> None:
        for name, rows in self._rows.items():
            if rows:
                self._send(name, rows)

    def _send(self, name: str, rows: list[tuple[int, int, float]]) -> None:
        index, stamps, values = zip(*rows, strict=True)
        self._rec.send_columns(
            f"stats/{name}",
            [
                rr.TimeColumn("frame", sequence=index),
                rr.TimeColumn("time", timestamp=np.array(stamps, "datetime64[ns]")),
            ],
            rr.Scalars.columns(scalars=values),
        )
