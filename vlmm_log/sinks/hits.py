"""A query's answer as a small recording: opened together with the run's own, it shows in the same viewer."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path

import cv2
import numpy as np
import rerun as rr

from vlmm_log.elements import Elements
from vlmm_log.entries import Entry, Labels
from vlmm_log.queries import Answer
from vlmm_log.sinks.map_entries import LARGEST_ID, MAP, hit_names, hits, mask_classes, slug
from vlmm_log.sinks.pair_entries import IMAGE
from vlmm_log.sinks.rerun_values import RerunValues
from vlmm_log.sinks.rrd_file import RrdFile
from vlmm_log.types import UInt8, UInt16

ABOUT = "query.json"  # beside the masks: what they are of


def write_hits(
    path: Path, elements: Elements, answer: Answer, recording_id: str, masks: Iterable[tuple[int, int, UInt16]]
) -> None:
    """Ellipsoids and reasons of the answers for all times, and their pixels in every frame that has masks.

    ``recording_id`` is that of the run's recording; masks give frame index, stamp ns and element ids (H, W). Raises
    OSError where the disk refuses.
    """
    rr.set_strict_mode(True)
    rec = rr.RecordingStream("vlmm-log", recording_id=recording_id, send_properties=False)
    values = RerunValues(rec)
    with RrdFile(rec, path) as file:
        entity = f"query/{slug(answer.text)}"
        values.put(Entry(f"{MAP}/{entity}", hits(elements, answer), None, None))
        values.put(Entry(f"{IMAGE}/{entity}", hit_names(answer), None, None))
        wanted = _wanted(answer)
        for index, stamp_ns, labels in masks:
            values.put(Entry(f"{IMAGE}/{entity}", Labels(wanted[labels]), stamp_ns, index))
        file.finish()


def write_masks(
    folder: Path, answer: Answer, masks: Iterable[tuple[int, int, UInt16]], about: Mapping[str, object]
) -> None:
    """A folder with a PNG for each frame, named by its index: 255 where the answers are, else 0; and ``about`` them.

    Raises OSError where the disk refuses.
    """
    wanted = 255 * _wanted(answer)
    folder.mkdir()
    (folder / ABOUT).write_text(json.dumps(about, indent=2) + "\n", "utf-8")
    for index, _, labels in masks:
        _, png = cv2.imencode(".png", wanted[labels])
        (folder / f"{index:06d}.png").write_bytes(png.tobytes())


def holds_masks(folder: Path) -> bool:
    """Whether ``write_masks`` wrote it."""
    return (folder / ABOUT).is_file()


def _wanted(answer: Answer) -> UInt8:
    """Mask class -> 1 for an answer."""
    wanted = np.zeros(LARGEST_ID + 1, np.uint8)
    wanted[mask_classes(answer.ids)] = 1
    return wanted
