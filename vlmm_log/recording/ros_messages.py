"""Messages of ROS 2 as values."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from vlmm_log.entries import Arrows, Boxes, Camera, Cloud, Column, LogLine, Pose, Scalar, States, Table, Value

LEVELS = {20: "INFO", 30: "WARN"}
ABOUT = ("header", "__msgtype__")  # of a table's message: no columns


def _pose(message: Any) -> Pose:
    t, q = message.transforms[0].transform.translation, message.transforms[0].transform.rotation
    return Pose(np.array([t.x, t.y, t.z], np.float32), np.array([q.x, q.y, q.z, q.w], np.float32))


def _camera(message: Any) -> Camera:
    return Camera(message.k.astype(np.float32).reshape(3, 3), int(message.width), int(message.height))


def _arrows(message: Any) -> Arrows:
    ends = np.array([(p.x, p.y) for p in message.points], np.float64).reshape(-1, 2)
    return Arrows(ends[::2].astype(np.float32), (ends[1::2] - ends[::2]).astype(np.float32))


def _boxes(message: Any) -> Boxes:
    corners = [_corners(d.bbox) for d in message.detections]
    ids = [int(d.id) for d in message.detections]
    names = tuple(d.results[0].hypothesis.class_id for d in message.detections)
    return Boxes(np.array(corners, np.float32).reshape(-1, 4), np.array(ids, np.int64), names)


def _corners(box: Any) -> list[float]:
    u, v, w, h = box.center.position.x, box.center.position.y, box.size_x / 2, box.size_y / 2
    return [u - w, v - h, u + w, v + h]


def _cloud(message: Any) -> Cloud:
    rows = np.frombuffer(message.data, np.uint8).reshape(-1, int(message.point_step))
    points = rows[:, :12].copy().view("<f4").reshape(-1, 3)
    return Cloud(points, np.ascontiguousarray(rows[:, [14, 13, 12]]), 0.0)  # colours lie as b, g, r


def _table(message: Any) -> Table:
    columns = {name: _column(field) for name, field in vars(message).items() if name not in ABOUT}
    rows = len(next(iter(columns.values()), ()))
    return Table({name: _shaped(column, rows) for name, column in columns.items()})


def _column(field: Any) -> Column:
    return tuple(field) if isinstance(field, list) else np.asarray(field)


def _shaped(column: Column, rows: int) -> Column:
    """A flat column of several numbers a row as such."""
    if isinstance(column, tuple) or not rows or len(column) == rows:
        return column
    return column.reshape(rows, -1)


READERS: Mapping[str, Callable[[Any], Value]] = {
    "Pose": _pose,
    "Camera": _camera,
    "Arrows": _arrows,
    "Boxes": _boxes,
    "Cloud": _cloud,
    "Table": _table,
    "Scalar": lambda message: Scalar(float(message.data)),
    "LogLine": lambda message: LogLine(message.msg, LEVELS[int(message.level)]),
    "States": lambda message: States(tuple(message.data.split(", "))),
}
