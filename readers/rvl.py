"""RVL: Wilson, "Fast Lossless Depth Image Compression", ISS 2017.

An image is runs: how many zeros, how many others, then the others' differences, each from the other before (the first
from 0), with 0, -1, 1, -2, ... written as 0, 1, 2, 3, ... A number is nibbles, its lowest three bits first; the fourth
bit says that more follow. Eight nibbles fill a little-endian 32-bit word from its upper end.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from vlmm_log.types import UInt16

UInt32 = NDArray[np.uint32]

MOST_BITS = 30  # of a number; differences have 17, runs fewer than 30

jit = numba.njit(cache=True, nogil=True)


def encode(values: UInt16) -> bytes:
    """Depth of any shape, row by row."""
    flat = np.ascontiguousarray(values, np.uint16).ravel()
    words = np.zeros(flat.size + 1, np.uint32)  # a pixel takes 8 nibbles at most, its runs' lengths included
    return words[: _encode(flat, words)].astype("<u4").tobytes()


def decode(data: bytes | memoryview, pixels: int) -> UInt16:
    """Depth (pixels,). Raises ValueError where the data end early or hold runs longer than the image."""
    words = np.frombuffer(data, "<u4", len(data) // 4).astype(np.uint32)  # a copy, since it may lie at any address
    values = np.empty(pixels, np.uint16)
    if _decode(words, values) != pixels:
        raise ValueError("RVL data are damaged")
    return values


@jit
def _encode(values: UInt16, words: UInt32) -> int:
    """How many ``words``, which are zeros, got used."""
    n, i, place = values.size, 0, 0
    previous: Any = 0
    while i < n:
        start = i
        while i < n and values[i] == 0:
            i += 1
        place = _put(i - start, words, place)
        start = i
        while i < n and values[i] != 0:
            i += 1
        place = _put(i - start, words, place)
        for k in range(start, i):
            current = np.int64(values[k])
            step = current - previous
            place = _put((step << 1) ^ (step >> 63), words, place)
            previous = current
    return (place + 7) >> 3


@jit
def _decode(words: UInt32, values: UInt16) -> int:
    """How many values there are; -1 for damage. Differences wrap around 16 bits, as those of signed encoders do."""
    n, i, place, previous = values.size, 0, 0, 0
    while i < n:
        zeros, place = _take(words, place)
        if zeros < 0 or zeros > n - i:
            return -1
        for _ in range(zeros):
            values[i] = 0
            i += 1
        others, place = _take(words, place)
        if others < 0 or others > n - i:
            return -1
        for _ in range(others):
            step, place = _take(words, place)
            if step < 0:
                return -1
            previous = (previous + ((step >> 1) ^ -(step & 1))) & 0xFFFF
            values[i] = previous
            i += 1
    return i


@jit
def _put(number: Any, words: UInt32, place: int) -> int:
    """The place, in nibbles, after the number."""
    while True:
        nibble = number & 7
        number >>= 3
        if number:
            nibble |= 8
        words[place >> 3] |= np.uint32(nibble << (28 - 4 * (place & 7)))
        place += 1
        if not number:
            return place


@jit
def _take(words: UInt32, place: int) -> tuple[int, int]:
    """A number, -1 where the data end or no number is that long, and the place after it."""
    bits = 0
    number: Any = 0
    while bits < MOST_BITS and (place >> 3) < words.size:
        nibble = (np.int64(words[place >> 3]) >> (28 - 4 * (place & 7))) & 15
        place += 1
        number |= (nibble & 7) << bits
        bits += 3
        if nibble < 8:
            return number, place
    return -1, place
