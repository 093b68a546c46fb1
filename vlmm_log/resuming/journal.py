"""What pairs showed, kept beside the output until the run is complete: a SQLite file, one row a pair."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Generator, Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from types import TracebackType

import numpy as np

from vlmm_log.protocols import Make
from vlmm_log.resuming.packing import pack, unpack
from vlmm_log.sinks.digest import digest
from vlmm_log.types import FramePair, InputError, Run, Skipped
from vlmm_log.workers.worker import Looked, Looks

VERSION = 2
OURS = int.from_bytes(b"VLMJ")  # SQLite's application id
ALONE = """
PRAGMA locking_mode = EXCLUSIVE;
PRAGMA synchronous = OFF;
BEGIN EXCLUSIVE;
COMMIT;
"""  # a killed process loses nothing that was committed; a machine without power may, and the digests tell
TABLES = f"""
BEGIN;
PRAGMA application_id = {OURS};
CREATE TABLE run (told TEXT NOT NULL, placing TEXT);
CREATE TABLE pairs (turn INTEGER PRIMARY KEY, pair TEXT NOT NULL, xxh3 TEXT NOT NULL, looked BLOB);
COMMIT;
"""


def journal_of(output: Path) -> Path:
    """Where a run keeps what its pairs showed."""
    return output.with_name(output.name + ".journal")


def placed(journal: Path) -> frozenset[Path]:
    """Outputs that a run had begun to put in place when it was killed: what lies there is its own."""
    if not journal.is_file():
        return frozenset()
    try:
        with closing(sqlite3.connect(f"{journal.absolute().as_uri()}?mode=ro", timeout=0, uri=True)) as rows:
            names = json.loads(rows.execute("SELECT placing FROM run").fetchone()[0])
        return frozenset(Path(name) for name in names)
    except (sqlite3.Error, ValueError, TypeError):  # what is wrong with it is told when it is opened
        return frozenset()


class Journal:
    """The pairs of an earlier run of the same kind, and of this one. Raises InputError where it is of another kind."""

    def __init__(self, path: Path, run: Run, outputs: Sequence[Path], *, recorded: bool) -> None:
        self._path = path
        self._outputs = [str(output.resolve()) for output in outputs]
        self.taken = 0  # pairs of an earlier run
        self._open = True
        told = {"version": VERSION, "source": run.source, "settings": run.settings, "libraries": run.versions}
        told["what is recorded"] = recorded
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            new = not path.exists()
            self._rows = sqlite3.connect(path, isolation_level=None)
            try:
                self._rows.executescript(ALONE)
                self._begin()
                self._check(told)
            except BaseException:
                self._rows.close()
                if new:
                    path.unlink(missing_ok=True)
                raise
        except (sqlite3.Error, OSError, ValueError) as e:
            remedy = "is another run at it? else remove it" if "locked" in str(e) else "remove it to start anew"
            raise InputError(f"{path}: cannot be used ({e}); {remedy}") from e

    def __enter__(self) -> Journal:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if self._open and not self._count():
                self.remove()
        except (sqlite3.Error, OSError, InputError):
            if error is None:  # else that one is told
                raise
        finally:
            self._rows.close()

    def looks(
        self, others: Looks, stream: Iterator[FramePair | Skipped], make: Make
    ) -> Generator[tuple[FramePair, Looked] | Skipped]:
        """What is known of the first pairs of a stream, and what ``others`` see of the rest, which is kept.

        Once it ends, the outputs are about to be put in place, which is kept too. Raises InputError where the stream
        is not the one of which pairs are known, or the disk takes no more.
        """
        for item in self._recalled(stream):
            self.taken += not isinstance(item, Skipped)
            yield item
        turn = self.taken
        for of_pair in others(stream, make):
            if not isinstance(of_pair, Skipped):
                self._keep(turn, *of_pair)
                turn += 1
            yield of_pair
        with self._disk():
            self._rows.execute("UPDATE run SET placing = ?", (json.dumps(self._outputs),))

    def check(self, stream: Iterator[FramePair | Skipped]) -> None:
        """Read the first pairs of a stream. Raises InputError where it is not the one of which pairs are known."""
        for _ in self._recalled(stream):
            pass

    def remove(self) -> None:
        """Nothing is left to go on with."""
        self._open = False
        self._rows.close()
        for path in (self._path.with_name(f"{self._path.name}-journal"), self._path):  # SQLite's own of a killed run
            path.unlink(missing_ok=True)

    def _recalled(self, stream: Iterator[FramePair | Skipped]) -> Iterator[tuple[FramePair, Looked] | Skipped]:
        for pair, looked in self._known():
            item = next(stream, None)
            while isinstance(item, Skipped):
                yield item
                item = next(stream, None)
            if item is None or _of_pair(item) != pair:
                where = "it ends before" if item is None else f"other images or poses from frame {item.first.index} on"
                raise InputError(f"{self._path}: of another log ({where}); remove it to start anew")
            yield item, looked

    def _known(self) -> Iterator[tuple[str, Looked]]:
        """Digest of each pair, and what it showed; up to what is damaged, which is looked at again."""
        for turn in range(self._count()):
            with self._disk():
                row = self._rows.execute("SELECT pair, xxh3, looked FROM pairs WHERE turn = ?", (turn,)).fetchone()
            if row is None or not isinstance(row[2], bytes) or _of_bytes(row[2]) != row[1]:
                return
            try:
                looked = unpack(row[2])
            except ValueError:  # of another version of what is packed
                return
            yield row[0], looked

    def _keep(self, turn: int, pair: FramePair, looked: Looked) -> None:
        data = pack(looked)
        with self._disk():
            row = (turn, _of_pair(pair), _of_bytes(data), data)
            self._rows.execute("INSERT OR REPLACE INTO pairs VALUES (?, ?, ?, ?)", row)

    def _count(self) -> int:
        with self._disk():
            return int(self._rows.execute("SELECT count(*) FROM pairs").fetchone()[0])

    def _begin(self) -> None:
        """Make the tables of a new file. Raises InputError for a database of somebody else's, which stays as it is."""
        tables = self._rows.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]
        if not tables:
            self._rows.executescript(TABLES)
        elif self._rows.execute("PRAGMA application_id").fetchone()[0] != OURS:
            raise InputError(f"{self._path}: a database, but of no run; name another output, or move it")

    def _check(self, told: dict[str, object]) -> None:
        row = self._rows.execute("SELECT told FROM run").fetchone()
        if row is None:
            self._rows.execute("INSERT INTO run (told) VALUES (?)", (json.dumps(told),))
            return
        before = json.loads(row[0])
        for name, value in told.items():
            if not isinstance(before, dict) or before.get(name) != value:
                raise InputError(f"{self._path}: kept by a run with another {name}; repeat that, or remove the file")

    @contextmanager
    def _disk(self) -> Iterator[None]:
        try:
            yield
        except sqlite3.Error as e:
            raise InputError(f"{self._path}: cannot be used ({e}); is the disk full? else remove it") from e


def _of_pair(pair: FramePair) -> str:
    return f"{digest(pair):016x}"


def _of_bytes(data: bytes) -> str:
    return f"{digest(np.frombuffer(data, np.uint8)):016x}"
