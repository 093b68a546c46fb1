"""MCAP files, open for writing."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, Literal, NamedTuple

from vlmm_log.ros.messages import Ros

FOREVER = {"sec": 9223372036, "nsec": 854775807}
LATCHED = {  # quality of service as rosbag2 writes it: late subscribers get the last message too
    "history": "keep_last",
    "depth": 1,
    "reliability": "reliable",
    "durability": "transient_local",
    "deadline": FOREVER,
    "lifespan": FOREVER,
    "liveliness": "automatic",
    "liveliness_lease_duration": FOREVER,
    "avoid_ros_namespace_conventions": False,
}


class Definition(NamedTuple):
    """How messages of a type are written down, and how they are described."""

    message_encoding: str  # "cdr", "protobuf", "json"
    schema_encoding: str  # "ros2msg", "protobuf", "jsonschema"
    schema: bytes


@dataclass(frozen=True)
class Publication:
    """A topic that is written."""

    topic: str
    type: str
    latched: bool = False
    about: tuple[tuple[str, str], ...] = ()  # of the channel, in an MCAP file


@dataclass
class Mcap:
    """An MCAP file. Every channel is described with its first message."""

    writer: Any
    define: Callable[[str], Definition]
    schemas: dict[str, int] = field(default_factory=dict)
    channels: dict[Publication, int] = field(default_factory=dict)
    counts: dict[Publication, int] = field(default_factory=dict)

    def write(self, to: Publication, stamp_ns: int, data: bytes, sequence: int | None = None) -> None:
        """Add a serialised message. Without a ``sequence`` they are counted by topic."""
        if to not in self.channels:
            self.channels[to] = self._channel(to)
        if sequence is None:
            sequence = self.counts[to] = self.counts.get(to, -1) + 1
        self.writer.add_message(self.channels[to], stamp_ns, data, stamp_ns, sequence)

    def _channel(self, to: Publication) -> int:
        how, language, text = self.define(to.type)
        if to.type not in self.schemas:
            self.schemas[to.type] = self.writer.register_schema(to.type, language, text)
        qos = {"offered_qos_profiles": _yaml([LATCHED])} if to.latched else {}
        return int(self.writer.register_channel(to.topic, how, self.schemas[to.type], qos | dict(to.about)))


def ros2_definition(ros: Ros) -> Callable[[str], Definition]:
    """How ROS 2 messages are described."""
    return lambda type_name: Definition("cdr", "ros2msg", ros.definition(type_name).encode())


def open_mcap(file: BinaryIO, profile: str, compression: Literal["LZ4", "NONE"]) -> Any:
    """A writer of chunks with checksums."""
    from mcap.writer import CompressionType, Writer

    writer = Writer(file, compression=CompressionType[compression], enable_data_crcs=True)
    writer.start(profile=profile, library="vlmm-log")
    return writer


@contextmanager
def mcap_file(path: Path, ros: Ros, compression: Literal["LZ4", "NONE"], about: Mapping[str, str]) -> Iterator[Mcap]:
    """A file of ROS 2's profile, and ``about`` as its metadata record."""
    with path.open("wb") as file:
        writer = open_mcap(file, "ros2", compression)
        writer.add_metadata("vlmm_log", dict(about))
        yield Mcap(writer, ros2_definition(ros))
        writer.finish()


def _yaml(value: object) -> str:
    from ruamel.yaml import YAML

    yaml, text = YAML(typ="safe"), BytesIO()
    yaml.default_flow_style = False
    yaml.dump(value, text)
    return text.getvalue().decode().strip()
