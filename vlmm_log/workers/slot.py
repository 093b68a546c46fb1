"""Messages with large arrays between two processes, by memory that both map: one copy in, one copy out."""

from __future__ import annotations

import mmap
import os
import pickle
import shutil
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from vlmm_log.scratch import scratch

LINE = 64  # bytes: parts begin at multiples
SHARED = Path("/dev/shm")  # noqa: S108  memory, where there is such a folder with room
ROOM = 1 << 28  # bytes a worker
Sizes = list[int]
"""Bytes of each part of a message: the pickled head, then its arrays."""


def shared_folder(workers: int) -> TemporaryDirectory[str]:
    """A new folder for slots: in memory if there is room, else where temporary files go."""
    roomy = SHARED.is_dir() and os.access(SHARED, os.W_OK) and shutil.disk_usage(SHARED).free > workers * ROOM
    return scratch(SHARED if roomy else None)


class Slot:
    """A mapped file that holds one message at a time, and grows with it."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("a+b")
        self._map: mmap.mmap | None = None

    def put(self, message: Any) -> Sizes:
        """Write a message over the last one. Give the sizes to ``get``. Raises OSError where memory is full."""
        buffers: list[pickle.PickleBuffer] = []
        head = pickle.dumps(message, protocol=5, buffer_callback=buffers.append)
        parts = [memoryview(head), *(buffer.raw() for buffer in buffers)]
        sizes = [part.nbytes for part in parts]
        whole = self._mapped(_end(sizes))
        for start, part in zip(_starts(sizes), parts, strict=True):
            whole[start : start + part.nbytes] = part
        return sizes

    def get(self, sizes: Sizes) -> Any:
        """A copy of the message. Its arrays are read-only, each in memory of its own: what is kept keeps no other."""
        whole = np.frombuffer(self._mapped(_end(sizes)), np.uint8)
        head, *parts = (whole[start : start + size].copy() for start, size in zip(_starts(sizes), sizes, strict=True))
        for part in parts:
            part.flags.writeable = False
        return pickle.loads(head.data, buffers=parts)  # noqa: S301  of a process of our own

    def close(self) -> None:
        """Let go of the memory."""
        if self._map is not None:
            with suppress(BufferError):  # an interrupt left a view of it: it goes with that
                self._map.close()
        self._file.close()

    def _mapped(self, size: int) -> mmap.mmap:
        if self._map is None or len(self._map) < size:
            there = os.fstat(self._file.fileno()).st_size
            if there < size:
                _grow(self._file.fileno(), there, size + size // 4)
            if self._map is not None:
                self._map.close()
            self._map = mmap.mmap(self._file.fileno(), 0)
        return self._map


def _grow(file: int, there: int, size: int) -> None:
    """Take the memory now: a full one would kill whoever writes into it later."""
    if hasattr(os, "posix_fallocate"):
        os.posix_fallocate(file, there, size - there)
    else:
        os.ftruncate(file, size)


def _starts(sizes: Sizes) -> Sizes:
    starts, at = [], 0
    for size in sizes:
        starts.append(at)
        at += -(-size // LINE) * LINE
    return starts


def _end(sizes: Sizes) -> int:
    return max(_starts(sizes)[-1] + sizes[-1], 1)
