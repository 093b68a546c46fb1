"""What a log holds, told from its index and its first frame."""

from __future__ import annotations

import math
from collections import Counter
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import cast

import numpy as np

from vlmm_log.protocols import Log
from vlmm_log.readers import opened
from vlmm_log.readers.bag.containers import Container, is_container, open_container
from vlmm_log.readers.bag.log import streams_of
from vlmm_log.readers.stamps import LATEST_NS, limit_ns
from vlmm_log.readers.stored import StoredLog, Stream
from vlmm_log.settings import Settings
from vlmm_log.types import Frame, InputError, Skipped

FIRST_S = 1.0  # poses of a bag are read for so long only


@dataclass(frozen=True)
class FirstFrame:
    """The first frame from the chosen start on that could be read."""

    stamp_ns: int
    width: int  # px
    height: int
    depth_seen: float  # share of pixels with depth
    depth_median_m: float  # nan where none is seen


@dataclass(frozen=True)
class Info:
    """What ``info`` tells."""

    source: str
    reader: str
    streams: tuple[Stream, ...]
    frames: int  # colour images with depth; of a bag an estimate
    span_s: float
    first: FirstFrame | None  # None: no frame could be read
    intrinsics: dict[str, object]
    depth_units_per_meter: float
    depth_registered: bool  # False: it will be, from the depth camera's own view
    poses: str  # source and coverage; "" where there are none
    candidates: dict[str, tuple[str, ...]]  # per role, best first
    notes: tuple[str, ...]
    skipped: dict[str, int]  # reason -> how often, up to the first frame: what the index knows
    problem: str = ""  # why a bag gives no frames as it is; then only its topics are known

    def report(self) -> dict[str, object]:
        """As JSON takes it; what is not known is None."""
        report = asdict(self) | {"streams": [asdict(s) | {"rate_hz": s.rate_hz} for s in self.streams]}
        return cast(dict[str, object], _plain(report))


def info(source: str | Path | Log, *, settings: Settings | None = None) -> Info:
    """What a log holds: topics or files, counts, rates, sizes, intrinsics, where poses come from.

    A bag that gives no frames as it is (no images, no camera info) is told by its topics, with the problem.
    Raises InputError where the source cannot be opened.
    """
    s = settings or Settings()
    beginning = replace(s.read, stop_s=min(s.read.stop_s, s.read.start_s + FIRST_S))
    try:
        return _of_log(*opened(source, beginning), limit_ns(s.read.start_s))
    except InputError as e:
        if not isinstance(source, str | Path) or not is_container(Path(source)):
            raise
        return _of_topics(open_container(Path(source)), str(e))


def _of_log(log: Log, reader: str, start_ns: int) -> Info:
    if not hasattr(log, "streams"):
        raise InputError(f"{log.name}: the {reader} reader gives frames only; there is nothing else to tell")
    stored = cast(StoredLog, log)
    skipped: Counter[str] = Counter()
    first = _first(stored, start_ns, skipped)
    images = [x for x in stored.streams if x.role in ("rgb", "depth") and x.first_ns is not None]
    ends = [(x.first_ns or 0, x.last_ns or 0) for x in images]
    span_s = (max(e for _, e in ends) - min(b for b, _ in ends)) / 1e9 if ends else math.nan
    camera = stored.camera
    return Info(
        stored.name,
        reader,
        stored.streams,
        stored.count(0, LATEST_NS),
        span_s,
        first,
        asdict(camera),
        stored.units_per_meter,
        stored.depth_camera is None,
        stored.posed,
        dict(stored.ranked),
        tuple(stored.notes),
        dict(skipped),
    )


def _of_topics(container: Container, problem: str) -> Info:
    streams = streams_of(container, {})
    span_s = (container.stop_ns - container.start_ns) / 1e9
    skipped = dict(Counter(lost.reason for lost in container.losses))
    name = container.path.resolve().name
    return Info(name, "bag", streams, 0, span_s, None, {}, 0.0, True, "", {}, (container.kind,), skipped, problem)


def _first(log: StoredLog, start_ns: int, skipped: Counter[str]) -> FirstFrame | None:
    with closing(log.frames(start_ns, start_ns + limit_ns(FIRST_S))) as frames:  # type: ignore[type-var]
        for item in frames:
            if isinstance(item, Skipped):
                skipped[item.reason] += 1
            elif isinstance(item, Frame):
                seen = item.depth[np.isfinite(item.depth)]
                median = float(np.median(seen)) if seen.size else math.nan
                H, W = item.depth.shape
                return FirstFrame(item.stamp_ns, W, H, seen.size / item.depth.size, median)
    return None


def _plain(value: object) -> object:
    match value:
        case dict():
            return {key: _plain(inner) for key, inner in value.items()}
        case tuple() | list():
            return [_plain(inner) for inner in value]
        case float() if not math.isfinite(value):
            return None
    return value
