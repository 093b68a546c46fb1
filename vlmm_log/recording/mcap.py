"""Recordings in MCAP, read from front to back: what a killed writer left is read as far as it goes."""

from __future__ import annotations

import json
import os
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, NamedTuple

from mcap.records import Channel, Metadata, Schema

from vlmm_log.entries import Entry
from vlmm_log.readers.bag.chunked import ChunkError, Record
from vlmm_log.readers.bag.containers import MessageError
from vlmm_log.readers.bag.mcap_index import top_records
from vlmm_log.readers.bag.mcap_records import MAGIC, contents, messages, parsed, read_at, uncompressed
from vlmm_log.readers.bag.schemas import Decoder, decoder, type_name
from vlmm_log.readers.bag.schemas import Schema as Described
from vlmm_log.recording.mcap_values import Parts, value
from vlmm_log.settings import Settings
from vlmm_log.types import InputError, Run, RunEnd

RUN, END = "vlmm_log", "vlmm_log_end"  # metadata records
VIEW = "-"


class _Topic(NamedTuple):
    """What a channel holds."""

    entity: str
    value: str  # its kind
    part: str
    still: bool
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

    def entries(self, entities: Collection[str]) -> Iterator[Entry]:
        """See Recording."""
        wanted = {key: t for key, t in self.topics.items() if t.entity in entities and t.part != VIEW}
        parts: dict[tuple[str, int], Parts] = {}  # a value of several messages, as far as it was read
        needed = {t.entity: {x.part for x in wanted.values() if x.entity == t.entity} for t in wanted.values()}
        with self.path.open("rb") as file:
            for record in (r for data in _chunks(file, self.lost) for r in messages(data)):
                topic = wanted.get(record.channel)
                if topic is None:
                    continue
                try:
                    message = topic.decode(bytes(record.data))
                except MessageError as e:
                    _tell(self.lost, f"{topic.entity} at {record.log_ns} ns: {e}")
                    continue
                key = (topic.entity, record.log_ns)
                gathered = parts.setdefault(key, {})
                gathered[topic.part] = message
                if gathered.keys() >= needed[topic.entity]:
                    yield from self._read(topic, parts.pop(key), record)
        for entity, stamp_ns in parts:
            _tell(self.lost, f"{entity} at {stamp_ns} ns: has lost a part")

    def _read(self, topic: _Topic, parts: Parts, at: Record) -> Iterator[Entry]:
        try:
            read = value(topic.value, parts)
        except (ValueError, LookupError, AttributeError, TypeError) as e:
            _tell(self.lost, f"{topic.entity} at {at.log_ns} ns: cannot be read: {e}")
            return
        still = topic.still
        yield Entry(topic.entity, read, None if still else at.log_ns, at.sequence - 1 if at.sequence else None)


def open_mcap(path: Path) -> McapRecording:
    """A recording of ``process``, also one that was cut off. Raises InputError where the file is none."""
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    told: dict[str, dict[str, str]] = {}
    lost: list[str] = []
    try:
        with path.open("rb") as file:
            if file.read(len(MAGIC)) != MAGIC:
                raise InputError(f"{path}: is no MCAP file, its first bytes are others")
            for opcode, content in _descriptions(file):
                if opcode == 0x03:
                    schema = parsed(Schema, content)
                    schemas[schema.id] = schema
                elif opcode == 0x04:
                    channel = parsed(Channel, content)
                    channels[channel.id] = channel
                else:
                    record = parsed(Metadata, content)
                    told[record.name] = record.metadata
    except (OSError, ChunkError) as e:
        raise InputError(f"{path}: cannot be read: {e}") from e
    if RUN not in told or not any("entity" in c.metadata for c in channels.values()):
        raise InputError(f"{path}: not a recording of vlmm-log process: it holds no settings or no entities")
    topics = {key: _topic(c, schemas[c.schema_id]) for key, c in channels.items() if "entity" in c.metadata}
    end = _end(told[END]) if END in told else None
    if end is None:
        lost.insert(0, "its writer did not finish")
    return McapRecording(path, _run(path, told[RUN]), end, topics, lost)


def _topic(channel: Channel, schema: Schema) -> _Topic:
    known = type_name(schema.name, channel.message_encoding, schema.encoding)
    decode = decoder(Described(known, channel.message_encoding, schema.encoding, schema.data))
    about = channel.metadata
    return _Topic(about["entity"], about["value"], about["part"], "offered_qos_profiles" in about, decode)


def _descriptions(file: BinaryIO) -> Iterator[tuple[int, bytes | memoryview]]:
    """Opcode and content of all schemas, channels and metadata; of a file without a summary, also those in chunks."""
    size, summarised = os.fstat(file.fileno()).st_size, False
    for opcode, start, stop in top_records(file, size):
        summarised |= opcode == 0x0F
        if opcode in (0x03, 0x04, 0x0C):
            yield opcode, read_at(file, start, stop - start)
    if not summarised:
        for data in _chunks(file, []):
            yield from ((opcode, data[a:b]) for opcode, a, b in contents(data) if opcode in (0x03, 0x04))


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
        elif opcode == 0x0F:
            return


def _tell(lost: list[str], text: str) -> None:
    if text not in lost:
        lost.append(text)


def _run(path: Path, about: dict[str, str]) -> Run:
    try:
        Settings.from_toml(about["settings"], str(path))
        return Run(
            about["source"],
            about["reader"],
            about["settings"],
            json.loads(about["versions"]),
            bool(json.loads(about["has_poses"])),
            about["world_up"],
            tuple(json.loads(about["notes"])),
        )
    except (KeyError, ValueError, TypeError) as e:
        raise InputError(f"{path}: its metadata are not those of this version: {e}; process the log again") from e


def _end(about: dict[str, str]) -> RunEnd:
    told = {name: json.loads(text) for name, text in about.items()}
    return RunEnd(told["complete"], told["input_hash"], told["frames"], told["pairs"])
