"""Time stamps and time association. Integer nanoseconds throughout: float seconds lose 100 ns at today's epoch."""

from __future__ import annotations

from collections.abc import Sequence
from decimal import Decimal

import numpy as np

LATEST_NS = 2**62  # a stamp and a limit add up within 64 bits
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

    Both sequences ascend. The pairing is stable: no two stamps left apart are nearer to each other than to
    the partners that they got.
    """
    later = np.asarray(b, np.int64)
    candidates = []
    for i, stamp in enumerate(a):
        low = int(np.searchsorted(later, stamp - tolerance_ns, "left"))
        high = int(np.searchsorted(later, stamp + tolerance_ns, "right"))
        candidates += [(abs(int(later[j]) - stamp), i, j) for j in range(low, high)]
    used_a: set[int] = set()
    used_b: set[int] = set()
    pairs = []
    for _, i, j in sorted(candidates):
        if i not in used_a and j not in used_b:
            used_a.add(i)
            used_b.add(j)
            pairs.append((i, j))
    return sorted(pairs)
