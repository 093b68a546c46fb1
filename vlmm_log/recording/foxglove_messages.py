"""Messages of Foxglove's schemas, and of ours in JSON, as values."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from vlmm_log.entries import Arrows, Boxes, Camera, Cloud, Column, LogLine, Pose, Scalar, States, Table, Value

LEVELS = {2: "INFO", 3: "WARN"}


def json_readers(schema: bytes) -> Mapping[str, Callable[[Any], Value]]:
    """Of messages in JSON, by their schema: it has the types of a table's columns. Raises ValueError."""
    types: Mapping[str, str] = json.loads(schema).get("columns", {})

    def table(message: Any) -> Table:
        return Table({name: _column(cells, types[name]) for name, cells in vars(message).items()})

    return {
        "Table": table,
        "Scalar": lambda message: Scalar(float("nan") if message.value is None else float(message.value)),
        "States": lambda message: States(tuple(message.data.split(", "))),
    }


def _column(cells: Any, kind: str) -> Column:
    """A column of its type: numpy takes null for NaN, and "Infinity" for what it says."""
    return tuple(cells) if kind == "text" else np.array(cells, kind)


def _pose(message: Any) -> Pose:
    t, q = message.transforms[0].translation, message.transforms[0].rotation
    return Pose(np.array([t.x, t.y, t.z], np.float32), np.array([q.x, q.y, q.z, q.w], np.float32))


def _camera(message: Any) -> Camera:
    return Camera(np.array(message.K, np.float32).reshape(3, 3), message.width, message.height)


def _arrows(message: Any) -> Arrows:
    ends = np.array([(p.x, p.y) for p in message.points[0].points], np.float64).reshape(-1, 2)
    return Arrows(ends[::2].astype(np.float32), (ends[1::2] - ends[::2]).astype(np.float32))


def _boxes(message: Any) -> Boxes:
    corners = [[p for q in (one.points[0], one.points[2]) for p in (q.x, q.y)] for one in message.points]
    told = [text.text.partition(" ") for text in message.texts]
    ids = np.array([int(i) for i, _, _ in told], np.int64)
    return Boxes(np.array(corners, np.float32).reshape(-1, 4), ids, tuple(name for _, _, name in told))


def _cloud(message: Any) -> Cloud:
    rows = np.frombuffer(message.data, np.uint8).reshape(-1, message.point_stride)
    points = rows[:, :12].copy().view("<f4").reshape(-1, 3)
    return Cloud(points, np.ascontiguousarray(rows[:, [14, 13, 12]]), 0.0)  # colours lie as b, g, r


READERS: Mapping[str, Callable[[Any], Value]] = {
    "Pose": _pose,
    "Camera": _camera,
    "Arrows": _arrows,
    "Boxes": _boxes,
    "Cloud": _cloud,
    "LogLine": lambda message: LogLine(message.message, LEVELS[int(message.level)]),
}
