"""From records of a file to messages of topics."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial

from vlmm_log.readers.bag.containers import Message, Topic
from vlmm_log.readers.bag.decompression import decompressed_message
from vlmm_log.readers.bag.schemas import Decoder, Schema, decoder, type_name
from vlmm_log.types import Skipped

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"  # no CDR message begins so


@dataclass(frozen=True, eq=False)
class Channel:
    """One publisher's connection: what its messages belong to, and how to read them."""

    topic: Topic
    decode: Decoder


def channel(name: str, type_: str, encoding: str, language: str, definition: bytes) -> Channel:
    """A channel of a topic whose messages have not been counted."""
    known = type_name(type_, encoding, language)
    return Channel(Topic(name, known, None, encoding), decoder(Schema(known, encoding, language, definition)))


def counted(channels: Mapping[int, Channel], counts: Mapping[int, int] | None) -> dict[int, Channel]:
    """The channels with those of equal name, type and encoding made one topic, its messages counted."""
    totals: dict[Topic, int] = {}
    for key, c in channels.items():
        totals[c.topic] = totals.get(c.topic, 0) + (counts.get(key, 0) if counts is not None else 0)
    topics = {t: replace(t, count=n if counts is not None else None) for t, n in totals.items()}
    return {key: replace(c, topic=topics[c.topic]) for key, c in channels.items()}


def topics_of(channels: Iterable[Channel]) -> tuple[Topic, ...]:
    """Each topic once, by name and type."""
    return tuple(sorted({c.topic for c in channels}, key=lambda t: (t.name, t.type, t.encoding)))


def message(of: Channel, log_ns: int, ordinal: int, raw: bytes) -> Message | Skipped:
    """The message of a record; ROS 2 may have compressed it."""
    if of.topic.encoding == "cdr" and raw.startswith(ZSTD_MAGIC):
        try:
            raw = decompressed_message(raw)
        except ValueError:
            return Skipped(log_ns, f"{of.topic.name} {ordinal}", "message cannot be decompressed")
    return Message(of.topic, log_ns, ordinal, raw, partial(of.decode, raw))
