"""The chunks of a ROS 1 bag."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import BinaryIO

import numpy as np

from vlmm_log.readers.bag.channels import Channel
from vlmm_log.readers.bag.chunked import ChunkError, Record, read_at, times_of
from vlmm_log.readers.bag.rosbag1_records import (
    CHUNK,
    CONNECTION,
    INDEX,
    MESSAGE,
    chunk_content,
    connection,
    index_times,
    message,
    record_in,
    records,
)
from vlmm_log.readers.stamps import LATEST_NS
from vlmm_log.types import Int64


@dataclass(frozen=True, eq=False)
class BagPlace:
    """A chunk's data in the file, or records that stand there outside chunks."""

    at: int  # byte where it begins, for people
    start: int = 0  # of the data
    stop: int = 0
    compression: bytes = b""
    size: int | None = None  # bytes uncompressed; None: cut off
    index: tuple[int, int] | None = None  # bytes of the index records that follow
    times: dict[int, Int64] | None = None  # log times by connection where they are known already
    span: tuple[int, int] = (0, LATEST_NS)  # log times of the first and last message


def chunk_place(file: BinaryIO, at: int) -> BagPlace:
    """The chunk at a byte; its index still unknown. Raises ChunkError."""
    record = record_in(file, at)
    if record.op != CHUNK:
        raise ChunkError("chunk is damaged")
    compression = record.fields.get(b"compression", b"")
    return BagPlace(at, record.start, record.stop, compression, record.number(b"size"))


def chunk_data(file: BinaryIO, place: BagPlace) -> memoryview:
    """The records of a chunk, uncompressed; of one that is cut off, what is left. Raises ChunkError."""
    if not place.compression:
        raise ChunkError("chunk is damaged")
    data = read_at(file, place.start, place.stop - place.start)
    return memoryview(chunk_content(data, place.compression, place.size))


def indexed_times(file: BinaryIO, place: tuple[int, int]) -> dict[int, Int64]:
    """Log times by connection from the index records of a chunk. Raises ChunkError."""
    data = read_at(file, place[0], place[1] - place[0])
    times: dict[int, list[Int64]] = {}
    for record in records(memoryview(data)):
        if record.op == INDEX:
            key, own = index_times(record, data[record.start : record.stop])
            times.setdefault(key, []).append(own)
    return {key: np.concatenate(own) for key, own in times.items()}


def chunk_messages(file: BinaryIO, place: BagPlace) -> Iterator[Record]:
    """The messages of a chunk; of one that is cut off, the whole ones. Raises ChunkError."""
    return _messages(chunk_data(file, place), place)


def _messages(data: memoryview, place: BagPlace) -> Iterator[Record]:
    at = 0
    try:
        for record in records(data):
            if record.op == MESSAGE:
                yield message(record, data, at)
            at = record.stop
    except ChunkError:
        if place.size is not None:
            raise


def explored(file: BinaryIO, place: BagPlace, channels: dict[int, Channel]) -> BagPlace:
    """A chunk with its log times, its connections put into ``channels``; without times where it is damaged."""
    try:
        times = indexed_times(file, place.index) if place.index else {}
        if not times or not times.keys() <= channels.keys():
            data = chunk_data(file, place)
            times = times or times_of(list(_messages(data, place)))
            for key, found in _connections(data, place):
                channels.setdefault(key, found)
    except ChunkError:
        return replace(place, index=None, times=None)
    ends = [(int(own.min()), int(own.max())) for own in times.values() if own.size]
    span = (min(e[0] for e in ends), max(e[1] for e in ends)) if ends else (0, 0)
    return replace(place, times=times, span=span)


def _connections(data: memoryview, place: BagPlace) -> Iterator[tuple[int, Channel]]:
    try:
        for record in records(data):
            if record.op == CONNECTION:
                yield connection(record, data[record.start : record.stop])
    except ChunkError:
        if place.size is not None:
            raise
