"""ROS 1 bags without an index: a recorder that was killed, a copy that was cut off."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import BinaryIO

from vlmm_log.readers.bag.channels import Channel
from vlmm_log.readers.bag.chunked import ChunkError, read_at
from vlmm_log.readers.bag.rosbag1_chunks import BagPlace, explored
from vlmm_log.readers.bag.rosbag1_records import (
    CHUNK,
    CONNECTION,
    INDEX,
    MAGIC,
    MESSAGE,
    BagRecord,
    connection,
    record_in,
)
from vlmm_log.types import Skipped

PIECE_BYTES = 4 << 20  # messages outside chunks are read in pieces of about this size
STREAM_MAGIC = {b"bz2": b"BZh", b"lz4": b"\x04\x22\x4d\x18"}


@dataclass(eq=False)
class Recovered:
    """What a bag still holds."""

    places: list[BagPlace] = field(default_factory=list)
    channels: dict[int, Channel] = field(default_factory=dict)
    losses: list[Skipped] = field(default_factory=list)


def recovered(file: BinaryIO, size: int) -> Recovered:
    """All chunks up to where the file is cut off or damaged; the last one as far as it goes."""
    found = Recovered()
    at = len(MAGIC)
    while at < size:
        try:
            record = record_in(file, at)
        except ChunkError:
            break
        if record.stop > size or _left_open(file, record):
            found.places += _cut(record, at, size)
            break
        _take(found, file, record, at)
        at = record.stop
    if found.places and at < size and (last := found.places[-1]).index:  # some of its index may be lost too
        found.places[-1] = replace(last, index=None)
    found.places = [explored(file, place, found.channels) for place in found.places]
    latest = max((p.span[1] for p in found.places if p.times), default=0)
    found.losses.append(Skipped(latest, "index", "bag has no usable index; its records were read in turn"))
    if at < size:
        found.losses.append(Skipped(latest, f"{size - at} bytes at the end", "file is cut off or damaged"))
    return found


def _take(found: Recovered, file: BinaryIO, record: BagRecord, at: int) -> None:
    """The next whole record of the file."""
    last = found.places[-1] if found.places else None
    if record.op == CHUNK:
        with suppress(ChunkError):
            compression = record.fields.get(b"compression", b"")
            place = BagPlace(at, record.start, record.stop, compression, record.number(b"size"))
            found.places.append(replace(place, index=(record.stop, record.stop)))
    elif record.op == INDEX and last and last.index:
        found.places[-1] = replace(last, index=(last.index[0], record.stop))
    elif record.op == CONNECTION:
        with suppress(ChunkError):  # its messages are told as lost
            key, channel = connection(record, read_at(file, record.start, record.stop - record.start))
            found.channels.setdefault(key, channel)
    elif record.op == MESSAGE:
        if last and not last.index and last.stop == at and record.stop - last.start < PIECE_BYTES:
            found.places[-1] = replace(last, stop=record.stop, size=record.stop - last.start)
        else:
            found.places.append(BagPlace(at, at, record.stop, b"none", record.stop - at))


def _left_open(file: BinaryIO, record: BagRecord) -> bool:
    """Whether it is a chunk whose head was never completed, followed by its compressed data."""
    magic = STREAM_MAGIC.get(record.fields.get(b"compression", b""))
    if record.op != CHUNK or record.stop != record.start or magic is None:
        return False
    try:
        return read_at(file, record.start, len(magic)) == magic
    except ChunkError:
        return False


def _cut(record: BagRecord, at: int, size: int) -> list[BagPlace]:
    """The chunk in whose middle the file ends."""
    if record.op != CHUNK:
        return []
    return [BagPlace(at, record.start, size, record.fields.get(b"compression", b""))]
