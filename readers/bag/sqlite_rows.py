"""Opening a .db3 and listing its messages, whole or damaged."""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from vlmm_log.scratch import scratch
from vlmm_log.types import InputError, Int64, Skipped

_LIST = "SELECT id, topic_id, timestamp FROM messages WHERE id > ? ORDER BY id"
_PROBE = f"{_LIST} LIMIT 1"
OUR_FUNCTIONS = ("ifnull", "typeof")
LAST_ROW = 2**63 - 1
FARTHEST = 1 << 40  # rows; no bag has as many


@dataclass(frozen=True, eq=False)
class Database:
    """An opened file, read-only."""

    db: sqlite3.Connection
    scratch: TemporaryDirectory[str]  # of a file that is cut off within a page: its whole pages
    losses: tuple[Skipped, ...]


@dataclass(frozen=True, eq=False)
class Rows:
    """All messages in the order of log times, equal ones in the order of ids."""

    ids: Int64  # (n,)
    topics: Int64  # (n,)
    times: Int64  # (n,) ns
    losses: tuple[Skipped, ...]


def database(path: Path) -> Database:
    """The database of a file that may be cut off; one with a write-ahead log is read with it. Raises InputError."""
    folder = scratch()
    losses: list[Skipped] = []
    try:
        logged = _beside(path, "-wal")
        if _beside(path, "-journal"):
            losses.append(Skipped(0, f"{path.name}-journal", "recording ended within a transaction; read as it is"))
        db = _connected(path, "mode=ro") if logged else None
        if logged and db is None:
            losses.append(Skipped(0, f"{path.name}-wal", "write-ahead log cannot be read; its messages are lost"))
        if db is None:
            whole, lost = _whole_pages(path, folder)
            losses += lost
            db = _connected(whole, "mode=ro&immutable=1")
    except OSError as e:
        folder.cleanup()
        raise InputError(f"{path}: cannot be read: {e}") from e
    if db is None:
        folder.cleanup()
        raise InputError(f"{path}: is no SQLite database that can be read; give a .bag, .db3 or .mcap")
    return Database(db, folder, tuple(losses))


def _beside(path: Path, suffix: str) -> bool:
    """Whether a file of that name with something in it lies beside a database."""
    other = path.with_name(path.name + suffix)
    return other.is_file() and other.stat().st_size > 0


def _whole_pages(path: Path, scratch: TemporaryDirectory[str]) -> tuple[Path, tuple[Skipped, ...]]:
    """The file, or its whole pages where it is cut off within one, which SQLite would fill with zeros in silence.

    See https://sqlite.org/fileformat.html for the header.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(100)
        page = int.from_bytes(head[16:18], "big")
        page = 65536 if page == 1 else page
        missing = page * int.from_bytes(head[28:32], "big") - size
        lost = (Skipped(0, f"{missing} bytes at the end", "file is cut off or damaged"),) if missing > 0 else ()
        if page == 0 or size % page == 0:
            return path, lost
        whole = Path(scratch.name) / path.name
        file.seek(0)
        with whole.open("wb") as target:
            shutil.copyfileobj(file, target)
            target.truncate(size - size % page)
    return whole, lost


def _connected(path: Path, how: str) -> sqlite3.Connection | None:
    db = sqlite3.connect(f"{path.absolute().as_uri()}?{how}", uri=True, check_same_thread=False)
    with suppress(sqlite3.DatabaseError):
        db.execute("PRAGMA writable_schema = ON")  # without it, a file that is cut off is refused as a whole
        db.execute("SELECT count(*) FROM sqlite_master").fetchone()
        db.set_authorizer(_allowed)
        return db
    db.close()
    return None


def _allowed(action: int, _: str | None, function: str | None, *__: str | None) -> int:
    """A schema may compute: recursion without an end, functions that make gigabytes. Ours asks for none of it."""
    computes = action in (sqlite3.SQLITE_RECURSIVE, sqlite3.SQLITE_FUNCTION) and function not in OUR_FUNCTIONS
    return sqlite3.SQLITE_DENY if computes else sqlite3.SQLITE_OK


def rows_of(db: sqlite3.Connection) -> Rows:
    """All messages that can be listed; where pages are damaged, listing goes on behind them."""
    blocks: list[Int64] = []
    losses: list[Skipped] = []
    latest = -1
    while True:
        try:
            for block in _blocks(db, latest):
                blocks.append(block)
                latest = int(block[-1, 0])
            break
        except DamagedPageError as damage:
            blocks += [damage.block] if len(damage.block) else []
            latest = int(damage.block[-1, 0]) if len(damage.block) else latest
        following = _behind(db, latest)
        log_ns = int(blocks[-1][-1, 2]) if blocks else 0
        lost = f"rows after {latest}" if following is None else f"rows {latest + 1} to {following}"
        losses.append(Skipped(log_ns, lost, "rows cannot be read"))
        if following is None:
            break
        latest = following
    table = np.concatenate(blocks) if blocks else np.empty((0, 4), np.int64)
    if odd := int(table[:, 3].sum()):
        losses.append(Skipped(0, f"{odd} rows", "row holds no integers"))
        table = table[table[:, 3] == 0]
    order = np.lexsort((table[:, 0], table[:, 2]))
    return Rows(table[order, 0], table[order, 1], table[order, 2], tuple(losses))


class DamagedPageError(Exception):
    """A page cannot be read; what came before it."""

    def __init__(self, block: Int64) -> None:
        super().__init__()
        self.block = block


def _blocks(db: sqlite3.Connection, after: int) -> Iterator[Int64]:
    block: list[tuple[int, int, int, int]] = []  # the last is 1 where a damaged file holds something else
    least = after + 1
    try:
        for row in db.execute(_LIST, (after,)):
            if _number(row[0]) < least:  # a damaged tree leads back: one would go round for ever
                raise DamagedPageError(np.array(block, np.int64).reshape(-1, 4))
            least = _number(row[0])
            block.append((*row, 0) if all(type(value) is int for value in row) else (_number(row[0]), 0, 0, 1))
            if len(block) == 65536:
                yield np.array(block, np.int64)
                block = []
    except sqlite3.DatabaseError as e:
        raise DamagedPageError(np.array(block, np.int64).reshape(-1, 4)) from e
    if block:
        yield np.array(block, np.int64)


def _number(value: object) -> int:
    """An id; what is none is sorted behind all that are."""
    return value if isinstance(value, int) else LAST_ROW


def _behind(db: sqlite3.Connection, after: int) -> int | None:
    """The smallest id behind damage from which listing works again; None where nothing follows."""

    def works(row: int) -> bool:
        if row > LAST_ROW:
            return False
        try:
            found = db.execute(_PROBE, (row,)).fetchone()
            return found is not None and _number(found[0]) > row
        except sqlite3.DatabaseError:
            return False

    step = 1
    while not works(after + step):
        step *= 2
        if step > FARTHEST:
            return None
    low, high = after + step // 2, after + step  # the last that fails, the first that works
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if works(middle) else (middle, high)
    return high
