"""Containers of ROS messages, open for writing."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, Protocol

from vlmm_log.ros.mcap import LATCHED, Publication
from vlmm_log.ros.messages import Ros

Storage = Literal["sqlite3", "mcap"]


class Recorder(Protocol):
    """An open container. Messages are given in about the order of their times."""

    def write(self, to: Publication, stamp_ns: int, data: bytes) -> None:
        """Add a serialised message; its topic is added with its first one."""
        ...


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
def ros1_bag(path: Path, ros: Ros) -> Iterator[Rosbag]:
    """A .bag of format 2.0, uncompressed: not every ROS 1 reads the LZ4 of other writers. Raises OSError."""
    from rosbags.rosbag1 import Writer, WriterError

    try:
        path.unlink(missing_ok=True)
        with Writer(path) as writer:
            yield Rosbag(writer, ros)
    except WriterError as e:
        raise OSError(f"{e}") from e


@contextmanager
def ros2_folder(path: Path, ros: Ros, storage: Storage, about: Mapping[str, str]) -> Iterator[Rosbag]:
    """A folder of metadata.yaml and one .db3 or .mcap, both with ``about``. Raises OSError."""
    from rosbags.rosbag2 import StoragePlugin, Writer, WriterError

    writer = Writer(path, version=9, storage_plugin=StoragePlugin[storage.upper()])
    for key, value in about.items():
        writer.set_custom_data(key, value)
    try:
        with writer:
            yield Rosbag(writer, ros)
    except (WriterError, sqlite3.Error) as e:
        raise OSError(f"{e}") from e


def _latching(ros: Ros) -> dict[str, Any]:
    """What add_connection takes for a latched topic."""
    if ros.version == 1:
        return {"latching": 1}
    from rosbags.rosbag2.metadata import parse_qos

    return {"offered_qos_profiles": parse_qos([LATCHED])}  # type: ignore[list-item,unused-ignore]
