"""The sqlite3 storage of ROS 2 bags: one .db3 file."""

from __future__ import annotations

import re
import sqlite3
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from vlmm_log.readers.bag.channels import Channel, channel, counted, message, topics_of
from vlmm_log.readers.bag.containers import Message, Topic
from vlmm_log.readers.bag.sqlite_rows import Database, Rows, database, rows_of
from vlmm_log.types import InputError, Int64, Skipped


def open_sqlite(path: Path) -> SqliteBag:
    """A .db3 file, also one that is cut off, as far as it can be read. Raises InputError."""
    found = database(path)
    try:
        channels = _channels(found.db)
        rows = rows_of(found.db)
    except (sqlite3.Error, UnicodeDecodeError) as e:
        found.db.close()
        found.scratch.cleanup()
        raise InputError(f"{path}: is no ROS 2 bag that can be read ({e}); try 'sqlite3 {path.name} .recover'") from e
    keys, numbers = np.unique(rows.topics, return_counts=True)
    counts = {int(key): int(n) for key, n in zip(keys, numbers, strict=True)}
    unknown = {key: n for key, n in counts.items() if key not in channels}
    lost = [Skipped(0, f"{n} messages of topic {key}", "topic is not described") for key, n in unknown.items()]
    start_ns = int(rows.times[0]) if rows.times.size else 0
    stop_ns = int(rows.times[-1]) + 1 if rows.times.size else 0
    losses = [*found.losses, *rows.losses, *lost]
    kind = "ROS 2 bag (sqlite3)"
    return SqliteBag(path, kind, found, counted(channels, counts), rows, start_ns, stop_ns, tuple(losses))


def _channels(db: sqlite3.Connection) -> dict[int, Channel]:
    """Topics by their id, with the definitions that newer bags hold."""
    listed = db.execute("SELECT name, CAST(sql AS TEXT) FROM sqlite_master WHERE type = 'table'")
    tables = {name for name, sql in listed if _is_plain(sql)}
    if not {"topics", "messages"} <= tables:
        raise sqlite3.DatabaseError("it has no tables 'topics' and 'messages'")
    definitions: dict[str, tuple[str, bytes]] = {}
    if "message_definitions" in tables:
        columns = _texts("topic_type", "encoding", "encoded_message_definition")
        for name, language, text in db.execute(f"SELECT {columns} FROM message_definitions ORDER BY id"):  # noqa: S608
            definitions.setdefault(name, (language, text.encode()))
    found = {}
    columns = _texts("name", "type", "serialization_format")
    for key, name, type_, encoding in db.execute(f"SELECT id, {columns} FROM topics WHERE typeof(id) = 'integer'"):  # noqa: S608
        found[key] = channel(name, type_, encoding, *definitions.get(type_, ("", b"")))
    return found


def _is_plain(sql: str | None) -> bool:
    """Whether a table only holds values: views and generated columns could compute for ever, or gigabytes."""
    return bool(sql) and str(sql).startswith("CREATE TABLE") and not re.search(r"\bAS\b", str(sql), re.IGNORECASE)


def _texts(*columns: str) -> str:
    """Columns as texts, whatever a damaged file holds in them."""
    return ", ".join(f"ifnull(CAST({name} AS TEXT), '')" for name in columns)


@dataclass(eq=False)
class SqliteBag:
    """See containers.Container. In memory: id, topic and log time of every message, and one payload."""

    path: Path
    kind: str
    found: Database
    channels: Mapping[int, Channel]
    rows: Rows
    start_ns: int
    stop_ns: int
    losses: tuple[Skipped, ...]

    @property
    def topics(self) -> tuple[Topic, ...]:
        """See containers.Container."""
        return topics_of(self.channels.values())

    @cached_property
    def _ordinals(self) -> Int64:
        """(n,) of each row, among those of its topic's name."""
        ordinals = np.full(len(self.rows.times), -1, np.int64)
        for name in {c.topic.name for c in self.channels.values()}:
            own = self._of(frozenset((name,)))
            ordinals[own] = np.arange(len(own))
        return ordinals

    def _of(self, names: frozenset[str]) -> Int64:
        """Rows of topics, in order."""
        keys = [key for key, c in self.channels.items() if c.topic.name in names]
        return np.flatnonzero(np.isin(self.rows.topics, keys)).astype(np.int64)

    def messages(self, topics: Collection[str], start_ns: int, stop_ns: int) -> Iterator[Message | Skipped]:
        """See containers.Container."""
        low, high = np.searchsorted(self.rows.times, [start_ns, stop_ns])
        own = self._of(frozenset(topics))
        for k in own[(own >= low) & (own < high)]:
            of, log_ns = self.channels[int(self.rows.topics[k])], int(self.rows.times[k])
            raw = self._payload(int(self.rows.ids[k]))
            if raw is None:
                yield Skipped(log_ns, f"{of.topic.name} {self._ordinals[k]}", "row cannot be read")
            else:
                yield message(of, log_ns, int(self._ordinals[k]), raw)

    def _payload(self, row: int) -> bytes | None:
        try:
            found = self.found.db.execute("SELECT data FROM messages WHERE id = ?", (row,)).fetchone()
        except sqlite3.DatabaseError:
            return None
        return found[0] if found and isinstance(found[0], bytes) else None

    def log_times(self, topic: str) -> Int64:
        """See containers.Container."""
        return self.rows.times[self._of(frozenset((topic,)))]

    all_times = log_times

    def close(self) -> None:
        """See containers.Container."""
        self.found.db.close()
        self.found.scratch.cleanup()
