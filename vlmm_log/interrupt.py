"""Ctrl-C, or a termination, that waits for the pair in hand, so that no result is torn."""

from __future__ import annotations

import signal
import threading
from types import FrameType, TracebackType
from typing import Any

ORDINARY: dict[signal.Signals, Any] = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL}


class Interruption:
    """While entered, the first Ctrl-C or SIGTERM only sets ``asked``; after it both act as ever, at once.

    Does nothing outside the main thread; a signal that somebody else handles is left to them.
    """

    def __init__(self) -> None:
        self.asked = False
        self._taken: list[signal.Signals] = []

    def __enter__(self) -> Interruption:
        if threading.current_thread() is threading.main_thread():
            self._taken = [number for number, ordinary in ORDINARY.items() if signal.getsignal(number) is ordinary]
            for number in self._taken:
                signal.signal(number, self._ask)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._give_back()

    def _ask(self, _signal: int, _frame: FrameType | None) -> None:
        self.asked = True
        self._give_back()

    def _give_back(self) -> None:
        for number in self._taken:
            signal.signal(number, ORDINARY[number])
        self._taken = []
