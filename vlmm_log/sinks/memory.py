"""Results kept in memory, for tests and notebooks."""

from __future__ import annotations

from vlmm_log.protocols import Moment, Result
from vlmm_log.types import RunEnd


class Memory:
    """Keeps every result with its moment."""

    def __init__(self) -> None:
        self.seen: list[tuple[Moment, Result]] = []
        self.end: RunEnd | None = None

    def write(self, result: Result, at: Moment) -> None:
        """Keep it."""
        self.seen.append((at, result))

    def close(self, end: RunEnd) -> None:
        """Keep how the run ended."""
        self.end = end
