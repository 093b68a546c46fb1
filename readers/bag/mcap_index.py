"""What lies where in an MCAP file: from its summary, else by a walk over its records."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import BinaryIO

from mcap.records import Channel, ChunkIndex, Footer, Schema, Statistics

from vlmm_log.readers.bag.chunked import ChunkError, read_at, times_of
from vlmm_log.readers.bag.mcap_records import (
    HEAD,
    MAGIC,
    Content,
    contents,
    indexed_times,
    messages,
    parsed,
    uncompressed,
)
from vlmm_log.readers.stamps import LATEST_NS
from vlmm_log.types import Int64, Skipped

FOOTER_BYTES = HEAD.size + 20
BARE_BYTES = 4 << 20  # messages outside chunks are read in pieces of about this size


@dataclass(frozen=True, eq=False)
class ChunkPlace:
    """A chunk record, or a piece of file with messages outside chunks."""

    at: int  # byte of its first record's opcode
    stop: int
    index: tuple[int, int] | None  # bytes of its message index records
    times: dict[int, Int64] | None = None  # log times by channel where they are known already
    span: tuple[int, int] = (0, LATEST_NS)  # log times of its first and last message


@dataclass(eq=False)
class McapIndex:
    """All that is known of a file before its messages are read."""

    chunks: list[ChunkPlace] = field(default_factory=list)
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    statistics: Statistics | None = None
    losses: list[Skipped] = field(default_factory=list)

    def learn(self, opcode: int, content: bytes | memoryview) -> None:
        """Take in a schema or channel record, wherever it stands. Raises ChunkError."""
        if opcode == 0x03:
            schema = parsed(Schema, content)
            self.schemas.setdefault(schema.id, schema)
        elif opcode == 0x04:
            channel = parsed(Channel, content)
            self.channels.setdefault(channel.id, channel)


def from_summary(file: BinaryIO, size: int) -> McapIndex | None:
    """By the file's end; None where there is no summary, it is damaged, or it does not list the chunks."""
    try:
        end = read_at(file, size - FOOTER_BYTES - len(MAGIC), FOOTER_BYTES + len(MAGIC))
        if not end.endswith(MAGIC) or HEAD.unpack_from(end) != (0x02, 20):
            return None
        footer = parsed(Footer, end[HEAD.size :])
        start, stop = footer.summary_start, size - FOOTER_BYTES - len(MAGIC)
        if not 0 < start <= stop:
            return None
        summary = read_at(file, start, stop - start)
        checked = summary + end[: FOOTER_BYTES - 4]
        if footer.summary_crc and zlib.crc32(checked) != footer.summary_crc:
            return None
        return _summarised(memoryview(summary), start)
    except ChunkError:
        return None


def _summarised(summary: memoryview, data_stop: int) -> McapIndex | None:
    index = McapIndex()
    for opcode, start, stop in contents(summary):
        content = summary[start:stop]
        if opcode == 0x08:
            index.chunks.append(_place(parsed(ChunkIndex, content)))
        elif opcode == 0x0B:
            index.statistics = parsed(Statistics, content)
        else:
            index.learn(opcode, content)
    index.chunks.sort(key=lambda c: c.at)
    told = index.statistics
    complete = told is not None and (told.message_count == 0 or bool(index.chunks and told.channel_message_counts))
    listed = told is not None and told.channel_message_counts.keys() <= index.channels.keys()
    inside = all(len(MAGIC) <= c.at < c.stop <= data_stop for c in index.chunks)
    return index if complete and listed and inside else None


def _place(c: ChunkIndex) -> ChunkPlace:
    stop = c.chunk_start_offset + c.chunk_length
    index = (stop, stop + c.message_index_length) if c.message_index_length else None
    times: dict[int, Int64] | None = None
    if index is None and c.message_start_time == c.message_end_time == 0:
        times = {}  # schemas and channels only
    return ChunkPlace(c.chunk_start_offset, stop, index, times, (c.message_start_time, c.message_end_time))


