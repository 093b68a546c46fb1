"""Files made of chunks, read chunk by chunk through their index: the stream that MCAP and ROS 1 bags share."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any, BinaryIO, Generic, NamedTuple, Protocol, TypeVar

import numpy as np

from vlmm_log.readers.bag.channels import Channel, message, topics_of
from vlmm_log.readers.bag.containers import Message, Topic
from vlmm_log.readers.bag.runs import Run, merged, ranked
from vlmm_log.types import Int64, Skipped


class ChunkError(Exception):
    """Why a chunk cannot be used, in a few words that can be counted."""


def read_at(file: BinaryIO, start: int, size: int) -> bytes:
    """Bytes of a file. Raises ChunkError where it is shorter: nothing is reserved for what is not there."""
    try:
        if start + size > os.fstat(file.fileno()).st_size:
            raise ChunkError("file is cut off")
        file.seek(start)
        data = file.read(size)
    except (OSError, ValueError, OverflowError, MemoryError) as e:
        raise ChunkError("file cannot be read") from e
    if len(data) != size:
        raise ChunkError("file is cut off")
    return data


class Record(NamedTuple):
    """A message as it stands in its chunk."""

    log_ns: int
    position: int  # byte in the chunk, unique
    channel: int
    data: memoryview
    sequence: int = 0  # as the writer counts them, where the format has it


class Place(Protocol):
    """Where a chunk lies, and what the file's index says of it."""

    @property
    def at(self) -> int:
        """Byte of the file where it begins, for people."""

    @property
    def index(self) -> tuple[int, int] | None:
        """Bytes of its own index."""

    @property
    def times(self) -> Mapping[int, Int64] | None:
        """Log times by channel where they are known already."""

    @property
    def span(self) -> tuple[int, int]:
        """Log times of the first and last message."""


P = TypeVar("P", bound=Place)


@dataclass(eq=False)
class Chunks(Generic[P]):
    """The chunks of one file, by number in the file's order."""

    file: BinaryIO
    places: Sequence[P]
    channels: Mapping[int, Channel]
    read: Callable[[BinaryIO, P], Iterator[Record]]  # a chunk's messages, verified as far as the format allows
    read_index: Callable[[BinaryIO, tuple[int, int]], Mapping[int, Int64]]  # log times by channel

    def __len__(self) -> int:
        return len(self.places)

    def times(self, k: int) -> Mapping[int, Int64]:
        """Log times of chunk k's messages by channel, from the file's index if it has one. Raises ChunkError."""
        place = self.places[k]
        if place.times is not None:
            return place.times
        if place.index is not None:
            return self.read_index(self.file, place.index)
        return times_of(list(self.records(k)))

    def records(self, k: int) -> Iterator[Record]:
        """The messages of chunk k. Raises ChunkError."""
        return self.read(self.file, self.places[k])

    def payloads_needed(self) -> bool:
        """Whether ``times`` has to read any payload."""
        return any(place.times is None and place.index is None for place in self.places)

    def close(self) -> None:
        """Let go of the file."""
        self.file.close()


