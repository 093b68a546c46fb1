"""Whether the messages of a Rerun recording can be decoded: Rerun's own decoder ends the process where one is damaged.

A message of kind 2 is Protobuf, an ``ArrowMsg``: 2 compression (1 none, 2 LZ4), 3 size, 5 an Arrow IPC stream.
A whole file ends in a message of kind 0, the footer, and in the 32 bytes that say where that lies. Rerun reads from
where the footer says and never counts the lengths together, so they are checked too: what one of them hides is read.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import BinaryIO

import lz4.block  # type: ignore[import-untyped]
import numpy as np
import pyarrow as pa

STREAM_HEADER, MESSAGE_HEADER = 12, struct.Struct("<QQ")  # kind and length of what follows
TRAILER = 32  # bytes after the footer
END, ARROW, BLUEPRINT = 0, 2, 3  # kinds; 1 tells whose recording it is
LZ4 = 2
EXPANSION = 255  # times its length that LZ4 becomes at most


def places(file: BinaryIO, size: int) -> Iterator[tuple[int, int, int]]:
    """Kind, first byte and length of each whole message."""
    at = STREAM_HEADER
    while at + MESSAGE_HEADER.size <= size:
        file.seek(at)
        kind, length = MESSAGE_HEADER.unpack(file.read(MESSAGE_HEADER.size))
        at += MESSAGE_HEADER.size
        if at + length > size:
            return
        yield kind, at, length
        at += length


def first_damage(file: BinaryIO, size: int) -> int | None:
    """The byte of the first message that is no sound Arrow table or has no place; None where all are whole."""
    end = STREAM_HEADER
    for kind, at, length in places(file, size):
        end = at + length
        if kind > BLUEPRINT or (kind == END and size - end not in (0, TRAILER)):
            return at
        if kind == END:
            return None
        if kind == ARROW:
            file.seek(at)
            if not _is_sound(file.read(length)):
                return at
    return None if end >= size else end + MESSAGE_HEADER.size


def _is_sound(message: bytes) -> bool:
    try:
        fields = dict(_fields(memoryview(message)))
        data, size = fields[5], fields.get(3, 0)
        assert isinstance(data, memoryview)
        assert isinstance(size, int)
        if fields.get(2) == LZ4:
            if size > EXPANSION * len(data):
                return False
            data = lz4.block.decompress(data, uncompressed_size=size)
        if not all(_inside(batch) for batch in pa.ipc.MessageReader.open_stream(data) if batch.type == "record batch"):
            return False
        table = pa.ipc.open_stream(data).read_all()
        table.validate(full=True)
        if any("\0" in f"{field.name} {field.type}" for field in table.schema):
            return False  # Rerun hands these over as C's strings
    except (
        AssertionError,
        LookupError,
        ValueError,
        OSError,
        RuntimeError,
        struct.error,
        pa.ArrowException,
        lz4.block.LZ4BlockError,
    ):
        return False
    return True


def _inside(batch: pa.Message) -> bool:
    """Whether all buffers of a record batch lie in its body: Arrow's own reader looks at those that it needs alone.

    A Flatbuffers table, https://flatbuffers.dev/internals; ``Message`` and ``RecordBatch`` of Arrow's format, in which
    the third field is the header, and the buffers.
    """
    data = memoryview(batch.metadata)
    header = _third(data, _offset(data, 0))
    buffers = _third(data, header + _offset(data, header))
    start = buffers + _offset(data, buffers)
    places = np.frombuffer(data, "<i8", 2 * _offset(data, start), start + 4).reshape(-1, 2)
    size = batch.body.size
    return bool(((places >= 0) & (places <= size)).all() and (places.sum(axis=1) <= size).all())


def _third(data: memoryview, table: int) -> int:
    """Where the third field of a Flatbuffers table is. Raises ValueError where it has none."""
    entries = table - struct.unpack_from("<i", data, table)[0]
    (field,) = struct.unpack_from("<H", data, entries + 4 + 2 * 2)
    if not field:
        raise ValueError("a field is missing")
    return table + int(field)


def _offset(data: memoryview, at: int) -> int:
    return int(struct.unpack_from("<I", data, at)[0])


def _fields(message: memoryview) -> Iterator[tuple[int, int | memoryview]]:
    """Numbers and values of a Protobuf message: https://protobuf.dev/programming-guides/encoding"""
    at = 0
    while at < len(message):
        tag, at = _varint(message, at)
        match tag & 7:
            case 0:
                value, at = _varint(message, at)
                yield tag >> 3, value
            case 2:
                length, at = _varint(message, at)
                if at + length > len(message):
                    raise ValueError("a field is cut off")
                yield tag >> 3, message[at : at + length]
                at += length
            case wire:
                raise ValueError(f"wire type {wire}")


def _varint(message: memoryview, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):
        byte = message[at]
        at += 1
        value |= (byte & 127) << shift
        if byte < 128:
            return value, at
    raise ValueError("a number has no end")
