"""Messages of an MCAP recording as values, whichever schemas they are written in."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
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
    Picture,
    Pose,
    Raster,
    Scalar,
    States,
    Table,
    Value,
)

Parts = dict[str, Any]
"""Part -> message: "" where one message holds the whole value."""

PIXELS = {"32FC1": np.float32, "16UC1": np.uint16, "mono16": np.uint16, "mono8": np.uint8}
LEVELS = {20: "INFO", 30: "WARN", 2: "INFO", 3: "WARN"}  # of ROS, of Foxglove


def value(kind: str, parts: Parts) -> Value:
    """A value of its messages. Raises ValueError, LookupError, AttributeError or TypeError where it is damaged."""
    if "" in parts:
        return READERS[kind](parts[""])
    names = tuple(sorted(parts, key=ORDER.index))
    return Raster(np.stack([_pixels(parts[name]) for name in names]), names)


ORDER = ("u", "v", "x", "y", "z", "xx", "xy", "xz", "yy", "yz", "zz")  # of channels


def _bytes(message: Any) -> bytes:
    data = message.data
    return data if isinstance(data, bytes) else np.asarray(data, np.uint8).tobytes()


def _pixels(message: Any) -> NDArray[Any]:
    pixels = np.frombuffer(_bytes(message), PIXELS[message.encoding])
    return pixels.reshape(int(message.height), int(message.width))


def _picture(message: Any) -> Picture:
    return Picture(_bytes(message), f"image/{message.format}")


def _depth(message: Any) -> DepthMap:
    return DepthMap(_pixels(message), 1000.0 if message.encoding == "16UC1" else 1.0)


def _pose(message: Any) -> Pose:
    one = message.transforms[0]
    t, q = (
        (one.transform.translation, one.transform.rotation)
        if hasattr(one, "transform")
        else (one.translation, one.rotation)
    )
    return Pose(np.array([t.x, t.y, t.z], np.float32), np.array([q.x, q.y, q.z, q.w], np.float32))


def _camera(message: Any) -> Camera:
    K = np.array(getattr(message, "k", None) if hasattr(message, "k") else message.K, np.float32)
    return Camera(K.reshape(3, 3), int(message.width), int(message.height))


def _ends(message: Any) -> NDArray[np.float64]:
    """Points (n, 2) of lines drawn on an image."""
    points = message.points[0].points if hasattr(message, "circles") else message.points
    return np.array([(p.x, p.y) for p in points], np.float64).reshape(-1, 2)


def _arrows(message: Any) -> Arrows:
    if hasattr(message, "circles") and not message.points:
        return Arrows(np.zeros((0, 2), np.float32), np.zeros((0, 2), np.float32))
    ends = _ends(message)
    return Arrows(ends[::2].astype(np.float32), (ends[1::2] - ends[::2]).astype(np.float32))


def _boxes(message: Any) -> Boxes:
    if hasattr(message, "circles"):
        told = [text.text.partition(" ") for text in message.texts]
        corners = [[p for q in (one.points[0], one.points[2]) for p in (q.x, q.y)] for one in message.points]
        ids, names = [int(i) for i, _, _ in told], [name for _, _, name in told]
    else:
        corners = [_corners(d.bbox) for d in message.detections]
        ids = [int(d.id) for d in message.detections]
        names = [d.results[0].hypothesis.class_id for d in message.detections]
    return Boxes(np.array(corners, np.float32).reshape(-1, 4), np.array(ids, np.int64), tuple(names))


def _corners(box: Any) -> list[float]:
    u, v, w, h = box.center.position.x, box.center.position.y, box.size_x / 2, box.size_y / 2
    return [u - w, v - h, u + w, v + h]


def _cloud(message: Any) -> Cloud:
    step = message.point_step if hasattr(message, "point_step") else message.point_stride
    rows = np.frombuffer(_bytes(message), np.uint8).reshape(-1, int(step))
    points = rows[:, :12].copy().view(np.float32).reshape(-1, 3)
    return Cloud(points, np.ascontiguousarray(rows[:, [14, 13, 12]]), 0.0)  # colours lie as b, g, r


def _table(message: Any) -> Table:
    fields = {
        name: field for name, field in vars(message).items() if name not in ("header", "__msgtype__", "timestamp")
    }
    if not fields:
        return Table({})
    columns = {name: _column(field) for name, field in fields.items()}
    rows = len(next(iter(columns.values())))
    return Table({name: _shaped(column, rows) for name, column in columns.items()})


def _column(field: Any) -> Column:
    if isinstance(field, list) and (not field or isinstance(field[0], str)):
        return tuple(field)
    return np.asarray(field)


def _shaped(column: Column, rows: int) -> Column:
    """A flat column of several numbers a row as such."""
    if isinstance(column, tuple) or not rows or len(column) == rows:
        return column
    return column.reshape(rows, -1)


def _line(message: Any) -> LogLine:
    text = message.msg if hasattr(message, "msg") else message.message
    return LogLine(text, LEVELS[int(message.level)])


def _scalar(message: Any) -> Scalar:
    number = message.data if hasattr(message, "data") else message.value
    return Scalar(float("nan") if number is None else float(number))


def _states(message: Any) -> States:
    return States(tuple(message.data.split(", ")))


READERS: Mapping[str, Callable[[Any], Value]] = {
    "Picture": _picture,
    "DepthMap": _depth,
    "Raster": lambda message: Raster(_pixels(message)),
    "Labels": lambda message: Labels(_pixels(message)),
    "Pose": _pose,
    "Camera": _camera,
    "Arrows": _arrows,
    "Boxes": _boxes,
    "Cloud": _cloud,
    "Table": _table,
    "Scalar": _scalar,
    "LogLine": _line,
    "States": _states,
}