@dataclass(eq=False)
class Chunked:
    """See containers.Container. Damaged chunks are skipped whole; at most those that overlap are in memory."""

    path: Path
    kind: str
    chunks: Chunks[Any]
    start_ns: int
    stop_ns: int
    losses: tuple[Skipped, ...]

    @property
    def topics(self) -> tuple[Topic, ...]:
        """See containers.Container."""
        return topics_of(self.chunks.channels.values())

    @cached_property
    def _times(self) -> list[dict[str, Int64] | str]:
        """Of each chunk: ascending log times by topic, or why there are none."""
        found: list[dict[str, Int64] | str] = []
        for k in range(len(self.chunks)):
            try:
                found.append(_by_topic(self.chunks.times(k), self.chunks.channels))
            except ChunkError as e:
                found.append(str(e))
        return found

    @cached_property
    def _ranks(self) -> dict[str, tuple[Int64, dict[int, Int64]]]:
        """By topic: all log times ascending, and the ordinals of each chunk's messages."""
        by_topic: dict[str, dict[int, Int64]] = {}
        for k, times in enumerate(self._times):
            for name, own in times.items() if isinstance(times, dict) else ():
                by_topic.setdefault(name, {})[k] = own
        ranks = {}
        for name, parts in by_topic.items():
            ascending, ordinals = ranked(list(parts.values()))
            ranks[name] = (ascending, dict(zip(parts, ordinals, strict=True)))
        return ranks

    def messages(self, topics: Collection[str], start_ns: int, stop_ns: int) -> Iterator[Message | Skipped]:
        """See containers.Container."""
        wanted = frozenset(topics)
        if start_ns <= self.start_ns:
            yield from self._unindexed(wanted)
        yield from merged(self._runs(wanted, start_ns, stop_ns))

    def _unindexed(self, wanted: frozenset[str]) -> Iterator[Skipped]:
        """Messages that the file counts and its index does not list; those of damaged chunks are told elsewhere."""
        if any(isinstance(times, str) for times in self._times):
            return
        counts: Counter[str] = Counter()
        for topic in self.topics:
            counts[topic.name] += topic.count or 0
        for name in sorted(wanted & counts.keys()):
            if (missing := counts[name] - len(self.all_times(name))) > 0:
                yield Skipped(self.start_ns, f"{missing} messages of {name}", "counted, but not in the index")

    def _runs(self, wanted: frozenset[str], start_ns: int, stop_ns: int) -> Iterator[Run]:
        for k, times in enumerate(self._times):
            if isinstance(times, str):
                place = self.chunks.places[k]
                first_ns, last_ns = place.span
                if wanted and last_ns >= start_ns and first_ns < stop_ns:
                    lost = Skipped(max(first_ns, start_ns), f"chunk at byte {place.at}", times)
                    yield Run(lost.stamp_ns, k, partial(iter, (lost,)))
                continue
            inside = {n: own[_window(own, start_ns, stop_ns)] for n, own in times.items() if n in wanted}
            inside = {n: own for n, own in inside.items() if own.size}
            if inside:
                first_ns = min(int(own[0]) for own in inside.values())
                yield Run(first_ns, k, partial(self._chunk, k, first_ns, inside, stop_ns))

    def _chunk(self, k: int, first_ns: int, inside: Mapping[str, Int64], stop_ns: int) -> Iterator[Message | Skipped]:
        """Messages of one chunk that lie in the window; ``inside`` are the log times of those, by the index."""
        channels = self.chunks.channels
        try:
            records = [r for r in self.chunks.records(k) if r.channel in channels]
        except ChunkError as e:
            yield Skipped(first_ns, _listed({n: own.size for n, own in inside.items()}), str(e))
            return
        records = sorted(r for r in records if channels[r.channel].topic.name in inside)
        times = self._times[k]
        assert isinstance(times, dict)
        found: dict[str, list[int]] = {name: [] for name in inside}
        for r in records:
            found[channels[r.channel].topic.name].append(r.log_ns)
        astray = {n: own.size for n, own in inside.items() if not np.array_equal(found[n], times[n])}
        if astray:
            yield Skipped(first_ns, _listed(astray), "chunk disagrees with its index")
        place: Counter[str] = Counter()
        for r in records:
            of = channels[r.channel]
            name = of.topic.name
            if first_ns <= r.log_ns < stop_ns and name not in astray:
                yield message(of, r.log_ns, int(self._ranks[name][1][k][place[name]]), bytes(r.data))
            place[name] += 1

    def log_times(self, topic: str) -> Int64 | None:
        """See containers.Container."""
        if "_times" not in vars(self) and self.chunks.payloads_needed():
            return None
        return self.all_times(topic)

    def all_times(self, topic: str) -> Int64:
        """Like ``log_times``, reading payloads where it must."""
        return self._ranks[topic][0].copy() if topic in self._ranks else np.empty(0, np.int64)

    def close(self) -> None:
        """See containers.Container."""
        self.chunks.close()


def _by_topic(times: Mapping[int, Int64], channels: Mapping[int, Channel]) -> dict[str, Int64]:
    parts: dict[str, list[Int64]] = {}
    for key, own in times.items():
        if key in channels and own.size:
            parts.setdefault(channels[key].topic.name, []).append(own)
    return {name: np.sort(np.concatenate(own)) for name, own in parts.items()}


def _window(times: Int64, start_ns: int, stop_ns: int) -> slice:
    low, high = np.searchsorted(times, [start_ns, stop_ns])
    return slice(int(low), int(high))


def _listed(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{n} messages of {name}" for name, n in sorted(counts.items()))


def times_of(records: Sequence[Record]) -> dict[int, Int64]:
    """Log times by channel, in the records' order."""
    by_channel: dict[int, list[int]] = {}
    for r in records:
        by_channel.setdefault(r.channel, []).append(r.log_ns)
    return {key: np.array(own, np.int64) for key, own in by_channel.items()}
