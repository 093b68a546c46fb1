"""Containers of messages: ROS 1 bags, ROS 2 bags and MCAP behind one interface."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from vlmm_log.types import InputError, Int64, Skipped


class MessageError(Exception):
    """Why a message cannot be used, in a few words that can be counted."""


@dataclass(frozen=True)
class Topic:
    """A stream of messages of one type."""

    name: str
    type: str  # "sensor_msgs/msg/Image" (the ROS 2 spelling for all ROS types), "foxglove.RawImage"
    count: int | None  # messages; None where the file's index is lost
    encoding: str  # "ros1", "cdr", "json", "protobuf"


@dataclass(frozen=True, eq=False)
class Message:
    """One message as recorded."""

    topic: Topic
    log_ns: int  # when it was recorded
    ordinal: int  # position among its topic's messages over the whole container, also when reading starts late
    raw: bytes | memoryview = field(repr=False)
    decode: Callable[[], object] = field(repr=False)  # its fields as attributes; raises MessageError


class Container(Protocol):
    """An open recording. Messages come in the order of their log times; equal times keep the file's order."""

    @property
    def path(self) -> Path:
        """The file or folder."""

    @property
    def kind(self) -> str:
        """What it is: "ROS 1 bag", "ROS 2 bag (sqlite3)", "MCAP (ros2)"."""

    @property
    def topics(self) -> tuple[Topic, ...]:
        """What was recorded, by name."""

    @property
    def start_ns(self) -> int:
        """Log time of the first message, of the whole container."""

    @property
    def stop_ns(self) -> int:
        """Log time just after the last message."""

    @property
    def losses(self) -> tuple[Skipped, ...]:
        """What was known to be missing or repaired when the container was opened."""

    def messages(self, topics: Collection[str], start_ns: int, stop_ns: int) -> Iterator[Message | Skipped]:
        """Messages of the named topics with ``start_ns`` <= log time < ``stop_ns``; what is damaged is Skipped."""

    def log_times(self, topic: str) -> Int64 | None:
        """(n,) ns, ascending, by ordinal, from the index alone; None where only the payloads would tell."""

    def close(self) -> None:
        """Let go of the files."""


def is_container(path: Path) -> bool:
    """Whether it looks like one, by names alone: a file's suffix, or what lies directly inside a folder."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file() or any(is_part(p) for p in path.iterdir())
    return path.is_file() and (path.name.lower().endswith((".bag", ".bag.active")) or is_part(path))


def is_part(path: Path) -> bool:
    """Whether a file's name is that of a part of a ROS 2 bag."""
    return path.name.lower().endswith((".db3", ".mcap", ".db3.zstd", ".mcap.zstd"))


def open_container(path: Path) -> Container:
    """The container of a file or folder, by content. Raises InputError."""
    from vlmm_log.readers.bag.parts import opener
    from vlmm_log.readers.bag.rosbag2 import open_rosbag2

    if not path.exists():
        raise InputError(f"{path}: no such file or folder")
    if path.is_dir() and not is_container(path):
        raise InputError(f"{path}: is no ROS 2 bag; its folder holds metadata.yaml and .db3 or .mcap files")
    if path.is_dir() or path.name.lower().endswith(".zstd"):
        return open_rosbag2(path)
    return opener(path)(path)
