"""MCAP files: ROS 1 and ROS 2 recordings, Foxglove's schemas in JSON and Protobuf."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import BinaryIO

from vlmm_log.readers.bag.channels import Channel, channel, counted
from vlmm_log.readers.bag.chunked import Chunked, ChunkError, Chunks, Record, read_at
from vlmm_log.readers.bag.mcap_index import ChunkPlace, McapIndex, chunk_data, from_summary, from_walk
from vlmm_log.readers.bag.mcap_records import HEAD, MAGIC, indexed_times, messages, parsed
from vlmm_log.types import InputError, Skipped


def open_mcap(path: Path) -> Chunked:
    """An MCAP file, by its summary, or by what can be read of a damaged one. Raises InputError."""
    try:
        size = path.stat().st_size
        file = path.open("rb")
    except OSError as e:
        raise InputError(f"{path}: cannot be read: {e}") from e
    try:
        return _opened(path, file, size)
    except BaseException:
        file.close()
        raise


def _opened(path: Path, file: BinaryIO, size: int) -> Chunked:
    profile = _profile(path, file)
    index = from_summary(file, size) or from_walk(file, size)
    counts, start_ns, stop_ns = _extent(index)
    channels = counted(_channels(index), counts)
    losses = [*index.losses, *_unknown(index, counts)]
    kind = f"MCAP ({profile})" if profile else "MCAP"
    return Chunked(
        path, kind, Chunks(file, index.chunks, channels, _messages, indexed_times), start_ns, stop_ns, tuple(losses)
    )


def _profile(path: Path, file: BinaryIO) -> str:
    from mcap.records import Header

    try:
        if read_at(file, 0, len(MAGIC)) != MAGIC:
            raise InputError(f"{path}: is no MCAP file, its first bytes are others; give a .bag, .db3 or .mcap")
        opcode, length = HEAD.unpack(read_at(file, len(MAGIC), HEAD.size))
        content = read_at(file, len(MAGIC) + HEAD.size, min(length, 1 << 20))
        return parsed(Header, content).profile if opcode == 0x01 else ""
    except ChunkError as e:
        raise InputError(f"{path}: holds no MCAP header ({e}); record it again") from e


def _channels(index: McapIndex) -> dict[int, Channel]:
    found = {}
    for key, c in index.channels.items():
        schema = index.schemas.get(c.schema_id)
        name, language, definition = (schema.name, schema.encoding, schema.data) if schema else ("", "", b"")
        found[key] = channel(c.topic, name, c.message_encoding, language, definition)
    return found


def _extent(index: McapIndex) -> tuple[Mapping[int, int], int, int]:
    """Messages by channel, and the log times between which they lie."""
    told = index.statistics
    if told is not None:
        return told.channel_message_counts, told.message_start_time, told.message_end_time + bool(told.message_count)
    counts: dict[int, int] = {}
    for c in index.chunks:
        for key, own in (c.times or {}).items():
            counts[key] = counts.get(key, 0) + own.size
    spans = [c.span for c in index.chunks if c.times]
    return counts, min((s[0] for s in spans), default=0), max((s[1] + 1 for s in spans), default=0)


def _unknown(index: McapIndex, counts: Mapping[int, int]) -> list[Skipped]:
    """Messages whose channel is described nowhere."""
    lost = {key: n for key, n in counts.items() if n and key not in index.channels}
    return [Skipped(0, f"{n} messages of channel {key}", "channel is not described") for key, n in lost.items()]


def _messages(file: BinaryIO, place: ChunkPlace) -> Iterator[Record]:
    return messages(chunk_data(file, place))