def from_walk(file: BinaryIO, size: int) -> McapIndex:
    """By all records in turn, up to where the file is cut off or damaged; chunks with an index stay closed."""
    index = McapIndex()
    pieces: list[ChunkPlace] = []
    at, ended = len(MAGIC), False
    for opcode, start, stop in top_records(file, size):
        at, first = stop, start - HEAD.size
        last = pieces[-1] if pieces else None
        match opcode:
            case 0x06:
                pieces.append(ChunkPlace(first, stop, (stop, stop)))
            case 0x07 if last and last.index:
                pieces[-1] = replace(last, index=(last.stop, stop))
            case 0x05 if last and not last.index and last.stop == first and stop - last.at < BARE_BYTES:
                pieces[-1] = replace(last, stop=stop)
            case 0x05:
                pieces.append(ChunkPlace(first, stop, None))
            case 0x03 | 0x04:
                with suppress(ChunkError):  # its messages are told as lost
                    index.learn(opcode, read_at(file, start, stop - start))
            case 0x0F | 0x02:  # data end, footer
                ended = True
                break
    if pieces and not ended and pieces[-1].index:  # of its index records, the last may be among what is lost
        pieces[-1] = replace(pieces[-1], index=(pieces[-1].stop, pieces[-1].stop))
    index.chunks = [_explored(file, piece, index) for piece in pieces]
    latest = max((c.span[1] for c in index.chunks if c.times), default=0)
    if not ended:
        index.losses.append(Skipped(latest, f"{size - at} bytes at the end", "file is cut off or damaged"))
    elif read_at(file, size - len(MAGIC), len(MAGIC)) != MAGIC:
        index.losses.append(Skipped(latest, "summary", "file is cut off or damaged"))
    return index


def top_records(file: BinaryIO, size: int) -> Iterator[Content]:
    """The records of a file that lie in no chunk, and the chunks, up to where it is cut off or damaged."""
    at = len(MAGIC)
    while at + HEAD.size <= size:
        opcode, length = HEAD.unpack(read_at(file, at, HEAD.size))
        start, at = at + HEAD.size, at + HEAD.size + length
        if at > size or opcode == 0:
            return
        yield Content(opcode, start, at)


def _explored(file: BinaryIO, piece: ChunkPlace, index: McapIndex) -> ChunkPlace:
    """A chunk with its log times; without them where it is damaged. Opened only if its index leaves a question."""
    try:
        times = indexed_times(file, piece.index) if piece.index else {}
        if not times or not times.keys() <= index.channels.keys():
            data = chunk_data(file, piece)
            for opcode, start, stop in contents(data):
                if opcode in (0x03, 0x04):
                    index.learn(opcode, data[start:stop])
            times = times or times_of(list(messages(data)))
    except ChunkError:
        return replace(piece, index=None, times=None, span=_told_span(file, piece))
    ends = [(int(own.min()), int(own.max())) for own in times.values() if own.size]
    span = (min(e[0] for e in ends), max(e[1] for e in ends)) if ends else (0, 0)
    return replace(piece, times=dict(times), span=span)


def chunk_data(file: BinaryIO, place: ChunkPlace) -> memoryview:
    """The records of a chunk, uncompressed and checked; of a piece without chunks, as they are. Raises ChunkError."""
    data = read_at(file, place.at, place.stop - place.at)
    if data[:1] != b"\x06":
        return memoryview(data)
    if HEAD.unpack_from(data) != (0x06, len(data) - HEAD.size):
        raise ChunkError("chunk is damaged")
    return uncompressed(data[HEAD.size :])


def _told_span(file: BinaryIO, piece: ChunkPlace) -> tuple[int, int]:
    """Log times that a damaged chunk's own head gives, if they make sense; else all of time."""
    try:
        first, last = struct.unpack("<qq", read_at(file, piece.at + HEAD.size, 16))
    except ChunkError:
        first, last = 0, -1
    return (first, last) if 0 <= first <= last else (0, LATEST_NS)
