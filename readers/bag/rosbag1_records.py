"""Records of ROS 1 bags, format 2.0, as bytes. http://wiki.ros.org/Bags/Format/2.0"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from typing import BinaryIO, NamedTuple

import numpy as np

from vlmm_log.readers.bag.channels import Channel, channel
from vlmm_log.readers.bag.chunked import ChunkError, Record, read_at
from vlmm_log.readers.bag.decompression import decompressed, decompressed_head
from vlmm_log.types import Int64

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, BAG_HEADER, INDEX, CHUNK, CHUNK_INFO, CONNECTION = 2, 3, 4, 5, 6, 7
U4 = struct.Struct("<I")
_TIME = struct.Struct("<II")
LARGEST_HEADER = 1 << 24  # bytes; real ones have tens, of connections some thousands


class BagRecord(NamedTuple):
    """A record: its header, and where its data lies."""

    op: int
    fields: Mapping[bytes, bytes]
    start: int  # of the data
    stop: int

    def number(self, name: bytes) -> int:
        """A field with an unsigned number of 4 or 8 bytes. Raises ChunkError."""
        value = self.fields.get(name, b"")
        if len(value) not in (4, 8):
            raise ChunkError("record is damaged")
        return int.from_bytes(value, "little")

    def time_ns(self, name: bytes) -> int:
        """A field with a time. Raises ChunkError."""
        value = self.fields.get(name, b"")
        if len(value) != _TIME.size:
            raise ChunkError("record is damaged")
        seconds, ns = _TIME.unpack(value)
        return int(seconds) * 1_000_000_000 + int(ns)


def header_fields(data: bytes | memoryview) -> dict[bytes, bytes]:
    """The fields "name=value" of a record's header. Raises ChunkError."""
    fields: dict[bytes, bytes] = {}
    data = bytes(data)
    at = 0
    while at < len(data):
        if at + 4 > len(data):
            raise ChunkError("record is damaged")
        (size,) = U4.unpack_from(data, at)
        name, equals, value = data[at + 4 : at + 4 + size].partition(b"=")
        at += 4 + size
        if at > len(data) or not equals:
            raise ChunkError("record is damaged")
        fields[name] = value
    return fields


def records(data: memoryview) -> Iterator[BagRecord]:
    """All records of an uncompressed chunk. Raises ChunkError where they do not fill it."""
    at = 0
    while at < len(data):
        record = record_at(data, at)
        at = record.stop
        yield record


def record_at(data: memoryview, at: int) -> BagRecord:
    """The record at a byte. Raises ChunkError where it is damaged or does not fit."""
    if at + 4 > len(data):
        raise ChunkError("chunk is damaged")
    start = at + 4 + U4.unpack_from(data, at)[0]
    if start + 4 > len(data):
        raise ChunkError("chunk is damaged")
    fields = header_fields(data[at + 4 : start])
    op = fields.get(b"op", b"")
    stop = start + 4 + U4.unpack_from(data, start)[0]
    if len(op) != 1 or stop > len(data):
        raise ChunkError("chunk is damaged")
    return BagRecord(op[0], fields, start + 4, stop)


def record_in(file: BinaryIO, at: int) -> BagRecord:
    """The record at a byte of a file, its data unread and perhaps cut off. Raises ChunkError."""
    (size,) = U4.unpack(read_at(file, at, 4))
    if size > LARGEST_HEADER:
        raise ChunkError("record is damaged")
    header = read_at(file, at + 4, size + 4)
    fields = header_fields(header[:-4])
    op = fields.get(b"op", b"")
    if len(op) != 1:
        raise ChunkError("record is damaged")
    start = at + 4 + size + 4
    return BagRecord(op[0], fields, start, start + U4.unpack(header[-4:])[0])


def message(record: BagRecord, data: memoryview, at: int) -> Record:
    """A message record as a record of a chunk. Raises ChunkError."""
    return Record(record.time_ns(b"time"), at, record.number(b"conn"), data[record.start : record.stop])


def connection(record: BagRecord, data: bytes | memoryview) -> tuple[int, Channel]:
    """Number and channel of a connection record whose data are given. Raises ChunkError."""
    inner = header_fields(data)
    try:
        topic = record.fields[b"topic"].decode()
        type_ = inner[b"type"].decode()
        definition = inner.get(b"message_definition", b"")
    except (KeyError, UnicodeDecodeError) as e:
        raise ChunkError("record is damaged") from e
    name = ("/" if topic.startswith("/") else "") + "/".join(part for part in topic.split("/") if part)
    return record.number(b"conn"), channel(name, type_, "ros1", "ros1msg", definition)


def index_times(record: BagRecord, data: bytes) -> tuple[int, Int64]:
    """Connection and log times of an index record. Raises ChunkError."""
    count = record.number(b"count")
    if record.number(b"ver") != 1 or len(data) != 12 * count:
        raise ChunkError("message index is damaged")
    entries = np.frombuffer(data, "<u4").reshape(-1, 3).astype(np.int64)
    return record.number(b"conn"), entries[:, 0] * 1_000_000_000 + entries[:, 1]


def chunk_content(data: bytes, compression: bytes, size: int | None) -> bytes | memoryview:
    """The content of a chunk, whose own checksums bz2 and lz4 verify; of one without a size, what is left of it.

    Raises ChunkError.
    """
    if compression not in (b"none", b"bz2", b"lz4"):
        raise ChunkError(f"chunk compression {compression.decode(errors='replace')[:20]!r} is not read")
    how = compression.decode().replace("none", "")
    if size is None:
        return decompressed_head(data, how) if how else data
    try:
        return decompressed(data, how, size)
    except ValueError as e:
        raise ChunkError("chunk cannot be decompressed" if how else "chunk is damaged") from e
