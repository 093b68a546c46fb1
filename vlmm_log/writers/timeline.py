"""Everything that is written, as one stream by time: images as stored, and poses in between."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import dataclass

from vlmm_log.readers.stamps import LATEST_NS, limit_ns
from vlmm_log.readers.stored import Shot, StoredLog
from vlmm_log.settings import ReadSettings
from vlmm_log.types import InputError, Skipped
from vlmm_log.writers.chain import Chain, Pose

Event = Shot | Pose | Skipped


@dataclass(frozen=True)
class Window:
    """What of a log is written: all of it, or what the frames of a time span need."""

    start_ns: int  # from the first frame, of depth images
    stop_ns: int
    rgb_ns: int = 0  # so much earlier and later a colour image may lie
    pose_ns: int | None = None  # and so much a pose; None: all poses


def window_of(s: ReadSettings) -> Window:
    """The window of the settings. Without one, images and poses before the first frame are written too."""
    if s.start_s == 0 and s.stop_s == ReadSettings().stop_s:
        return Window(-LATEST_NS, LATEST_NS)
    start_ns = limit_ns(s.start_s) if s.start_s else -LATEST_NS
    return Window(start_ns, limit_ns(s.stop_s), limit_ns(s.association_s), limit_ns(s.pose_gap_s))


def timeline(log: StoredLog, chain: Chain | None, window: Window) -> Iterator[Event]:
    """Images and poses by time; images that the log holds out of order stay so. Raises InputError of no image."""
    rows = iter(()) if chain is None else chain.rows()
    row = next(rows, None)
    first_ns = last_ns = None
    for item in _images(log, window):
        if isinstance(item, Shot):
            if first_ns is None and window.pose_ns is not None:
                while row is not None and row.stamp_ns < item.stamp_ns - window.pose_ns:
                    row = next(rows, None)
            first_ns = item.stamp_ns if first_ns is None else first_ns
            last_ns = item.stamp_ns if last_ns is None else max(last_ns, item.stamp_ns)
            while row is not None and row.stamp_ns <= item.stamp_ns:
                yield row
                row = next(rows, None)
            if item.kind == "depth" and chain is not None and (pose := chain.at_image(item.stamp_ns)) is not None:
                yield pose
        yield item
    if last_ns is None:
        raise InputError(f"{log.name}: no image between read.start_s and read.stop_s; widen them")
    while row is not None and (window.pose_ns is None or row.stamp_ns <= last_ns + window.pose_ns):
        yield row
        row = next(rows, None)


def _images(log: StoredLog, window: Window) -> Iterator[Shot | Skipped]:
    if not window.rgb_ns:
        return log.shots(window.start_ns, window.stop_ns)
    start_ns = max(window.start_ns - window.rgb_ns, -LATEST_NS)
    wide, narrow = log.shots(start_ns, window.stop_ns + window.rgb_ns), log.shots(window.start_ns, window.stop_ns)
    rgb = (x for x in wide if isinstance(x, Shot) and x.kind == "rgb")
    others = (x for x in narrow if isinstance(x, Skipped) or x.kind == "depth")
    return heapq.merge(others, rgb, key=lambda x: x.stamp_ns)
