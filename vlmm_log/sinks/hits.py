"""A query's answer as a small recording: opened together with the run's own, it shows in the same viewer."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import rerun as rr

from vlmm_log.elements import Elements
from vlmm_log.queries import Answer
from vlmm_log.sinks.blueprint import IMAGE
from vlmm_log.sinks.rerun_map import CLEAR, HIT_COLOR, LARGEST_ID, answer_columns, hits, slug
from vlmm_log.types import UInt16


def write_hits(
    path: Path, elements: Elements, answer: Answer, recording_id: str, masks: Iterable[tuple[int, int, UInt16]]
) -> None:
    """Ellipsoids and reasons of the answers for all times, and their pixels in every frame that has masks.

    ``recording_id`` is that of the run's recording; masks give frame index, stamp ns and element ids (H, W).
    """
    rr.set_strict_mode(True)
    rec = rr.RecordingStream("vlmm-log", recording_id=recording_id, send_properties=False)
    rec.set_log_time_enabled(False)
    rec.save(path)
    rows = np.searchsorted(elements.ids, answer.ids)
    entity = f"query/{slug(answer.text)}"
    rec.log(f"world/map/{entity}", hits(elements, rows, answer), answer_columns(answer), static=True)
    rec.log(f"{IMAGE}/{entity}", rr.AnnotationContext([(0, "", CLEAR), (1, answer.text, HIT_COLOR)]), static=True)
    wanted = np.zeros(LARGEST_ID + 1, np.uint8)
    wanted[(answer.ids - 1) % LARGEST_ID + 1] = 1
    for index, stamp_ns, labels in masks:
        rec.set_time("frame", sequence=index)
        rec.set_time("time", timestamp=np.datetime64(stamp_ns, "ns"))
        rec.log(f"{IMAGE}/{entity}", rr.SegmentationImage(wanted[labels]))
    rec.flush()
    rec.disconnect()
