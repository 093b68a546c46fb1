"""Time stamps and time association. Integer nanoseconds throughout: float seconds lose 100 ns at today's epoch."""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from decimal import Decimal

LATEST_NS = 2**62  # a stamp and a limit add up within 64 bits
SORTED_IN = "stamp out of order; the image was sorted in"  # told of images that are used
SET_BACK = "clock of the stamps was set back here"
TOO_LATE = "image comes too late"
FOREVER_NS = 10**17  # three years: what is asked for so long is asked for to the end


def seconds_to_ns(text: str) -> int:
    """Nanoseconds of decimal seconds, exact. Raises ValueError where the text is no finite decimal number."""
    try:
        ns = int((Decimal(text) * 1_000_000_000).to_integral_value())
    except (ArithmeticError, ValueError) as e:  # decimal's errors are arithmetic ones
        raise ValueError(f"{text!r} is no time in seconds") from e
    if abs(ns) > LATEST_NS:
        raise ValueError(f"{text!r} is beyond what nanoseconds in 64 bits hold")
    return ns


def limit_ns(seconds: float) -> int:
    """Nanoseconds of a limit, which may be infinite: at most as many as stamps can differ by."""
    return round(min(seconds, 4e9) * 1e9)


def until_ns(stop_ns: int) -> int:
    """The same limit, or none at all: a clock that is set while recording may jump by decades."""
    return stop_ns if stop_ns < FOREVER_NS else 2**63


def associate(a: Sequence[int], b: Sequence[int], tolerance_ns: int) -> list[tuple[int, int]]:
    """Indices (i, j) of stamps that belong together, each used once, nearest pairs first, sorted by i.

    Both sequences ascend strictly. The pairing is stable: no two stamps left apart are nearer to each other than to
    the partners that they got. Of what is left, the nearest two are always neighbours in the order of all stamps, so
    that memory grows with the stamps and not with what lies within the tolerance.
    """
    line = sorted([(stamp, 0, i) for i, stamp in enumerate(a)] + [(stamp, 1, j) for j, stamp in enumerate(b)])
    before, after = list(range(-1, len(line) - 1)), list(range(1, len(line) + 1))
    heap: list[tuple[int, int, int, int, int]] = []  # distance, i, j, places of the two in the line

    def offer(left: int, right: int) -> None:
        if left >= 0 and right < len(line) and line[left][1] != line[right][1]:
            distance = line[right][0] - line[left][0]
            i, j = (line[place][2] for place in sorted((left, right), key=lambda place: line[place][1]))
            if distance <= tolerance_ns:
                heapq.heappush(heap, (distance, i, j, left, right))

    for left in range(len(line) - 1):
        offer(left, left + 1)
    used = [False] * len(line)
    pairs = []
    while heap:
        _, i, j, left, right = heapq.heappop(heap)
        if used[left] or used[right]:
            continue
        used[left] = used[right] = True
        pairs.append((i, j))
        outer = before[left], after[right]
        if outer[0] >= 0:
            after[outer[0]] = outer[1]
        if outer[1] < len(line):
            before[outer[1]] = outer[0]
        offer(*outer)
    return sorted(pairs)
