"""RVL: Wilson, "Fast Lossless Depth Image Compression", ISS 2017.

An image is runs: how many zeros, how many others, then the others' differences, each from the other before (the first
from 0), with 0, -1, 1, -2, ... written as 0, 1, 2, 3, ... A number is nibbles, its lowest three bits first; the fourth
bit says that more follow. Eight nibbles fill a little-endian 32-bit word from its upper end.
"""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlmm_log.compiled import jit
from vlmm_log.types import Float32, UInt16

UInt32 = NDArray[np.uint32]

HEADER = struct.Struct("<iffii")  # of ROS's compressed depth images: 0, 0, 0, then width and height
LARGEST = 1 << 26  # px of an image; a damaged size is not worth its memory
MOST_BITS = 30  # of a number; differences have 17, runs fewer than 30


def encode(values: UInt16) -> bytes:
    """Depth of any shape, row by row."""
    flat = np.ascontiguousarray(values, np.uint16).ravel()
    words = np.empty(flat.size + 1, np.uint32)  # a pixel takes 8 nibbles at most, its runs' lengths included
    return words[: _encode(flat, words)].astype("<u4").tobytes()


def decode(data: bytes | memoryview, pixels: int) -> UInt16:
    """Depth (pixels,). Raises ValueError where the data end early or hold runs longer than the image."""
    words = np.frombuffer(data, "<u4", len(data) // 4).astype(np.uint32)  # a copy, since it may lie at any address
    values = np.empty(pixels, np.uint16)
    if _decode(words, values) != pixels:
        raise ValueError("RVL data are damaged")
    return values


def encode_steps(field: Float32, step: float) -> bytes:
    """An image of a field (H, W), none negative, in whole steps: 1 to 65535, so that 0 stands for NaN."""
    counts = np.empty(field.size, np.uint16)
    _count(np.ascontiguousarray(field, np.float32).ravel(), np.float32(1 / step), counts)
    return HEADER.pack(0, 0.0, 0.0, field.shape[1], field.shape[0]) + encode(counts)


def decode_steps(image: bytes | memoryview, step: float) -> Float32:
    """The numbers (H, W) to the nearest step, NaN where there is none. Raises ValueError for a damaged image."""
    if len(image) < HEADER.size:
        raise ValueError("RVL image ends within its header")
    *_, width, height = HEADER.unpack_from(image)
    if not (0 < width <= LARGEST and 0 < height <= LARGEST // width):
        raise ValueError("RVL image has a damaged size")
    counts = decode(image[HEADER.size :], width * height).reshape(height, width)
    return np.where(counts == 0, np.float32(np.nan), counts * np.float32(step))


@jit
def _count(field: Float32, steps_a_unit: Any, counts: UInt16) -> None:
    for i in range(field.size):
        count = np.rint(field[i] * steps_a_unit)
        inside = min(max(count, np.float32(1)), np.float32(65535))
        counts[i] = np.uint16(inside) if count == count else np.uint16(0)


@jit
def _encode(values: UInt16, words: UInt32) -> int:
    """How many ``words`` got used."""
    n, i, used = values.size, 0, 0
    held: Any = 0
    pending = np.uint64(0)  # ``held`` nibbles, fewer than eight, that wait for a word
    previous: Any = 0
    while i < n:
        start = i
        while i < n and values[i] == 0:
            i += 1
        pending, held, used = _put(i - start, pending, held, words, used)
        start = i
        while i < n and values[i] != 0:
            i += 1
        pending, held, used = _put(i - start, pending, held, words, used)
        for k in range(start, i):
            current = np.int64(values[k])
            step = current - previous
            pending, held, used = _put((step << 1) ^ (step >> 63), pending, held, words, used)
            previous = current
    if held:
        words[used] = np.uint32(pending << np.uint64(32 - 4 * held))
        used += 1
    return used


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
def _put(number: Any, pending: Any, held: Any, words: UInt32, used: int) -> tuple[Any, Any, int]:
    """The nibbles that wait after the number, how many, and how many words are full."""
    bits = np.uint64(number)
    if bits < np.uint64(64):  # nearly always: one or two nibbles, without a branch that noise would decide
        more = bits >> np.uint64(3)
        two = np.uint64(more != np.uint64(0))
        pending = (pending << np.uint64(4)) | (bits & np.uint64(7)) | (two << np.uint64(3))
        pending = (pending << (two << np.uint64(2))) | more
        held += 1 + np.int64(two)
        words[used] = np.uint32(pending >> np.uint64(4 * (held & 7)))  # written again until it is full
        used += held >> 3
        return pending, held & 7, used
    while bits >= np.uint64(8):
        pending = (pending << np.uint64(4)) | (bits & np.uint64(7)) | np.uint64(8)
        bits >>= np.uint64(3)
        held += 1
    pending = (pending << np.uint64(4)) | bits
    held += 1
    while held >= 8:
        held -= 8
        words[used] = np.uint32(pending >> np.uint64(4 * held))
        used += 1
    return pending, held, used


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
