"""Features on disk by what they were made from, so that no run computes one twice or holds them all."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from vlmm_log.types import Float32

CHECK = 8  # bytes of digest after a feature


class FeatureCache:
    """Float32 vectors of one width in one folder, a file each. A damaged one counts as absent."""

    def __init__(self, folder: Path, width: int, space: str) -> None:
        """``space`` names all beside the content that decides a feature: weights, preprocessing, device."""
        self.note = ""  # why nothing is written any more, if so
        self.hits = self.computed = 0
        self._folder, self._width, self._space = folder, width, space

    def remembered(self, contents: Sequence[bytes], compute: Callable[[list[int]], Float32]) -> Float32:
        """(n, width) features of n contents, zeros of an empty one; ``compute`` gives the rows that are not on disk."""
        keys = [hashlib.sha256(f"{self._space}\0".encode() + content).hexdigest() for content in contents]
        features = np.zeros((len(keys), self._width), np.float32)
        full = [i for i, content in enumerate(contents) if content]
        missing = [i for i in full if not self._read(keys[i], features[i])]
        if missing:
            features[missing] = compute(missing)
        for i in missing:
            self._write(keys[i], features[i].tobytes())
        self.hits += len(full) - len(missing)
        self.computed += len(missing)
        return features

    @property
    def used(self) -> tuple[int, int, str]:
        """Features found, features computed, why none is written any more."""
        return self.hits, self.computed, self.note

    def add(self, used: tuple[int, int, str]) -> None:
        """What another process used of the same cache."""
        hits, computed, note = used
        self.hits, self.computed, self.note = self.hits + hits, self.computed + computed, self.note or note

    def __str__(self) -> str:
        return f"{self.hits} features found, {self.computed} computed{'; ' * bool(self.note)}{self.note}"

    def _path(self, key: str) -> Path:
        return self._folder / key[:2] / f"{key[2:]}.f32"

    def _read(self, key: str, into: Float32) -> bool:
        try:
            data = self._path(key).read_bytes()
        except OSError:
            return False
        if len(data) != into.nbytes + CHECK or data[into.nbytes :] != _check(data[: into.nbytes]):
            return False
        into[:] = np.frombuffer(data, np.float32, into.size)
        return True

    def _write(self, key: str, data: bytes) -> None:
        if self.note:
            return
        path = self._path(key)
        part = path.with_suffix(f".{os.getpid()}.partial")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            part.write_bytes(data + _check(data))
            part.replace(path)  # what another process reads is whole
        except OSError as e:
            self.note = f"{self._folder}: features are not kept: {e.strerror or e}"
            with suppress(OSError):
                part.unlink()


def _check(data: bytes) -> bytes:
    return hashlib.blake2b(data, digest_size=CHECK).digest()
