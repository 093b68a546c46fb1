"""Recordings in MCAP, read from front to back: what a killed writer left is read as far as it goes."""

from __future__ import annotations

import json
import os
from collections.abc import Collection, Container, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from mcap.records import Channel, Metadata, Schema

from vlmm_log.entries import Entry
from vlmm_log.readers.bag.chunked import ChunkError, Record, read_at
from vlmm_log.readers.bag.containers import MessageError
from vlmm_log.readers.bag.mcap_index import McapIndex, from_summary, top_records
from vlmm_log.readers.bag.mcap_records import MAGIC, contents, messages, parsed, uncompressed
from vlmm_log.readers.bag.schemas import Decoder, decoder, type_name
from vlmm_log.readers.bag.schemas import Schema as Described
from vlmm_log.recording.mcap_values import Parts, parts_with, value
from vlmm_log.recording.properties import end_of, run_of
from vlmm_log.types import InputError, Run, RunEnd

RUN, END = "vlmm_log", "vlmm_log_end"  # metadata records
VIEW = "-"


class _Topic(NamedTuple):
    """What a channel holds."""

    entity: str
    value: str  # its kind
    part: str
    still: bool
    schema: Described
    decode: Decoder


@dataclass
class McapRecording:
    """See Recording."""

    path: Path
    run: Run
    end: RunEnd | None
    topics: dict[int, _Topic]
    lost: list[str] = field(default_factory=list)
    by_entity: bool = False
    looks: bool = False

    @property
    def file(self) -> Path:
        """See Recording."""
        return self.path

    @property
    def entities(self) -> frozenset[str]:
        """See Recording."""
        return frozenset(topic.entity for topic in self.topics.values())

    @property
    def losses(self) -> tuple[str, ...]:
        """See Recording."""
        return tuple(self.lost)

    def entries(self, entities: Collection[str], frames: Container[int] | None = None) -> Iterator[Entry]:
        """See Recording."""
        wanted = {key: t for key, t in self.topics.items() if t.entity in entities and t.part != VIEW}
        parts: dict[tuple[str, int], Parts] = {}  # a value of several messages, as far as it was read
        with self.path.open("rb") as file:
            for record in (r for data in _chunks(file, self.lost) for r in messages(data)):
                topic = wanted.get(record.channel)
                if topic is None or (frames is not None and record.sequence and record.sequence - 1 not in frames):
                    continue
                try:
                    message = topic.decode(bytes(record.data))
                except MessageError as e:
                    _tell(self.lost, f"{topic.entity} at {record.log_ns} ns: {e}")
                    continue
                key = (topic.entity, record.log_ns)
                gathered = parts.setdefault(key, {})
                gathered[topic.part] = message
                if gathered.keys() >= set(parts_with(topic.part)):
                    yield from self._read(topic, parts.pop(key), record)
        for entity, stamp_ns in parts:
            _tell(self.lost, f"{entity} at {stamp_ns} ns: has lost a part")

    def _read(self, topic: _Topic, parts: Parts, at: Record) -> Iterator[Entry]:
        try:
            read = value(topic.value, topic.schema, parts)
        except (ValueError, LookupError, AttributeError, TypeError) as e:
            _tell(self.lost, f"{topic.entity} at {at.log_ns} ns: cannot be read: {e}")
            return
        still = topic.still
        yield Entry(topic.entity, read, None if still else at.log_ns, at.sequence - 1 if at.sequence else None)


def open_mcap(path: Path) -> McapRecording:
    """A recording of ``process``, also one that was cut off. Raises InputError where the file is none."""
    try:
        with path.open("rb") as file:
            if file.read(len(MAGIC)) != MAGIC:
                raise InputError(f"{path}: is no MCAP file, its first bytes are others")
            index, told, whole = _explored(file)
    except (OSError, ChunkError) as e:
        raise InputError(f"{path}: cannot be read: {e}") from e
    channels = {key: c for key, c in index.channels.items() if "entity" in c.metadata and c.schema_id in index.schemas}
    if RUN not in told or not channels:
        raise InputError(f"{path}: not a recording of vlmm-log process: it holds no settings or no entities")
    topics = {key: _topic(channel, index.schemas[channel.schema_id]) for key, channel in channels.items()}
    end = end_of(path, _of_json(path, told[END], told[END])) if END in told else None
    lost = ["its writer did not finish"] if end is None else [] if whole else ["it is cut off or damaged"]
    return McapRecording(path, run_of(path, _of_json(path, told[RUN], ["has_poses"])), end, topics, lost)


def _topic(channel: Channel, schema: Schema) -> _Topic:
    known = type_name(schema.name, channel.message_encoding, schema.encoding)
    described = Described(known, channel.message_encoding, schema.encoding, schema.data)
    about, decode = channel.metadata, decoder(described)
    return _Topic(about["entity"], about["value"], about["part"], "offered_qos_profiles" in about, described, decode)


def _explored(file: BinaryIO) -> tuple[McapIndex, dict[str, dict[str, str]], bool]:
    """Schemas and channels, metadata by name, and whether the summary is there and lists the chunks that are."""
    size = os.fstat(file.fileno()).st_size
    records = list(top_records(file, size))
    found = (parsed(Metadata, read_at(file, start, stop - start)) for opcode, start, stop in records if opcode == 0x0C)
    told = {record.name: record.metadata for record in found}
    index = from_summary(file, size)
    if index is not None:
        return index, told, len(index.chunks) == sum(opcode == 0x06 for opcode, _, _ in records)
    index = McapIndex()
    for data in _chunks(file, []):
        for opcode, start, stop in contents(data):
            index.learn(opcode, data[start:stop])
    return index, told, False


def _chunks(file: BinaryIO, lost: list[str]) -> Iterator[memoryview]:
    for opcode, start, stop in top_records(file, os.fstat(file.fileno()).st_size):
        if opcode == 0x06:
            try:
                data = uncompressed(read_at(file, start, stop - start))
                list(contents(data))
            except ChunkError as e:
                _tell(lost, f"chunk at byte {start}: {e}")
                continue
            yield data


def _tell(lost: list[str], text: str) -> None:
    if text not in lost:
        lost.append(text)


def _of_json(path: Path, about: dict[str, str], names: Collection[str]) -> dict[str, Any]:
    """The metadata with some of them read as JSON."""
    try:
        return about | {name: json.loads(about[name]) for name in names if name in about}
    except (ValueError, RecursionError) as e:
        raise InputError(f"{path}: its metadata are no JSON: {str(e)[:80]}; process the log again") from e
