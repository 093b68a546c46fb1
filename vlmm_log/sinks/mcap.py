"""An MCAP file as a container of entries. Topics bear the entities' names; poses go to /tf, as ROS has it."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple, Protocol

from vlmm_log.entries import Entry, Raster, Steps
from vlmm_log.ros.mcap import Definition, Mcap, Publication, open_mcap
from vlmm_log.ros.messages import END_NS
from vlmm_log.rvl import decode_steps
from vlmm_log.types import InputError, Run, RunEnd

RUN, END = "vlmm_log", "vlmm_log_end"  # metadata records


class Message(NamedTuple):
    """One message of an entry."""

    topic: str
    type: str
    data: bytes
    part: str = ""  # which part of the value it holds, "u"; "-" for a view, which is not read back


class Dialect(Protocol):
    """A family of schemas."""

    profile: str  # of the file

    def define(self, type_name: str) -> Definition:
        """How a type is described."""
        ...

    def messages(self, entry: Entry, stamp_ns: int) -> Iterator[Message]:
        """The messages of an entry."""
        ...


class McapFile:
    """See recorder.Container.

    A message's log and publish time are its frame's stamp, its sequence is the frame's index plus one, 0 for what is
    of no frame. Each channel's metadata name the entity and the kind of value.
    """

    def __init__(self, path: Path, run: Run, dialect: Dialect) -> None:
        self._path, self._dialect = path, dialect
        self._file = path.open("wb")
        self._writer = open_mcap(self._file, dialect.profile, "LZ4")
        self._mcap = Mcap(self._writer, dialect.define)
        self._start_ns: int | None = None
        self._waiting: list[Entry] = []  # without a time, before the first time is known
        about = {"source": run.source, "reader": run.reader, "settings": run.settings, "world_up": run.world_up}
        lists = {"versions": run.versions, "notes": run.notes, "has_poses": run.has_poses}
        self._writer.add_metadata(RUN, about | {name: json.dumps(value) for name, value in lists.items()})
        self._writer.add_attachment(0, 0, "settings.toml", "application/toml", run.settings.encode())
        self._file.flush()

    def put(self, entry: Entry) -> None:
        """See recorder.Container. Raises InputError for a time that MCAP and ROS do not hold."""
        if entry.stamp_ns is None and self._start_ns is None:
            self._waiting.append(entry)
            return
        if self._start_ns is None:
            self._start_ns = entry.stamp_ns
            for early in self._waiting:
                self._write(early)
        self._write(entry)

    def pair_begins(self) -> None:
        """See recorder.Container."""
        self._file.flush()

    def finish(self, end: RunEnd) -> None:
        """See recorder.Container."""
        told = {"complete": end.complete, "input_hash": end.input_hash, "frames": end.frames, "pairs": end.pairs}
        with self._file:  # let go of, come what may
            self._writer.add_metadata(END, {name: json.dumps(value) for name, value in told.items()})
            self._writer.finish()

    def _write(self, entry: Entry) -> None:
        stamp_ns = self._start_ns if entry.stamp_ns is None else entry.stamp_ns
        assert stamp_ns is not None
        if not 0 <= stamp_ns < END_NS:
            raise InputError(f"{self._path}: stamp {stamp_ns} ns is beyond what MCAP of ROS holds; write --rrd alone")
        sequence = 0 if entry.index is None else entry.index + 1
        if isinstance(entry.value, Steps):  # for other tools: few read RVL, none the step
            entry = replace(entry, value=Raster(decode_steps(entry.value.image, entry.value.step)))
        kind = type(entry.value).__name__
        for message in self._dialect.messages(entry, stamp_ns):
            about = (("entity", entry.entity), ("value", kind), ("part", message.part))
            to = Publication(message.topic, message.type, entry.stamp_ns is None, about)
            self._mcap.write(to, stamp_ns, message.data, sequence)


def load_dialect(name: str) -> Dialect:
    """The schemas of a name: ros2, foxglove."""
    if name == "foxglove":
        from vlmm_log.sinks.foxglove_values import FoxgloveValues

        return FoxgloveValues()
    from vlmm_log.sinks.ros_values import Ros2Values

    return Ros2Values()


def topic_of(entity: str) -> str:
    """The topic of an entity. ROS's names do not begin with a digit."""
    return "/" + re.sub(r"(?<![^/])(?=[0-9])", "id_", entity)


def table_name(entity: str) -> str:
    """What the rows of an entity's tables are called."""
    return "Answer" if "/query/" in entity else entity.rsplit("/", 1)[-1].title().replace("_", "")
