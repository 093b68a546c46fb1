"""``summary.parquet``: a row a log, its closing figures side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from vlmm_log.batches.tasks import Outcome, State
from vlmm_log.outputs import replacing

NAME = "summary.parquet"
COUNTS = ("frames", "pairs", "unreliable_pairs", "elements", "static", "movable_static", "moving", "seen_to_move")
TEXTS = ("reader", "input_hash")


def write_summary(out: Path, outcomes: Sequence[Outcome]) -> None:
    """Write the table, failed logs too. The same table keeps the file as it is. Raises InputError."""
    table, path = summary(outcomes), out / NAME
    with pa.BufferOutputStream() as stream:
        pq.write_table(table, stream, compression="zstd")
        data = stream.getvalue().to_pybytes()
    if path.is_file() and path.read_bytes() == data:
        return
    with replacing(path, force=True) as (partial,):
        partial.write_bytes(data)


def summary(outcomes: Sequence[Outcome]) -> pa.Table:
    """Null where a log has no such figure. ``movers``: "id label" of each element that was seen to move."""
    columns: dict[str, pa.Array] = {
        "source": _texts([o.source for o in outcomes]),
        "state": _texts([State.DONE if o.state == State.SKIPPED else o.state for o in outcomes]),
        "error": _texts([o.error or None for o in outcomes]),
        "folder": _texts([o.folder or None for o in outcomes]),
        "hash": _texts([o.hash or None for o in outcomes]),
        "seconds": pa.array([o.seconds for o in outcomes], pa.float64()),
    }
    rows = [o.row for o in outcomes]
    columns |= {name: _texts([row.get(name) for row in rows]) for name in TEXTS}
    columns |= {name: pa.array([row.get(name) for row in rows], pa.int64()) for name in COUNTS}
    movers = [row.get("movers") for row in rows]
    columns["movers"] = pa.array([None if m is None else list(map(_text, m)) for m in movers], pa.list_(pa.string()))
    others = dict.fromkeys(name for row in rows for name in row if name not in (*TEXTS, *COUNTS, "movers"))
    for name in sorted(others):
        columns[name] = pa.array([row.get(name) for row in rows], pa.float64())
    return pa.table(columns)


def _texts(values: Sequence[str | None]) -> pa.Array:
    return pa.array([None if v is None else _text(v) for v in values], pa.string())


def _text(value: str) -> str:
    """Names of files need not be Unicode, cells of a table must."""
    return str(value).encode("utf-8", "backslashreplace").decode()
