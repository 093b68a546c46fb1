"""The caller's side: pairs go to workers by turns, and what they saw comes back in the order of the pairs."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
from collections import deque
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from pathlib import Path
from types import TracebackType
from typing import Any

from vlmm_log.protocols import Make
from vlmm_log.settings import Settings
from vlmm_log.types import Frame, FramePair, InputError, Skipped
from vlmm_log.workers.slot import Slot, shared_folder
from vlmm_log.workers.worker import READY, Done, Job, Looked, work

AHEAD = 2  # pairs that each worker holds: one in hand and one waiting
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
PATIENCE_S = 5.0  # for workers that were told to end


@dataclass
class Hand:
    """A worker as the caller knows it."""

    process: SpawnProcess
    connection: Connection
    pairs: list[Slot]
    results: list[Slot]
    given: int = 0  # jobs
    taken: int = 0


class Crew:
    """Workers, each a process of its own with models of its own and one thread. They start at once."""

    def __init__(self, workers: int, s: Settings) -> None:
        self._folder = shared_folder(workers)
        self._hands: list[Hand] = []
        self._unready = workers
        try:
            with _for_one_thread(), _ctrl_c_held():  # which children inherit
                for k in range(workers):
                    self._hands.append(self._hired(k, s))
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Crew:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def looks(self, stream: Iterator[FramePair | Skipped], make: Make) -> Generator[tuple[FramePair, Looked] | Skipped]:
        """What workers saw of the pairs of a stream, in its order, and all that it left out.

        Raises what the stream raises, after the pairs before; what a worker raised, in its pair's turn; and
        InputError where a worker ended unasked.
        """
        for hand in self._hands:
            self._send(hand, make)
        waiting: deque[tuple[Hand, FramePair] | Skipped] = deque()
        turn, failure, more = 0, None, True
        while more or waiting:
            if more and sum(not isinstance(item, Skipped) for item in waiting) < AHEAD * len(self._hands):
                try:
                    item = next(stream, None)
                except Exception as e:  # noqa: BLE001  raised below
                    item, failure = None, e
                if isinstance(item, FramePair):
                    hand = self._hands[turn % len(self._hands)]
                    turn += 1
                    self._give(hand, item)
                    waiting.append((hand, item))
                elif item is not None:
                    waiting.append(item)
                more = item is not None
                continue
            first = waiting.popleft()
            yield first if isinstance(first, Skipped) else (first[1], self._take(first[0]))
        if failure is not None:
            raise failure

    def used(self) -> list[tuple[int, int, str]]:
        """End the workers: what each found and computed of features in a cache, and why it kept none."""
        for hand in self._hands:
            self._send(hand, None)
        return [told for hand in self._hands if (told := self._heard(hand)) is not None]

    def close(self) -> None:
        """End the workers, whatever they do."""
        for hand in self._hands:
            hand.process.kill()  # they hear nothing else, and hold nothing that could be lost
        for hand in self._hands:
            hand.process.join(PATIENCE_S)
            hand.connection.close()
            for slot in (*hand.pairs, *hand.results):
                slot.close()
        self._folder.cleanup()

    def _hired(self, k: int, s: Settings) -> Hand:
        paths = [[Path(self._folder.name) / f"{kind}_{k}_{i}" for i in range(AHEAD)] for kind in ("pair", "look")]
        pairs, results = ([Slot(path) for path in group] for group in paths)
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        process = context.Process(target=work, args=(theirs, *paths, s), name=f"vlmm-log worker {k}", daemon=True)
        process.start()
        theirs.close()  # so that a worker's end is seen here
        return Hand(process, ours, pairs, results)

    def _give(self, hand: Hand, pair: FramePair) -> None:
        slot = hand.given % AHEAD  # free: its last job was taken
        hand.given += 1
        try:
            sizes = hand.pairs[slot].put(FramePair(_bare(pair.first), _bare(pair.second)))
        except OSError as e:
            raise InputError(f"{self._folder.name}: no room for a pair of frames: {e.strerror or e}") from e
        self._send(hand, Job(slot, sizes))

    def _take(self, hand: Hand) -> Looked:
        slot = hand.taken % AHEAD
        hand.taken += 1
        done: Done = self._heard(hand)
        if done.error is not None:
            raise done.error
        looked: Looked = hand.results[slot].get(done.sizes)
        return looked

    def _send(self, hand: Hand, message: Any) -> None:
        try:
            hand.connection.send_bytes(pickle.dumps(message))  # where a worker is gone, send()'s buffer crashes 3.12
        except OSError as e:
            raise _ended(hand) from e

    def _heard(self, hand: Hand) -> Any:
        """The next message of a worker."""
        while True:
            if hand.connection not in wait([hand.connection, hand.process.sentinel]):
                raise _ended(hand)
            try:
                message = hand.connection.recv()
            except (EOFError, OSError) as e:
                raise _ended(hand) from e
            if message != READY:
                return message
            self._unready -= 1
            if not self._unready:  # all have the files open: nothing stays behind, even if we are killed
                self._folder.cleanup()


def _bare(frame: Frame) -> Frame:
    """A frame without the source's bytes, which only the recorder needs."""
    return replace(frame, encoded_rgb=None, encoded_depth=None)


def _ended(hand: Hand) -> InputError:
    hand.process.join(PATIENCE_S)
    code = hand.process.exitcode
    how = signal.Signals(-code).name if code is not None and code < 0 else f"exit code {code}"
    return InputError(f"a worker process ended unasked ({how}); is memory short? give fewer --workers")


@contextmanager
def _for_one_thread() -> Iterator[None]:
    """The environment under which libraries take one thread."""
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(dict.fromkeys(ONE_THREAD, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextmanager
def _ctrl_c_held() -> Iterator[None]:
    """Ctrl-C waits: a process that starts meanwhile never sees it."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
