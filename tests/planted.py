"""Recordings with one thing changed, made from the chunks alone: what reads recordings has no part in it."""

from collections.abc import Callable
from typing import Any

import pyarrow as pa
from rerun.chunk import Chunk, LazyChunkStream, RrdReader


def rewritten(source, target, edit: Callable[[str, pa.RecordBatch], pa.RecordBatch | None], extra=()):
    """A copy of a recording, each chunk edited; None drops it."""
    chunks = []
    for chunk in RrdReader(str(source)).store().stream():
        batch = edit(chunk.entity_path.removeprefix("/"), chunk.to_record_batch())
        if batch is not None and batch.num_rows:
            chunks += Chunk.from_record_batch(batch)
    stream = LazyChunkStream.from_iter([*chunks, *extra])
    stream.write_rrd(str(target), application_id="vlmm-log", recording_id="planted")
    return target


def frames(batch):
    return batch.column("frame").to_pylist() if "frame" in batch.schema.names else [None] * batch.num_rows


def cell(entity, frame, component, change: Callable[[Any], Any]):
    """Change one component's value in one row: ``change`` gets it as Python has it. Frame None: in all rows."""

    def edit(name, batch):
        if name != entity or component not in batch.schema.names:
            return batch
        k = batch.schema.names.index(component)
        column, field = batch.column(k), batch.schema.field(k)
        rows = [r for r, f in enumerate(frames(batch)) if (frame is None or f == frame) and column[r].is_valid]
        for r in rows:
            changed = pa.array([change(column[r].as_py())], field.type)
            column = pa.concat_arrays([column.slice(0, r), changed, column.slice(r + 1)])
        return batch.set_column(k, field, column) if rows else batch

    return edit


def without(matches: Callable[[str, int | None], bool]):
    """Drop rows by entity and frame."""

    def edit(name, batch):
        kept = [k for k, frame in enumerate(frames(batch)) if not matches(name, frame)]
        return batch.take(pa.array(kept, pa.int64())) if len(kept) < batch.num_rows else batch

    return edit


def later(entity, frame, ns):
    """Move a row in time."""

    def edit(name, batch):
        if name != entity or "frame" not in batch.schema.names:
            return batch
        k = batch.schema.names.index("time")
        field = batch.schema.field(k)
        times = batch.column(k).cast("int64").to_pylist()
        times = [t + ns * (f == frame) for t, f in zip(times, frames(batch), strict=True)]
        return batch.set_column(k, field, pa.array(times, pa.int64()).cast(field.type))

    return edit
