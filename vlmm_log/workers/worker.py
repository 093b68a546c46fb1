"""A worker: a process that looks at the pairs it is given, one after another."""

from __future__ import annotations

import pickle
import signal
import traceback
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from vlmm_log.heap import keep_pages
from vlmm_log.pipeline.run import Look, look
from vlmm_log.protocols import Make, Models
from vlmm_log.settings import Settings
from vlmm_log.sinks.many import made_by
from vlmm_log.types import FramePair, Skipped
from vlmm_log.workers.slot import Sizes, Slot

READY = "ready"


@dataclass(frozen=True, eq=False)
class Looked:
    """What came of a pair."""

    look: Look
    made: list[tuple[Any, float]]  # of each result, by the sink's first half, and what the stage took, ms


Looks = Callable[[Iterator[FramePair | Skipped], Make], Generator[tuple[FramePair, Looked] | Skipped]]
"""Whoever looks at the pairs of a stream: in its order, with all that it left out."""


@dataclass(frozen=True)
class Job:
    """A pair to look at, in a slot."""

    slot: int
    sizes: Sizes


@dataclass(frozen=True)
class Done:
    """What came of it, in the slot of the same number; or why nothing did."""

    sizes: Sizes
    error: Exception | None = None


def looked_at(pair: FramePair, make: Make, models: Models, s: Settings) -> Looked:
    """What a pair shows, and the sink's first half of it."""
    observe, made = made_by(make, pair)
    return Looked(look(pair, models, s, observe), made)


def alone(
    models: Models, s: Settings, stream: Iterator[FramePair | Skipped], make: Make
) -> Generator[tuple[FramePair, Looked] | Skipped]:
    """One after another, in this process."""
    for item in stream:
        yield item if isinstance(item, Skipped) else (item, looked_at(item, make, models, s))


def work(connection: Connection, pairs: Sequence[Path], results: Sequence[Path], s: Settings) -> None:
    """Look at pairs until the caller has no more, or is gone. ``pairs`` and ``results`` are the slots' files.

    Says that they are open; then takes the sink's first half, and jobs, each of which it answers.
    """
    for number in (signal.SIGINT, signal.SIGTERM):  # of a whole group of processes: the caller's to handle
        signal.signal(number, signal.SIG_IGN)
    keep_pages()
    slots = [(Slot(a), Slot(b)) for a, b in zip(pairs, results, strict=True)]
    with suppress(EOFError, OSError):  # the caller is gone
        connection.send(READY)
        models = _models(s)
        make: Make = connection.recv()
        while (job := connection.recv()) is not None:
            pair, result = slots[job.slot]
            connection.send(_answer(job, pair, result, make, models, s))
        cache = None if isinstance(models, Exception) else getattr(models.embed, "cache", None)
        connection.send(None if cache is None else cache.used)


def _models(s: Settings) -> Models | Exception:
    """The models, on one thread; or why there are none, which is told with the first pair."""
    import cv2

    from vlmm_log.models.load import load_models

    cv2.setNumThreads(1)
    try:
        return load_models(s)[0]
    except Exception as e:  # noqa: BLE001
        return e


def _answer(job: Job, pair: Slot, result: Slot, make: Make, models: Models | Exception, s: Settings) -> Done:
    try:
        if isinstance(models, Exception):
            raise models
        return Done(result.put(looked_at(pair.get(job.sizes), make, models, s)))
    except Exception as e:  # noqa: BLE001  raised again by the caller, in its turn
        return Done([], _sendable(e))


def _sendable(e: Exception) -> Exception:
    """The same exception; its text where it cannot be pickled."""
    try:
        pickle.loads(pickle.dumps(e))  # noqa: S301  our own
    except Exception:  # noqa: BLE001  whatever somebody else's class does
        return RuntimeError("".join(traceback.format_exception(e)))
    return e
