"""When what is stamped was recorded: the recorder's clock against that of the headers, which may run otherwise."""

from __future__ import annotations

from vlmm_log.readers.bag.containers import Container, Message, MessageError
from vlmm_log.readers.bag.messages import stamp_of
from vlmm_log.types import Int64

PROBED = 5  # messages that are tried from one place on


def recorded_at(container: Container, topic: str, stamp_ns: int) -> int | None:
    """Log time of the topic's first message that is stamped so late, by bisection; None where it is not known.

    Simulators let time pass at another rate than recorders.
    """
    times = container.log_times(topic)
    if times is None or not times.size:
        return None
    low, high = 0, int(times.size)
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
