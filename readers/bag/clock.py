"""When what is stamped was recorded: the recorder's clock against that of the headers, which may run otherwise."""

from __future__ import annotations

import numpy as np

from vlmm_log.readers.bag.containers import Container, Message, MessageError
from vlmm_log.readers.bag.messages import stamp_of
from vlmm_log.types import Int64

SAME_RATE_NS = 500_000_000  # clocks that are so near to each other are one
PROBED = 5  # messages that are tried from one place on


def recorded_at(container: Container, topic: str, stamp_ns: int, even_ns: int) -> int:
    """Log time of the topic's first message that is stamped so late.

    It is ``even_ns`` if both clocks run at one rate. Simulators let time pass at another one than recorders: then it
    is found by bisection, as far as the container's index tells log times.
    """
    times = container.log_times(topic)
    if times is None or not times.size:
        return even_ns
    low, high = 0, int(times.size)
    there = min(int(np.searchsorted(times, even_ns)), high - 1)
    found = _stamp_from(container, topic, times, there)
    if found is not None and abs((found - stamp_ns) - (int(times[there]) - even_ns)) < SAME_RATE_NS:
        return even_ns
    while low < high:
        middle = (low + high) // 2
        found = _stamp_from(container, topic, times, middle)
        if found is None or found >= stamp_ns:
            high = middle
        else:
            low = middle + 1
    return int(times[low]) if low < times.size else container.stop_ns


def _stamp_from(container: Container, topic: str, times: Int64, k: int) -> int | None:
    """The stamp of the first readable one of a few messages."""
    last = int(times[min(k + PROBED, times.size) - 1])
    for message in container.messages([topic], int(times[k]), last + 1):
        if isinstance(message, Message):
            try:
                return stamp_of(message.decode())
            except MessageError:
                continue
    return None
