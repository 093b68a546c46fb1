"""Rerun's components as values. What only decides how a viewer draws is known by its digest."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
import xxhash
from numpy.typing import NDArray

from vlmm_log.entries import (
    Arrows,
    Boxes,
    Camera,
    Cloud,
    Column,
    DepthMap,
    Labels,
    LogLine,
    Look,
    Picture,
    Pose,
    Raster,
    Scalar,
    States,
    Table,
    Value,
)
from vlmm_log.types import EncodedImage

Cells = Mapping[str, pa.Array]
"""Component -> its values in one row."""


def values(cells: Cells) -> Iterator[Value]:
    """The values that one row of an entity holds. Raises KeyError, ValueError or TypeError where it is damaged."""
    archetypes: dict[str, dict[str, pa.Array]] = {}
    for name, cell in cells.items():
        archetype, _, field = name.rpartition(":")
        archetypes.setdefault(archetype, {})[field] = cell
    for archetype, fields in archetypes.items():
        known = READERS.get(archetype)
        if known is not None and known[0] <= fields.keys():
            yield known[1](fields)
            fields = {name: cell for name, cell in fields.items() if name in known[2]}
        if fields:
            yield Look(archetype, _digest(fields))


def _digest(fields: Mapping[str, pa.Array]) -> str:
    h = xxhash.xxh3_64()
    for name in sorted(fields):
        h.update(f"{name} {fields[name].to_pylist()}".encode("utf-8", "backslashreplace"))
    return h.hexdigest()


def numbers(cell: pa.Array) -> NDArray[Any]:
    """The numbers of a cell, without a copy where it can be; those of fixed-size lists as rows."""
    if pa.types.is_fixed_size_list(cell.type):
        return numbers(cell.flatten()).reshape(len(cell), cell.type.list_size)
    if pa.types.is_list(cell.type):
        return numbers(cell.flatten())
    return np.asarray(cell.to_numpy(zero_copy_only=False))


def _text(cell: pa.Array) -> str:
    return str(cell[0].as_py())


def _blob(cell: pa.Array) -> bytes:
    return numbers(cell).tobytes()


def _picture(c: Cells) -> Picture:
    return Picture(_blob(c["blob"]), _text(c["media_type"]))


def _encoded_depth(c: Cells) -> Raster | DepthMap:
    """A field in steps, which only this project logs as RVL; or depth as its source had it."""
    meter = float(numbers(c["meter"])[0])
    if _text(c["media_type"]) == "application/rvl":
        from vlmm_log import rvl  # here: it brings a compiler along

        return Raster(rvl.decode_steps(numbers(c["blob"]).data, 1 / meter))
    return DepthMap(EncodedImage(_blob(c["blob"]), _text(c["media_type"]), meter), meter)


def _pixels(c: Cells) -> NDArray[Any]:
    form = c["format"][0].as_py()
    kind = rr.ChannelDatatype(form["channel_datatype"]).to_np_dtype()
    return numbers(c["buffer"]).view(kind).reshape(form["height"], form["width"])


def _field(c: Cells) -> Raster | DepthMap:
    """A field of numbers, or depth that was not encoded: that has a unit."""
    return DepthMap(_pixels(c), float(numbers(c["meter"])[0])) if "meter" in c else Raster(_pixels(c))


def _tensor(c: Cells) -> Raster:
    (told,) = c["data"]
    shape, names = told["shape"].as_py(), told["names"].as_py()
    values = numbers(told["buffer"].value.values).reshape(shape)
    return Raster(values, tuple(names[0].split("_")))


def _pose(c: Cells) -> Pose:
    return Pose(numbers(c["translation"])[0], numbers(c["quaternion"])[0])


def _camera(c: Cells) -> Camera:
    width, height = numbers(c["resolution"])[0]
    return Camera(numbers(c["image_from_camera"])[0].reshape(3, 3).T, int(width), int(height))


def _arrows(c: Cells) -> Arrows:
    return Arrows(numbers(c["origins"]).reshape(-1, 2), numbers(c["vectors"]).reshape(-1, 2))


def _boxes(c: Cells) -> Boxes:
    centers, half = numbers(c["centers"]).reshape(-1, 2), numbers(c["half_sizes"]).reshape(-1, 2)
    told = [text.partition(" ") for text in c["labels"].to_pylist()] if "labels" in c else []
    ids, names = np.array([int(i) for i, _, _ in told], np.int64), tuple(name for _, _, name in told)
    return Boxes(np.hstack([centers - half, centers + half]), ids, names)


def _cloud(c: Cells) -> Cloud:
    packed = numbers(c["colors"]).astype(np.uint32)
    colors = np.stack([packed >> 24 & 255, packed >> 16 & 255, packed >> 8 & 255], axis=1).astype(np.uint8)
    return Cloud(numbers(c["positions"]).reshape(-1, 3), colors, float(numbers(c["radii"])[0]))


def _table(c: Cells) -> Table:
    return Table({name: _column(cell) for name, cell in c.items()})


def _column(cell: pa.Array) -> Column:
    return tuple(cell.to_pylist()) if pa.types.is_string(cell.type) else numbers(cell)


Reader = tuple[frozenset[str], Callable[[Cells], Value], frozenset[str]]


def _reader(read: Callable[[Cells], Value], needed: str, looks: str = "") -> Reader:
    return frozenset(needed.split()), read, frozenset(looks.split())


READERS: dict[str, Reader] = {  # archetype -> fields that it needs, how they are read, fields that are looks
    "": _reader(_table, ""),
    "AnnotationContext": _reader(lambda c: Look("AnnotationContext", _digest(c)), ""),
    "Arrows2D": _reader(_arrows, "origins vectors", "colors"),
    "Boxes2D": _reader(_boxes, "centers half_sizes", "colors"),
    "Clear": _reader(lambda _: Table({}), ""),
    "DepthImage": _reader(_field, "buffer format", "colormap depth_range"),
    "EncodedDepthImage": _reader(_encoded_depth, "blob media_type meter", "colormap depth_range"),
    "EncodedImage": _reader(_picture, "blob media_type"),
    "Pinhole": _reader(_camera, "image_from_camera resolution", "camera_xyz"),
    "Points3D": _reader(_cloud, "positions colors radii"),
    "Scalars": _reader(lambda c: Scalar(float(numbers(c["scalars"])[0])), "scalars"),
    "SegmentationImage": _reader(lambda c: Labels(_pixels(c)), "buffer format"),
    "StateChange": _reader(lambda c: States(tuple(c["state"].to_pylist())), "state"),
    "Tensor": _reader(_tensor, "data"),
    "TextLog": _reader(lambda c: LogLine(_text(c["text"]), _text(c["level"])), "text level"),
    "Transform3D": _reader(_pose, "translation quaternion"),
}
