"""Entries as messages of Foxglove's own schemas, in Protobuf; what these have no schema for, as JSON."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, assert_never

import numpy as np
from foxglove import messages as fox
from numpy.typing import NDArray

from vlmm_log.depth_pixels import metric_pixels
from vlmm_log.entries import (
    Arrows,
    Boxes,
    Camera,
    Cloud,
    Column,
    DepthMap,
    Ellipsoids,
    Entry,
    LabelNames,
    Labels,
    LogLine,
    Look,
    Picture,
    Pose,
    Raster,
    Scalar,
    StateNames,
    States,
    Steps,
    Table,
)
from vlmm_log.ros.mcap import Definition
from vlmm_log.ros.messages import NS
from vlmm_log.sinks.map_entries import id_color
from vlmm_log.sinks.mcap import Message, table_name, topic_of

WORLD, CAMERA = "world", "camera"  # frames
LEVELS = {"INFO": fox.LogLevel.Info, "WARN": fox.LogLevel.Warning}
VIEW = "-"
PACKAGE = "foxglove."
NUMBER, TEXT, CLASSES = "vlmm_log.Number", "vlmm_log.Text", "vlmm_log.LabelNames"
POINT = np.dtype([("xyz", "<f4", 3), ("bgra", "u1", 4)])
KINDS = {"f": "number", "i": "integer", "u": "integer", "b": "boolean"}  # numpy's kinds of numbers -> JSON Schema's
INTEGER, STRING = {"type": "integer"}, {"type": "string"}


class FoxgloveValues:
    """See mcap.Dialect."""

    profile = ""

    def __init__(self) -> None:
        self._schemas: dict[str, Mapping[str, Any]] = {  # of JSON
            NUMBER: _object({"value": {"type": "number"}}),
            TEXT: _object({"data": STRING}),
            CLASSES: _object({"classes": _array(_object({"id": INTEGER, "name": STRING, "color": _array(INTEGER)}))}),
        }

    def define(self, type_name: str) -> Definition:
        """See mcap.Dialect."""
        if type_name in self._schemas:
            return Definition("json", "jsonschema", _json(self._schemas[type_name]))
        schema = getattr(fox, type_name.removeprefix(PACKAGE)).get_schema()
        return Definition("protobuf", schema.encoding, schema.data)

    def messages(self, entry: Entry, stamp_ns: int) -> Iterator[Message]:
        """See mcap.Dialect."""
        topic, value, at = topic_of(entry.entity), entry.value, fox.Timestamp(*divmod(stamp_ns, NS))
        match value:
            case Picture(data, media_type):
                form = media_type.removeprefix("image/")
                image = fox.CompressedImage(timestamp=at, frame_id=CAMERA, data=bytes(data), format=form)
                yield _message(topic, image)
            case DepthMap():
                yield _message(topic, _image(at, *metric_pixels(value)))
            case Raster(values, ()):
                yield _message(topic, _image(at, "32FC1", values.astype(np.float32)))
            case Raster(values, channels):  # apart: few tools show images of several float channels
                for name, plane in zip(channels, values.astype(np.float32), strict=True):
                    yield _message(f"{topic}/{name}", _image(at, "32FC1", plane), name)
            case Labels(values):
                yield _message(topic, _image(at, "mono8" if values.dtype == np.uint8 else "mono16", values))
            case LabelNames(classes):
                named = [{"id": c, "name": name, "color": color} for c, name, color in classes]
                yield Message(f"{topic}/labels", CLASSES, _json({"classes": named}), VIEW)
            case Pose(translation, quaternion):
                yield _message("/tf", _transforms(at, translation, quaternion))
            case Camera(K, width, height):
                yield _message(f"{topic}/camera_info", _calibration(at, K.astype(float), width, height))
            case Arrows():
                yield _message(topic, _lines(at, value))
            case Boxes():
                yield _message(topic, _boxes(at, value))
            case Table(columns, shown):
                yield self._table(topic, f"vlmm_log.{table_name(entry.entity)}", columns)
                if shown is not None:
                    ids = [str(i) for i in columns["element_id"]]
                    yield _message(f"{topic}/scene", _scene(at, ids, shown), VIEW)
            case Cloud():
                yield _message(topic, _cloud(at, value))
            case Scalar(number):
                yield Message(topic, NUMBER, _json({"value": _cells(np.array(number))}))
            case LogLine(text, level):
                yield _message(topic, fox.Log(timestamp=at, level=LEVELS[level], message=text, name="vlmm-log"))
            case States(lanes):
                yield Message(topic, TEXT, _json({"data": ", ".join(lanes)}))
            case StateNames() | Look() | Steps():  # steps come unpacked
                return
            case _:
                assert_never(value)

    def _table(self, topic: str, type_name: str, columns: Mapping[str, Column]) -> Message:
        self._schemas.setdefault(type_name, _table_schema(columns))
        return Message(topic, type_name, _json({name: _cells(column) for name, column in columns.items()}))


def _message(topic: str, message: Any, part: str = "") -> Message:
    return Message(topic, PACKAGE + type(message).__name__, message.encode(), part)


def _image(at: fox.Timestamp, encoding: str, pixels: NDArray[Any]) -> fox.RawImage:
    """An array (H, W)."""
    data = pixels.astype(pixels.dtype.newbyteorder("<"), copy=False)
    height, width = data.shape
    return fox.RawImage(
        timestamp=at,
        frame_id=CAMERA,
        width=width,
        height=height,
        encoding=encoding,
        step=width * data.itemsize,
        data=data.tobytes(),
    )


def _transforms(at: fox.Timestamp, translation: NDArray[Any], quaternion: NDArray[Any]) -> fox.FrameTransforms:
    pose = fox.FrameTransform(
        timestamp=at,
        parent_frame_id=WORLD,
        child_frame_id=CAMERA,
        translation=_vector(translation),
        rotation=_rotation(quaternion),
    )
    return fox.FrameTransforms(transforms=[pose])


def _calibration(at: fox.Timestamp, K: NDArray[Any], width: int, height: int) -> fox.CameraCalibration:
    """Of a camera (3, 3) px without distortion, its images not rectified."""
    P = np.hstack([K, np.zeros((3, 1))])
    return fox.CameraCalibration(
        timestamp=at,
        frame_id=CAMERA,
        width=width,
        height=height,
        distortion_model="plumb_bob",
        D=[0.0] * 5,
        K=K.ravel().tolist(),
        R=np.eye(3).ravel().tolist(),
        P=P.ravel().tolist(),
    )


def _lines(at: fox.Timestamp, arrows: Arrows) -> fox.ImageAnnotations:
    ends = arrows.origins.astype(float) + arrows.vectors
    points = np.stack([arrows.origins.astype(float), ends], axis=1).reshape(-1, 2)
    color = _color(arrows.color or (255, 255, 255))
    return fox.ImageAnnotations(timestamp=at, points=[_drawn(at, fox.PointsAnnotationType.LineList, points, color)])


def _boxes(at: fox.Timestamp, boxes: Boxes) -> fox.ImageAnnotations:
    """Outlines, and at the left top of each its text "id name"."""
    outlines, texts = [], []
    for (left, top, right, bottom), i, name in zip(boxes.corners.astype(float), boxes.ids, boxes.names, strict=True):
        corners = np.array([(left, top), (right, top), (right, bottom), (left, bottom)])
        color, text = _color(id_color(int(i))), f"{i} {name}" if name else f"{i}"
        outlines.append(_drawn(at, fox.PointsAnnotationType.LineLoop, corners, color))
        place = fox.Point2(x=left, y=top)
        texts.append(fox.TextAnnotation(timestamp=at, position=place, text=text, font_size=12.0, text_color=color))
    return fox.ImageAnnotations(timestamp=at, points=outlines, texts=texts)


def _drawn(
    at: fox.Timestamp, how: fox.PointsAnnotationType, points: NDArray[np.float64], color: fox.Color
) -> fox.PointsAnnotation:
    """Lines between points (n, 2) px."""
    listed = [fox.Point2(x=x, y=y) for x, y in points.tolist()]
    return fox.PointsAnnotation(timestamp=at, type=how, points=listed, outline_color=color, thickness=1.0)


def _scene(at: fox.Timestamp, ids: Sequence[str], shown: Ellipsoids) -> fox.SceneUpdate:
    """What was there goes, each row comes. Labels that are not shown unasked are metadata."""
    rows = zip(ids, shown.centers, shown.half_sizes, shown.quaternions, shown.colors, shown.labels, strict=True)
    entities = []
    for i, center, half, q, color, label in rows:
        pose = fox.Pose(position=_vector(center), orientation=_rotation(q))
        text = fox.TextPrimitive(
            pose=pose, billboard=True, font_size=12.0, scale_invariant=True, color=_color(color), text=label
        )
        entity = fox.SceneEntity(
            timestamp=at,
            frame_id=WORLD,
            id=i,
            metadata=[fox.KeyValuePair(key="label", value=label)],
            spheres=[fox.SpherePrimitive(pose=pose, size=_vector(2 * half), color=_color(color, 0.5))],
            texts=[text] if shown.labelled else [],
        )
        entities.append(entity)
    gone = fox.SceneEntityDeletion(timestamp=at, type=fox.SceneEntityDeletionType.All)
    return fox.SceneUpdate(deletions=[gone], entities=entities)


def _cloud(at: fox.Timestamp, cloud: Cloud) -> fox.PointCloud:
    rows = np.empty(len(cloud.points), POINT)
    rows["xyz"] = cloud.points
    rows["bgra"] = np.insert(cloud.colors[:, ::-1], 3, 255, axis=1)
    kind = fox.PackedElementFieldNumericType
    fields = [
        *(fox.PackedElementField(name=name, offset=4 * k, type=kind.Float32) for k, name in enumerate("xyz")),
        *(
            fox.PackedElementField(name=name, offset=12 + k, type=kind.Uint8)
            for k, name in enumerate(("blue", "green", "red", "alpha"))
        ),
    ]
    still = fox.Pose(position=fox.Vector3(), orientation=fox.Quaternion(w=1.0))
    return fox.PointCloud(
        timestamp=at,
        frame_id=WORLD,
        pose=still,
        point_stride=POINT.itemsize,
        fields=fields,
        data=rows.tobytes(),
    )


def _vector(v: NDArray[Any]) -> fox.Vector3:
    x, y, z = map(float, v)
    return fox.Vector3(x=x, y=y, z=z)


def _rotation(q: NDArray[Any]) -> fox.Quaternion:
    x, y, z, w = map(float, q)
    return fox.Quaternion(x=x, y=y, z=z, w=w)


def _color(rgb: Sequence[int], alpha: float = 1.0) -> fox.Color:
    red, green, blue = (c / 255 for c in rgb[:3])
    return fox.Color(r=red, g=green, b=blue, a=alpha)


def _json(value: Any) -> bytes:
    return json.dumps(value, separators=(",", ":"), allow_nan=False).encode()


def _cells(column: Column) -> Any:
    """A column as JSON has it, each number in full: NaN is null, infinity a text, as Protobuf writes it in JSON."""
    if isinstance(column, tuple) or column.dtype.kind != "f" or np.isfinite(column).all():
        return list(column) if isinstance(column, tuple) else column.tolist()
    cells = column.astype(object)
    cells[np.isnan(column)] = None
    cells[np.isposinf(column)] = "Infinity"
    cells[np.isneginf(column)] = "-Infinity"
    return cells.tolist()


def _table_schema(columns: Mapping[str, Column]) -> Mapping[str, Any]:
    """``columns`` has the type of each column, which JSON does not keep.

    Foxglove refuses a channel whose schema has an array of arrays or of "number or null" among its properties. So
    columns (n, k) are not listed there, and that a number may be null is not said; Foxglove shows both.
    """
    flat = {name: _array({"type": _kind(c)}) for name, c in columns.items() if isinstance(c, tuple) or c.ndim == 1}
    types = {name: "text" if isinstance(c, tuple) else c.dtype.name for name, c in columns.items()}
    return {**_object(flat), "columns": types}


def _kind(column: Column) -> str:
    return "string" if isinstance(column, tuple) else KINDS[column.dtype.kind]


def _array(items: Mapping[str, Any]) -> Mapping[str, Any]:
    return {"type": "array", "items": items}


def _object(properties: Mapping[str, Any]) -> Mapping[str, Any]:
    return {"type": "object", "properties": properties}
