"""Merging: several runs of messages, each in order, become one stream in order."""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from vlmm_log.readers.bag.containers import Message
from vlmm_log.types import Int64, Skipped


@dataclass(frozen=True)
class Run:
    """Messages in order: a chunk's, a file's. Begun only when the stream comes to ``first_ns``."""

    first_ns: int  # no message is earlier
    order: int  # in the file: decides between equal log times
    items: Callable[[], Iterator[Message | Skipped]]


def merged(runs: Iterable[Run]) -> Iterator[Message | Skipped]:
    """All runs as one stream. Only runs that overlap are open at the same time."""
    waiting = deque(sorted(runs, key=lambda r: (r.first_ns, r.order)))
    heads: list[tuple[int, int, Message | Skipped, Iterator[Message | Skipped]]] = []
    while waiting or heads:
        while waiting and (not heads or waiting[0].first_ns <= heads[0][0]):
            run = waiting.popleft()
            items = run.items()
            if (item := next(items, None)) is not None:
                heapq.heappush(heads, (_time(item), run.order, item, items))
        if not heads:
            continue
        _, order, item, items = heads[0]
        yield item
        if (following := next(items, None)) is None:
            heapq.heappop(heads)
        else:
            heapq.heapreplace(heads, (_time(following), order, following, items))


def _time(item: Message | Skipped) -> int:
    match item:
        case Message():
            return item.log_ns
        case Skipped():
            return item.stamp_ns


def ranked(parts: Sequence[Int64]) -> tuple[Int64, list[Int64]]:
    """All times ascending, and for each part, the position of its times among them; earlier parts win ties."""
    if not parts:
        return np.empty(0, np.int64), []
    times = np.concatenate(parts)
    ranks = np.arange(len(times))
    if np.any(times[1:] < times[:-1]):
        order = np.argsort(times, kind="stable")
        ranks[order] = np.arange(len(times))
        times = times[order]
    return times, np.split(ranks, np.cumsum([len(p) for p in parts])[:-1])
