"""ROS 1 bags."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

import numpy as np

from vlmm_log.readers.bag.channels import Channel, counted
from vlmm_log.readers.bag.chunked import Chunked, ChunkError, Chunks, read_at
from vlmm_log.readers.bag.rosbag1_chunks import BagPlace, chunk_messages, chunk_place, indexed_times
from vlmm_log.readers.bag.rosbag1_records import (
    BAG_HEADER,
    CHUNK_INFO,
    CONNECTION,
    MAGIC,
    BagRecord,
    connection,
    record_in,
    records,
)
from vlmm_log.readers.bag.rosbag1_recovery import recovered
from vlmm_log.types import InputError, Skipped


def open_rosbag1(path: Path) -> Chunked:
    """A ROS 1 bag of format 2.0, by its index, or by what can be read of one without. Raises InputError."""
    try:
        size = path.stat().st_size
        file = path.open("rb")
    except OSError as e:
        raise InputError(f"{path}: cannot be read: {e}") from e
    try:
        _checked(path, file.read(len(MAGIC)))
        _unencrypted(path, file)
        try:
            return _indexed(path, file, size)
        except ChunkError:
            return _recovered(path, file, size)
    except BaseException:
        file.close()
        raise


def _checked(path: Path, magic: bytes) -> None:
    if magic == MAGIC:
        return
    if magic.startswith(b"#ROSBAG V"):
        version = magic[9:].split(b"\n")[0].decode(errors="replace")
        raise InputError(f"{path}: is a bag of version {version}; make it 2.0 with 'rosbag fix'")
    raise InputError(f"{path}: is no ROS 1 bag, its first bytes are others; give a .bag, .db3 or .mcap")


def _unencrypted(path: Path, file: BinaryIO) -> None:
    with suppress(ChunkError):
        name = record_in(file, len(MAGIC)).fields.get(b"encryptor", b"")
        if name:
            raise InputError(
                f"{path}: is encrypted ({name.decode(errors='replace')}); decrypt it with 'rosbag decrypt'"
            )


def _indexed(path: Path, file: BinaryIO, size: int) -> Chunked:
    """By the index at the bag's end. Raises ChunkError where there is none or it is damaged."""
    head = record_in(file, len(MAGIC))
    index_pos = head.number(b"index_pos")
    if head.op != BAG_HEADER or not head.stop <= index_pos <= size:
        raise ChunkError("bag has no index")
    data = memoryview(read_at(file, index_pos, size - index_pos))
    entries = list(records(data))
    channels = dict(connection(r, data[r.start : r.stop]) for r in entries if r.op == CONNECTION)
    infos = sorted((r for r in entries if r.op == CHUNK_INFO), key=lambda r: r.number(b"chunk_pos"))
    if len(channels) != head.number(b"conn_count") or len(infos) != head.number(b"chunk_count"):
        raise ChunkError("bag has no index")
    starts = [r.number(b"chunk_pos") for r in infos]
    ends = [*starts[1:], index_pos][: len(infos)]  # index records fill the room between chunks
    counts: dict[int, int] = {}
    for r in infos:
        for key, n in _counts(r, data).items():
            counts[key] = counts.get(key, 0) + n
    places = [_place(file, r, end) for r, end in zip(infos, ends, strict=True)]
    start_ns, stop_ns = _extent([p for p, r in zip(places, infos, strict=True) if r.number(b"count")])
    chunks = Chunks(file, places, counted(channels, counts), chunk_messages, indexed_times)
    return Chunked(path, "ROS 1 bag", chunks, start_ns, stop_ns, tuple(_unknown(channels, counts)))


def _counts(info: BagRecord, data: memoryview) -> dict[int, int]:
    """Messages of a chunk by connection."""
    raw = data[info.start : info.stop]
    if len(raw) != 8 * info.number(b"count") or info.number(b"ver") != 1:
        raise ChunkError("bag has no index")
    return {int(key): int(n) for key, n in np.frombuffer(raw, "<u4").reshape(-1, 2)}


def _place(file: BinaryIO, info: BagRecord, stop: int) -> BagPlace:
    at = info.number(b"chunk_pos")
    span = (info.time_ns(b"start_time"), info.time_ns(b"end_time"))
    try:
        place = chunk_place(file, at)
    except ChunkError:
        return BagPlace(at, span=span)
    if place.stop > stop:
        return BagPlace(at, span=span)
    return replace(place, index=(place.stop, stop), span=span)


def _extent(places: list[BagPlace]) -> tuple[int, int]:
    return min((p.span[0] for p in places), default=0), max((p.span[1] + 1 for p in places), default=0)


def _unknown(channels: Mapping[int, Channel], counts: Mapping[int, int]) -> list[Skipped]:
    """Messages whose connection is described nowhere."""
    lost = {key: n for key, n in counts.items() if n and key not in channels}
    return [Skipped(0, f"{n} messages of connection {key}", "connection is not described") for key, n in lost.items()]


def _recovered(path: Path, file: BinaryIO, size: int) -> Chunked:
    found = recovered(file, size)
    counts: dict[int, int] = {}
    for place in found.places:
        for key, own in (place.times or {}).items():
            counts[key] = counts.get(key, 0) + own.size
    start_ns, stop_ns = _extent([p for p in found.places if p.times])
    chunks = Chunks(file, found.places, counted(found.channels, counts), chunk_messages, indexed_times)
    losses = [*found.losses, *_unknown(found.channels, counts)]
    return Chunked(path, "ROS 1 bag", chunks, start_ns, stop_ns, tuple(losses))
