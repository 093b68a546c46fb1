"""Rerun recordings."""

from __future__ import annotations

import os
import shutil
import warnings
import weakref
from collections.abc import Collection, Container, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pyarrow as pa
import rerun.chunk

from vlmm_log.entries import Entry, Look
from vlmm_log.recording.properties import end_of, run_of
from vlmm_log.recording.rrd_damage import STREAM_HEADER, first_damage, places
from vlmm_log.recording.rrd_values import Cells, values
from vlmm_log.scratch import scratch
from vlmm_log.types import InputError, Run, RunEnd

RUN, END = "/__properties/vlmm", "/__properties/vlmm_end"
FOOTER = b"RRF2FOOT"  # starts the last twelve bytes of a whole recording
TIMELINES, ROW_ID = ("frame", "time"), "rerun.controls.RowId"
COPY = "whole.rrd"


@dataclass
class Rrd:
    """See Recording."""

    path: Path
    run: Run
    end: RunEnd | None
    entities: frozenset[str]
    by_entity: bool
    components: dict[str, set[str]]  # of each entity, in time; {} where that is not known
    file: Path  # what is read: without a torn end
    chunks: _Chunks
    lost: list[str] = field(default_factory=list)
    looks: bool = True

    @property
    def losses(self) -> tuple[str, ...]:
        """See Recording."""
        return tuple(self.lost)

    def entries(self, entities: Collection[str], frames: Container[int] | None = None) -> Iterator[Entry]:
        """See Recording."""
        wanted = [f"/{entity}" for entity in sorted(self.entities & frozenset(entities))]
        waiting: dict[tuple[str, bytes], _Row] = {}  # a row's components may lie in several chunks of a rewritten file
        still: dict[tuple[str, object], Entry] = {}  # the last told holds for the whole recording
        for chunk in self.chunks.of(wanted):
            entity = chunk.entity_path.removeprefix("/")
            whole = self.components.get(entity, set())
            for row_id, row in _rows(self.path, chunk, frames):
                part = waiting.pop((entity, row_id), None)
                row = row if part is None else part.joined(row)
                if chunk.is_static:
                    told = self._read(entity, row)
                    still |= {
                        (entity, e.value.component if isinstance(e.value, Look) else type(e.value)): e for e in told
                    }
                elif row.cells.keys() >= whole:
                    yield from self._read(entity, row)
                else:
                    waiting[entity, row_id] = row
        for (entity, _), row in waiting.items():
            yield from self._read(entity, row)
        yield from still.values()

    def _read(self, entity: str, row: _Row) -> Iterator[Entry]:
        try:
            for value in values(row.cells):
                yield Entry(entity, value, row.stamp_ns, row.index)
        except (KeyError, ValueError, TypeError, IndexError) as e:
            self.lost.append(f"{entity} at frame {row.index}: cannot be read: {e}")


@dataclass(frozen=True)
class _Row:
    stamp_ns: int | None
    index: int | None
    cells: Cells

    def joined(self, other: _Row) -> _Row:
        return _Row(self.stamp_ns, self.index, {**self.cells, **other.cells})


def open_rrd(path: Path) -> Rrd:
    """A recording of ``process``, also one that was cut off. Raises InputError where the file is none."""
    lost, copy = _readable(path)
    file = path if copy is None else Path(copy.name) / COPY
    whole = not lost
    try:
        _check_sound(path, file)
        chunks = _Chunks(path, file, whole)
        told = _told(chunks)
        if not told[RUN]:
            raise InputError(f"{path}: not a recording of vlmm-log process: it holds no settings")
        run, end = run_of(path, told[RUN]), end_of(path, told[END]) if told[END] else None
        components = chunks.components()
    except BaseException:
        if copy is not None:
            copy.cleanup()
        raise
    entities = frozenset(name for name in components if not name.startswith("__properties"))
    recording = Rrd(path, run, end, entities, whole, components if whole else {}, file, chunks, lost)
    if copy is not None:
        weakref.finalize(recording, copy.cleanup)
    return recording


def _told(chunks: _Chunks) -> dict[str, dict[str, Any]]:
    """What the recording says of its run and its end, by name."""
    told: dict[str, dict[str, Any]] = {RUN: {}, END: {}}
    for chunk in chunks.of([RUN, END]):
        for _, row in _rows(chunks.path, chunk):
            try:
                told[chunk.entity_path].update({name: cell[0].as_py() for name, cell in row.cells.items()})
            except (ValueError, LookupError) as e:
                raise _unreadable(chunks.path, e) from e
    return told


