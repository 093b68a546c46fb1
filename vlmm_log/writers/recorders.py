"""Containers of ROS messages, open for writing."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any, Literal, Protocol

from vlmm_log.types import InputError
from vlmm_log.writers.messages import Ros

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
Storage = Literal["sqlite3", "mcap"]


@dataclass(frozen=True)
class Publication:
    """A topic that is written."""

    topic: str
    type: str
    latched: bool = False


class Recorder(Protocol):
    """An open container. Messages are given in about the order of their times."""

    def write(self, to: Publication, stamp_ns: int, data: bytes) -> None:
        """Add a serialised message; its topic is added with its first one."""
        ...


@dataclass
class Mcap:
    """An MCAP file of ROS 2's profile."""

    writer: Any
    ros: Ros
    schemas: dict[str, int] = field(default_factory=dict)
    channels: dict[Publication, int] = field(default_factory=dict)
    counts: dict[Publication, int] = field(default_factory=dict)

    def write(self, to: Publication, stamp_ns: int, data: bytes) -> None:
        """See Recorder."""
        if to not in self.channels:
            if to.type not in self.schemas:
                definition = self.ros.definition(to.type).encode()
                self.schemas[to.type] = self.writer.register_schema(to.type, "ros2msg", definition)
            qos = {"offered_qos_profiles": _yaml([LATCHED])} if to.latched else {}
            self.channels[to] = self.writer.register_channel(to.topic, "cdr", self.schemas[to.type], qos)
        count = self.counts[to] = self.counts.get(to, -1) + 1
        self.writer.add_message(self.channels[to], stamp_ns, data, stamp_ns, count)


@dataclass
class Rosbag:
    """A writer of rosbags, for ROS 1 or ROS 2."""

    writer: Any
    ros: Ros
    connections: dict[Publication, Any] = field(default_factory=dict)

    def write(self, to: Publication, stamp_ns: int, data: bytes) -> None:
        """See Recorder."""
        if to not in self.connections:
            more = _latching(self.ros) if to.latched else {}
            self.connections[to] = self.writer.add_connection(to.topic, to.type, typestore=self.ros.store, **more)
        self.writer.write(self.connections[to], stamp_ns, data)


@contextmanager
def mcap_file(path: Path, ros: Ros, compression: Literal["LZ4", "NONE"], about: Mapping[str, str]) -> Iterator[Mcap]:
    """An MCAP file in chunks with checksums, and ``about`` as its metadata record."""
    from mcap.writer import CompressionType, Writer

    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType[compression], enable_data_crcs=True)
        writer.start(profile="ros2", library="vlmm-log")
        writer.add_metadata("vlmm_log", dict(about))
        yield Mcap(writer, ros)
        writer.finish()  # type: ignore[no-untyped-call]


@contextmanager
def ros1_bag(path: Path, ros: Ros) -> Iterator[Rosbag]:
    """A .bag of format 2.0, uncompressed: not every ROS 1 reads the LZ4 of other writers."""
    from rosbags.rosbag1 import Writer, WriterError

    try:
        path.unlink(missing_ok=True)
        with Writer(path) as writer:
            yield Rosbag(writer, ros)
    except WriterError as e:
        raise InputError(f"{path}: cannot be written: {e}") from e


@contextmanager
def ros2_folder(path: Path, ros: Ros, storage: Storage, about: Mapping[str, str]) -> Iterator[Rosbag]:
    """A folder of metadata.yaml and one .db3 or .mcap, both with ``about``."""
    from rosbags.rosbag2 import StoragePlugin, Writer, WriterError

    writer = Writer(path, version=9, storage_plugin=StoragePlugin[storage.upper()])
    for key, value in about.items():
        writer.set_custom_data(key, value)
    try:
        with writer:
            yield Rosbag(writer, ros)
    except (WriterError, sqlite3.Error) as e:
        raise InputError(f"{path}: cannot be written: {e}") from e


def _latching(ros: Ros) -> dict[str, Any]:
    """What add_connection takes for a latched topic."""
    if ros.version == 1:
        return {"latching": 1}
    from rosbags.rosbag2.metadata import parse_qos

    return {"offered_qos_profiles": parse_qos([LATCHED])}  # type: ignore[list-item,unused-ignore]


def _yaml(value: object) -> str:
    from ruamel.yaml import YAML

    yaml, text = YAML(typ="safe"), BytesIO()
    yaml.default_flow_style = False
    yaml.dump(value, text)
    return text.getvalue().decode().strip()
