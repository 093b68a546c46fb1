"""A Rerun recording as a container of entries."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import rerun as rr

from vlmm_log.entries import Entry
from vlmm_log.sinks.blueprint import CALIBRATED, default_blueprint
from vlmm_log.sinks.legend import LEGEND, viewer_legend
from vlmm_log.sinks.markdown import plain
from vlmm_log.sinks.rerun_values import RerunValues
from vlmm_log.sinks.rrd_file import RrdFile
from vlmm_log.types import Run, RunEnd

FLUSHED = 64  # pairs, or a PARTth of the run: what a kill may cost. A flush makes chunks, of which Rerun keeps notes
PART = 32
FEW = 32  # rows of an element's history that wait for more
UP = {
    "+z": rr.ViewCoordinates.RIGHT_HAND_Z_UP,
    "+y": rr.ViewCoordinates.RIGHT_HAND_Y_UP,
    "-y": rr.ViewCoordinates.RIGHT_HAND_Y_DOWN,
    "-z": rr.ViewCoordinates.RIGHT_HAND_Z_DOWN,
    "+x": rr.ViewCoordinates.RIGHT_HAND_X_UP,
    "-x": rr.ViewCoordinates.RIGHT_HAND_X_DOWN,
}


class RerunFile:
    """See recorder.Container. ``images`` are shown beside those that every recording holds."""

    def __init__(self, path: Path, run: Run, images: Sequence[str] = ()) -> None:
        rr.set_strict_mode(True)
        self._rec = rr.RecordingStream(
            "vlmm-log",
            recording_id=run.recording_id,
            send_properties=False,  # the time of day it would send makes equal runs differ
            batcher_config=rr.ChunkBatcherConfig(flush_tick=1e6, flush_num_bytes=1 << 22),
        )
        self._values = RerunValues(self._rec)
        self._pairs, self._due = 0, 2
        calibrated = CALIBRATED if "calibration" in run.versions else ()
        self._file = RrdFile(self._rec, path, default_blueprint((*calibrated, *images)))
        try:
            self._begin(run)
        except BaseException:
            self._file.close()
            raise

    def put(self, entry: Entry) -> None:
        """See recorder.Container."""
        self._values.put(entry)

    def pair_begins(self) -> None:
        """Now and then put everything on disk: else small entities would wait, and a kill would take all."""
        self._pairs += 1
        if self._pairs >= self._due:
            self._due = min(8 * self._pairs, self._pairs + max(FLUSHED, self._pairs // PART))
            self._values.flush(FEW if self._pairs > FLUSHED else 1)
            self._file.flush()

    def finish(self, end: RunEnd) -> None:
        """See recorder.Container."""
        with self._file as file:  # let go of, come what may
            self._values.flush()
            file.flush()  # that it is complete stands behind all that makes it so
            self._rec.send_property(
                "vlmm_end",
                rr.AnyValues(complete=end.complete, input_hash=end.input_hash, frames=end.frames, pairs=end.pairs),
            )
            file.finish()

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
        rec.log("run", document(run), static=True)
        rec.log(LEGEND, rr.Image(viewer_legend()), static=True)  # not encoded: no picture of the log's, a look
        rec.log("world", UP[run.world_up], static=True)
        self._file.flush()  # settings are on disk before the first pair, whatever comes


def document(run: Run) -> rr.TextDocument:
    """Versions, notes and settings, to read in the viewer."""
    versions = plain(", ".join(f"{name} {version}" for name, version in run.versions.items()))
    text = f"# {plain(run.source)}\n\n{versions}\n\n" + "".join(f"- {plain(n)}\n" for n in run.notes)
    return rr.TextDocument(f"{text}\n```toml\n{run.settings}```\n", media_type="text/markdown")
