"""Which frames are compared, and a stream that is read ahead."""

from __future__ import annotations

import queue
import threading
from collections import deque
from collections.abc import Generator, Iterable, Iterator
from dataclasses import dataclass
from typing import TypeVar

from vlmm_log.settings import KeyframeSettings
from vlmm_log.types import Frame, FramePair, InputError, Skipped

T = TypeVar("T")
SET_BACK_NS = 1_000_000_000  # a stamp that lies farther back is of a clock that was set
LONGEST_GAP = 300  # frames held back at most, so that memory stays bounded


@dataclass(frozen=True)
class Gap:
    """Distance of a pair: in frames, or in nanoseconds if frames is 0."""

    frames: int
    ns: int = 0

    @staticmethod
    def parse(gap: int | str) -> Gap:
        """Of 3, "3" (frames) or "0.1s" (seconds). Raises InputError."""
        text = str(gap).strip()
        try:
            found = Gap(0, round(float(text[:-1]) * 1e9)) if text.endswith("s") else Gap(int(text))
        except (ValueError, OverflowError):
            found = Gap(0)
        if not (0 < found.frames <= LONGEST_GAP or found.ns > 0):
            raise InputError(
                f"keyframes.gap = {gap!r}: give 1 to {LONGEST_GAP} frames, as in 3, or seconds, as in '0.1s'"
            )
        return found


def pairs(stream: Iterable[Frame | Skipped], s: KeyframeSettings) -> Iterator[FramePair | Skipped]:
    """Every stride-th frame with its partner one gap later; passes on what the stream left out.

    By seconds, the partner is the later frame whose time is nearest to one gap later; a frame without one
    within half a gap is told as Skipped. Raises InputError for a gap of more frames than memory should hold.
    """
    gap = Gap.parse(s.gap)
    waiting: deque[Frame] = deque()  # from the oldest frame without partner on
    count = 0
    starts: deque[bool] = deque()  # whether each waiting frame starts a pair
    for item in stream:
        if isinstance(item, Skipped):
            yield item
            continue
        if waiting and item.stamp_ns < waiting[-1].stamp_ns - SET_BACK_NS:  # no pair spans that
            yield from _rest(waiting, starts, gap)
        waiting.append(item)
        starts.append(count % s.stride == 0)
        count += 1
        while (partner := _partner(waiting, gap, last=False)) is not None:
            yield from _paired(waiting, starts, partner, gap)
        if len(waiting) > LONGEST_GAP + 1:
            raise InputError(f"keyframes.gap = {s.gap!r} spans more than {LONGEST_GAP} frames of this log; lower it")
    yield from _rest(waiting, starts, gap)


def _rest(waiting: deque[Frame], starts: deque[bool], gap: Gap) -> Iterator[FramePair | Skipped]:
    """The pairs of what no frame follows."""
    while waiting:
        partner = _partner(waiting, gap, last=True)
        yield from _paired(waiting, starts, partner or 0, gap)


def _partner(waiting: deque[Frame], gap: Gap, *, last: bool) -> int | None:
    """Index in ``waiting`` of the first one's partner; 0 if it has none; None while that is not known yet."""
    if gap.frames:
        return gap.frames if len(waiting) > gap.frames else None
    target = waiting[0].stamp_ns + gap.ns
    if not last and waiting[-1].stamp_ns < target:
        return None
    later = range(1, len(waiting))
    best = min(later, key=lambda k: abs(waiting[k].stamp_ns - target), default=0)
    return best if abs(waiting[best].stamp_ns - target) <= gap.ns // 2 else 0


def _paired(waiting: deque[Frame], starts: deque[bool], partner: int, gap: Gap) -> Iterator[FramePair | Skipped]:
    first = waiting[0]
    if starts[0] and partner:
        yield FramePair(first, waiting[partner])
    elif starts[0]:
        distance = f"{gap.frames} frames" if gap.frames else f"{gap.ns / 1e9:g} s"
        yield Skipped(first.stamp_ns, f"pair of frame {first.index}", f"no frame {distance} later", first.index)
    waiting.popleft()
    starts.popleft()


def prefetched(stream: Iterable[T], ahead: int) -> Generator[T]:
    """The same items, produced up to ``ahead`` early by a thread. An error in the stream is raised here.

    Closing the generator stops the thread.
    """
    box: queue.Queue[tuple[str, T | BaseException | None]] = queue.Queue(maxsize=ahead)
    stop = threading.Event()

    def put(kind: str, value: T | BaseException | None) -> None:
        while not stop.is_set():
            try:
                box.put((kind, value), timeout=0.1)
            except queue.Full:
                continue
            return

    def produce() -> None:
        try:
            for item in stream:
                put("item", item)
                if stop.is_set():
                    return
            put("end", None)
        except BaseException as e:  # noqa: BLE001  raised again in the reader's thread
            put("error", e)

    thread = threading.Thread(target=produce, name="prefetch", daemon=True)
    thread.start()
    try:
        while True:
            kind, value = box.get()
            match kind:
                case "item":
                    yield value  # type: ignore[misc]
                case "error":
                    raise value  # type: ignore[misc]
                case _:
                    return
    finally:
        stop.set()
        thread.join()
