"""Small values sent in columns, many rows at once: one by one, handing them over costs more than writing them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import NDArray

from vlmm_log.entries import Arrows, Entry, Picture, Pose, Raster, Scalar, States, Steps, Value

MOST = 1 << 20  # bytes of an entity's rows, until they are sent; a row counts for ROW at least
ROW = 1 << 11
SMALL = 1 << 17  # bytes
RVL = "application/rvl"
BYTES = pa.list_(pa.field("item", pa.uint8(), nullable=False))  # Rerun's type of a blob
TENSOR = rr.components.TensorDataBatch(rr.components.TensorData(array=np.zeros(1))).as_arrow_array().type


class Columns:
    """Gathers values by entity and sends each entity's once enough are there."""

    def __init__(self, rec: rr.RecordingStream) -> None:
        self._rec = rec
        self._rows: dict[tuple[str, type], list[Entry]] = {}
        self._held: dict[tuple[str, type], int] = {}  # bytes

    def take(self, entity: str, entry: Entry) -> bool:
        """Whether the entry goes by columns; then it waits for its time.

        One that is too large takes along those of its entity that wait, however long the run: rows lie nearly in order.
        """
        size, key = _size(entry.value), (entity, type(entry.value))
        large = size > SMALL
        if entry.stamp_ns is None or entry.index is None or (large and key not in self._rows):
            return False
        self._rows.setdefault(key, []).append(entry)
        self._held[key] = self._held.get(key, 0) + max(size, ROW)
        if large or self._held[key] >= MOST:
            self._send(entity, self._rows.pop(key))
            del self._held[key]
        return True

    def flush(self, least: int = 1) -> None:
        """Send what waits; of scalars and states, what has at least so many rows.

        Each entity that is sent is a chunk, of which Rerun keeps notes of some 10 kB until the end: elements that a few
        pairs saw would be most of them.
        """
        for key, rows in list(self._rows.items()):
            if len(rows) >= least or key[1] not in (Scalar, States):
                self._send(key[0], rows)
                del self._rows[key], self._held[key]

    def _send(self, entity: str, rows: Sequence[Entry]) -> None:
        stamps = np.array([entry.stamp_ns for entry in rows], "datetime64[ns]")
        frames = [entry.index for entry in rows if entry.index is not None]
        times = [rr.TimeColumn("frame", sequence=frames), rr.TimeColumn("time", timestamp=stamps)]
        values = [entry.value for entry in rows]
        self._rec.send_columns(entity, times, KINDS[type(values[0])](values))


def _size(value: Value) -> int:
    """Bytes of a value that goes by columns; more than SMALL for any other."""
    match value:
        case Scalar():
            return 8
        case Steps(image, _) | Picture(image, _):
            return len(image)
        case Raster(values, channels) if channels:
            return values.nbytes
        case Arrows(origins, vectors):
            return origins.nbytes + vectors.nbytes
        case Pose() | States():
            return 32
        case _:
            return SMALL + 1


def blobs(*parts: bytes | NDArray[Any]) -> pa.Array:
    """Bytes, a row each; of one row without a copy."""
    flat = [p.reshape(-1).view(np.uint8) if isinstance(p, np.ndarray) else np.frombuffer(p, np.uint8) for p in parts]
    whole = flat[0] if len(flat) == 1 else np.concatenate(flat)
    ends = np.cumsum([0, *(part.size for part in flat)], dtype=np.int32)
    inner = pa.Array.from_buffers(pa.uint8(), whole.size, [None, pa.py_buffer(whole)])
    return pa.ListArray.from_arrays(pa.array(ends), inner, BYTES)


def tensors(*rasters: Raster) -> pa.Array:
    """Rasters of one type as tensors, a row each."""
    union, kind = TENSOR.field("buffer").type, rasters[0].values.dtype
    fields = [union.field(i) for i in range(union.num_fields)]
    code = [field.name for field in fields].index(f"F{8 * kind.itemsize}")
    ends = np.cumsum([0, *(r.values.size for r in rasters)], dtype=np.int32)
    numbers = pa.array(np.concatenate([r.values.reshape(-1) for r in rasters]))
    children = [pa.array([], field.type) for field in fields]
    children[code] = pa.ListArray.from_arrays(pa.array(ends), numbers, fields[code].type)
    codes, places = np.full(len(rasters), code, np.int8), np.arange(len(rasters), dtype=np.int32)
    parts = [None, pa.py_buffer(codes), pa.py_buffer(places)]
    buffers = pa.Array.from_buffers(union, len(rasters), parts, children=children)
    shapes = pa.array([r.values.shape for r in rasters], TENSOR.field("shape").type)
    axes = pa.array([["_".join(r.channels), "height", "width"] for r in rasters], TENSOR.field("names").type)
    return pa.StructArray.from_arrays([shapes, axes, buffers], fields=list(TENSOR))


def _scalars(values: Sequence[Scalar]) -> Any:
    return rr.Scalars.columns(scalars=[v.value for v in values])


def _pictures(values: Sequence[Picture]) -> Any:
    images = blobs(*(v.data for v in values))
    return rr.EncodedImage.columns(blob=images, media_type=[v.media_type for v in values])


def _steps(values: Sequence[Steps]) -> Any:
    images = blobs(*(v.image for v in values))
    meters = [1 / v.step for v in values]
    return rr.EncodedDepthImage.columns(blob=images, media_type=[RVL] * len(values), meter=meters)


def _tensors(values: Sequence[Raster]) -> Any:
    return rr.Tensor.columns(data=tensors(*values))


def _arrows(values: Sequence[Arrows]) -> Any:
    sizes = [len(v.origins) for v in values]
    origins, vectors = (np.concatenate(parts) for parts in zip(*((v.origins, v.vectors) for v in values), strict=True))
    columns = list(rr.Arrows2D.columns(origins=origins, vectors=vectors).partition(sizes))
    colors = [v.color for v in values if v.color is not None]  # of an entity, all or none
    if colors:
        columns += rr.Arrows2D.columns(colors=colors)
    return columns


def _poses(values: Sequence[Pose]) -> Any:
    places = np.stack([v.translation for v in values])
    return rr.Transform3D.columns(translation=places, quaternion=np.stack([v.quaternion for v in values]))


def _states(values: Sequence[States]) -> Any:
    lanes = [lane for v in values for lane in v.lanes]
    return rr.StateChange.columns(state=lanes).partition([len(v.lanes) for v in values])


KINDS: Mapping[type, Callable[[Any], Any]] = {
    Scalar: _scalars,
    Picture: _pictures,
    Steps: _steps,
    Raster: _tensors,
    Arrows: _arrows,
    Pose: _poses,
    States: _states,
}