def _check_sound(path: Path, file: Path) -> None:
    with file.open("rb") as f:
        damage = first_damage(f, os.fstat(f.fileno()).st_size)
    if damage is not None:
        raise InputError(f"{path}: its message at byte {damage} is damaged; process the log again")


class _Chunks:
    """The chunks of a file, whose footer is read once: that costs more than a small entity does."""

    def __init__(self, path: Path, file: Path, whole: bool) -> None:
        self.path, self.whole = path, whole
        try:
            with warnings.catch_warnings(action="ignore"):  # that there is no footer, we tell ourselves
                reader = rerun.chunk.RrdReader(file)
            self._source: Any = reader.store() if whole else reader
        except (OSError, ValueError, RuntimeError) as e:
            raise _unreadable(path, e) from e

    def components(self) -> dict[str, set[str]]:
        """Entity -> its components in time; of static ones alone and of a file without a footer, none."""
        if not self.whole:
            return {chunk.entity_path.removeprefix("/"): set() for chunk in self._read(None)}
        found: dict[str, set[str]] = {}
        for column in self._source.schema().component_columns():
            names = found.setdefault(column.entity_path.removeprefix("/"), set())
            if not column.is_static and not column.component.startswith("Clear:"):  # a row of its own
                names.add(column.component)
        return found

    def of(self, wanted: list[str]) -> Iterator[Any]:
        """The chunks of entities, as the file has them. Raises InputError where they cannot be read."""
        for chunk in self._read(wanted) if wanted else ():
            if chunk.entity_path not in wanted:
                told = f"its footer and its message disagree on {chunk.entity_path!r}"
                raise _unreadable(self.path, ValueError(told))
            yield chunk

    def _read(self, wanted: list[str] | None) -> Iterator[Any]:
        try:
            stream = self._source.stream()
            yield from stream if wanted is None else stream.filter(content=wanted)
        except (OSError, ValueError, RuntimeError) as e:
            raise _unreadable(self.path, e) from e


def _unreadable(path: Path, e: Exception) -> InputError:
    return InputError(f"{path}: cannot be read as a Rerun recording: {str(e)[-120:]}")


def _rows(path: Path, chunk: Any, wanted: Container[int] | None = None) -> Iterator[tuple[bytes, _Row]]:
    try:
        batch = chunk.to_record_batch()
        names = batch.schema.names
        ids = batch.column(ROW_ID).to_pylist()
        frames, times = (
            batch.column(t).cast("int64").to_pylist() if t in names else [None] * len(ids) for t in TIMELINES
        )
        others = {ROW_ID, *(f.name for f in batch.schema if (f.metadata or {}).get(b"rerun:kind") == b"index")}
        components = [(name, batch.column(name)) for name in names if name not in others]
        if not all(pa.types.is_list(column.type) for _, column in components):
            raise ValueError(f"{chunk.entity_path} holds what is no component")
    except (ValueError, LookupError, RuntimeError, pa.ArrowException) as e:
        raise _unreadable(path, e) from e
    for k, row_id in enumerate(ids):
        if wanted is not None and frames[k] is not None and frames[k] not in wanted:
            continue
        cells = {name: cell for name, column in components if (cell := column[k].values) is not None}
        yield row_id, _Row(times[k], frames[k], cells)


def _readable(path: Path) -> tuple[list[str], TemporaryDirectory[str] | None]:
    """What is missing, and a folder with a COPY without the torn last message, if it has one. Raises InputError."""
    try:
        with path.open("rb") as f:
            size = os.fstat(f.fileno()).st_size
            f.seek(max(size - len(FOOTER) - 4, 0))
            if f.read().startswith(FOOTER):
                return [], None
            stop = _last_message(f, size)
            if stop == size:
                return ["its writer did not finish"], None
            if stop <= STREAM_HEADER:
                raise InputError(f"{path}: not a Rerun recording, or cut off before its first message")
            f.seek(0)
            return [f"its writer did not finish; the last {size - stop} bytes are torn"], _copied(f, stop)
    except OSError as e:
        raise InputError(f"{path}: cannot be read: {e.strerror or e}") from e


def _copied(f: Any, stop: int) -> TemporaryDirectory[str]:
    """The first bytes of a file, in a file of their own."""
    folder = scratch()
    try:
        with (Path(folder.name) / COPY).open("wb") as copy:
            shutil.copyfileobj(f, copy)
            copy.truncate(stop)
    except OSError:
        folder.cleanup()
        raise
    return folder


def _last_message(f: Any, size: int) -> int:
    """Where the last whole message ends."""
    f.seek(0)
    if not f.read(STREAM_HEADER).startswith(b"RRF2"):
        return 0
    return max((at + length for _, at, length in places(f, size)), default=STREAM_HEADER)
