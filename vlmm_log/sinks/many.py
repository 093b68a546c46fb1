"""Several sinks as one, none, and the identity function by which they see."""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import partial
from typing import Any

from vlmm_log.protocols import Halved, Make, Moment, Observe, R, Result, Sink
from vlmm_log.types import FramePair, RunEnd


class Many:
    """Gives each result to every sink, in order."""

    def __init__(self, sinks: Sequence[Sink]) -> None:
        self.sinks = sinks

    def write(self, result: Result, at: Moment) -> None:
        """Pass the result on."""
        for sink in self.sinks:
            sink.write(result, at)

    @property
    def made(self) -> Make:
        """See protocols.Halved. A sink that is not takes the result itself."""
        return partial(_all_made, [s.made if isinstance(s, Halved) else _itself for s in self.sinks])

    def take(self, made: Sequence[Any], at: Moment) -> None:
        """See protocols.Halved."""
        for sink, own in zip(self.sinks, made, strict=True):
            if isinstance(sink, Halved):
                sink.take(own, at)
            else:
                sink.write(own, at)

    def close(self, end: RunEnd) -> None:
        """Close every sink, also when one of them fails."""
        errors = []
        for sink in self.sinks:
            try:
                sink.close(end)
            except Exception as e:  # noqa: BLE001  the other sinks' files matter as much
                errors.append(e)
        if errors:
            for other in errors[1:]:
                errors[0].add_note(f"then: {other}")
            raise errors[0]


def _all_made(makes: Sequence[Make], result: Result, pair: FramePair) -> list[Any]:
    return [make(result, pair) for make in makes]


def _itself(result: Result, _pair: FramePair) -> Result:
    return result


def watched_by(sink: Sink, pair: FramePair) -> Observe:
    """An identity function that shows a pair's results to a sink, with the time that each stage took."""
    first = pair.first
    since = time.perf_counter()

    def observe(result: R, /) -> R:
        nonlocal since
        elapsed_ms = 1e3 * (time.perf_counter() - since)
        sink.write(result, Moment(first.stamp_ns, first.index, elapsed_ms))  # type: ignore[arg-type]
        since = time.perf_counter()
        return result

    return observe


def made_by(make: Make, pair: FramePair) -> tuple[Observe, list[tuple[Any, float]]]:
    """An identity function that keeps what a sink's first half makes of results, and what each stage took, ms."""
    kept: list[tuple[Any, float]] = []
    since = time.perf_counter()

    def observe(result: R, /) -> R:
        nonlocal since
        elapsed_ms = 1e3 * (time.perf_counter() - since)
        kept.append((make(result, pair), elapsed_ms))  # type: ignore[arg-type]
        since = time.perf_counter()
        return result

    return observe, kept
