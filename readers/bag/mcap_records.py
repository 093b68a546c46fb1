"""MCAP records as bytes: how a file is walked, and what a chunk holds. https://mcap.dev/spec"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from io import BytesIO
from typing import BinaryIO, NamedTuple, TypeVar

import numpy as np

from vlmm_log.readers.bag.chunked import ChunkError, Record, read_at
from vlmm_log.readers.bag.decompression import decompressed
from vlmm_log.types import Int64

MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")  # opcode, length of the content
_MESSAGE = struct.Struct("<HIqq")  # channel, sequence, log time, publish time
_INDEX = struct.Struct("<HI")  # channel, bytes of entries
_R = TypeVar("_R")


class Content(NamedTuple):
    """Where a record's content lies."""

    opcode: int
    start: int
    stop: int


def parsed(kind: type[_R], content: bytes | memoryview) -> _R:
    """A record of one of the library's types. Raises ChunkError where the bytes are none such."""
    from mcap.data_stream import ReadDataStream
    from mcap.exceptions import McapError

    read: Callable[[ReadDataStream], _R] = kind.read  # type: ignore[attr-defined]  # each has one, their base has none
    try:
        return read(ReadDataStream(BytesIO(content)))
    except (McapError, struct.error, ValueError, OverflowError, MemoryError) as e:
        raise ChunkError("record is damaged") from e


def contents(data: memoryview) -> Iterator[Content]:
    """All records of a chunk. Raises ChunkError where they do not fill it."""
    at = 0
    while at < len(data):
        if at + HEAD.size > len(data):
            raise ChunkError("chunk is damaged")
        opcode, length = HEAD.unpack_from(data, at)
        start, at = at + HEAD.size, at + HEAD.size + length
        if at > len(data) or (opcode == 0x05 and length < _MESSAGE.size):
            raise ChunkError("chunk is damaged")
        yield Content(opcode, start, at)


def messages(data: memoryview) -> Iterator[Record]:
    """The messages of a chunk, uncompressed. Raises ChunkError."""
    for opcode, start, stop in contents(data):
        if opcode == 0x05:
            key, sequence, log_ns, _ = _MESSAGE.unpack_from(data, start)
            yield Record(log_ns, start, key, data[start + _MESSAGE.size : stop], sequence)


def uncompressed(record: bytes) -> memoryview:
    """The content of a chunk record, its CRC checked where it has one. Raises ChunkError."""
    from mcap.records import Chunk

    chunk = parsed(Chunk, record)
    if chunk.compression not in ("", "lz4", "zstd"):
        raise ChunkError(f"chunk compression {chunk.compression[:20]!r} is not read")
    try:
        data = decompressed(chunk.data, chunk.compression, chunk.uncompressed_size)
    except ValueError as e:
        raise ChunkError("chunk cannot be decompressed") from e
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise ChunkError("chunk fails its CRC")
    return memoryview(data)


def indexed_times(file: BinaryIO, place: tuple[int, int]) -> dict[int, Int64]:
    """Log times by channel from a chunk's message index records, which lie in a row. Raises ChunkError."""
    data = memoryview(read_at(file, place[0], place[1] - place[0]))
    times: dict[int, list[Int64]] = {}
    for opcode, start, stop in contents(data):
        if opcode != 0x07:
            continue
        if stop - start < _INDEX.size:
            raise ChunkError("message index is damaged")
        key, size = _INDEX.unpack_from(data, start)
        if size % 16 or start + _INDEX.size + size > stop:
            raise ChunkError("message index is damaged")
        entries = np.frombuffer(data, "<i8", size // 8, start + _INDEX.size)
        times.setdefault(key, []).append(entries[::2].astype(np.int64))
    return {key: np.concatenate(own) for key, own in times.items()}
