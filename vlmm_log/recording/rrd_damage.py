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
        table = pa.ipc.open_stream(data).read_all()
        table.validate(full=True)
        if any("\0" in f"{field.name} {field.type}" for field in table.schema):
            return False  # Rerun hands these over as C's strings
    except (AssertionError, LookupError, ValueError, OSError, RuntimeError, pa.ArrowException, lz4.block.LZ4BlockError):
        return False
    return True


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
