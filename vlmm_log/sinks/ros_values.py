"""Entries as ROS 2 messages."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Any, assert_never

import numpy as np
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
from vlmm_log.ros.mcap import ros2_definition
from vlmm_log.ros.messages import CAMERA_INFO, COMPRESSED_IMAGE, IMAGE, NUMBER, TRANSFORMS, Placed, Ros
from vlmm_log.ros.vision import DEFINITIONS
from vlmm_log.sinks.mcap import Message, table_name, topic_of
from vlmm_log.types import Float64

WORLD, CAMERA = "world", "camera"  # frames
LEVELS = {"INFO": 20, "WARN": 30}
LINE_LIST, SPHERE, ADD, DELETE_ALL = 3, 2, 0, 3  # of markers
VIEW = "-"
NUMBERS = {"f2": "float32", "f4": "float32", "f8": "float64", "b1": "bool"}  # dtype -> ROS's name; integers below


class Ros2Values:
    """See mcap.Dialect."""

    profile = "ros2"

    def __init__(self) -> None:
        self._ros = Ros(2)
        self._ros.register(DEFINITIONS)
        self.define = ros2_definition(self._ros)

    @cached_property
    def _types(self) -> dict[str, Any]:
        types: dict[str, Any] = self._ros.store.types
        return types

    def messages(self, entry: Entry, stamp_ns: int) -> Iterator[Message]:
        """See mcap.Dialect."""
        topic, value, ros = topic_of(entry.entity), entry.value, self._ros
        header = ros.header(stamp_ns, CAMERA, 0)
        match value:
            case Picture(data, media_type):
                form = media_type.removeprefix("image/")
                yield Message(topic, COMPRESSED_IMAGE, ros.compressed_image(header, form, data))
            case DepthMap():
                encoding, pixels = metric_pixels(value)
                yield Message(topic, IMAGE, ros.image(header, encoding, pixels))
            case Raster(values, ()):
                yield Message(topic, IMAGE, ros.image(header, "32FC1", values.astype(np.float32)))
            case Raster(values, channels):  # apart: few tools show images of several float channels
                for name, plane in zip(channels, values.astype(np.float32), strict=True):
                    yield Message(f"{topic}/{name}", IMAGE, ros.image(header, "32FC1", plane), name)
            case Labels(values):
                encoding = "mono8" if values.dtype == np.uint8 else "mono16"
                yield Message(topic, IMAGE, ros.image(header, encoding, values))
            case LabelNames():
                yield self._label_info(f"{topic}/labels", header, value)
            case Pose(translation, quaternion):
                placed = Placed(WORLD, CAMERA, translation.astype(float), quaternion.astype(float))
                yield Message("/tf", TRANSFORMS, ros.transforms(stamp_ns, 0, [placed]))
            case Camera(K, width, height):
                info = ros.camera_info(header, K.astype(float), (height, width))
                yield Message(f"{topic}/camera_info", CAMERA_INFO, info)
            case Arrows():
                yield self._line_list(topic, header, value)
            case Boxes():
                yield self._boxes(topic, header, value)
            case Table(columns, shown):
                yield self._table(topic, f"vlmm_log/msg/{table_name(entry.entity)}", stamp_ns, columns)
                if shown is not None:
                    of_world = ros.header(stamp_ns, WORLD, 0)
                    ids = [str(i) for i in columns["element_id"]]
                    yield self._markers(f"{topic}/markers", of_world, shown)
                    yield self._detections(f"{topic}/detections", of_world, ids, columns, shown)
            case Cloud():
                yield self._cloud(topic, ros.header(stamp_ns, WORLD, 0), value)
            case Scalar(number):
                yield Message(topic, NUMBER, ros.number(number))
            case LogLine(text, level):
                yield self._message(
                    topic, "rcl_interfaces/msg/Log", header.stamp, LEVELS[level], "vlmm-log", text, "", "", 0
                )
            case States(lanes):
                yield self._message(topic, "std_msgs/msg/String", ", ".join(lanes))
            case StateNames() | Look() | Steps():  # steps come unpacked
                return
            case _:
                assert_never(value)

    def _message(self, topic: str, type_name: str, *fields: Any, part: str = "") -> Message:
        return Message(topic, type_name, self._ros.serialised(type_name, self._types[type_name](*fields)), part)

    def _label_info(self, topic: str, header: Any, names: LabelNames) -> Message:
        one = self._types["vision_msgs/msg/VisionClass"]
        classes = [one(c, name) for c, name, _ in names.classes]
        return self._message(topic, "vision_msgs/msg/LabelInfo", header, classes, 0.0, part=VIEW)

    def _line_list(self, topic: str, header: Any, arrows: Arrows) -> Message:
        ends = arrows.origins.astype(float) + arrows.vectors
        points = self._points(np.stack([arrows.origins.astype(float), ends], axis=1).reshape(-1, 2))
        color = self._color(arrows.color or (255, 255, 255))
        seconds = self._types["builtin_interfaces/msg/Duration"](0, 0)
        fields: tuple[Any, ...] = (
            header,
            "",
            0,
            LINE_LIST,
            ADD,
            self._point(0, 0),
            1.0,
            color,
            0,
            color,
            seconds,
            points,
            [],
        )
        return self._message(topic, "visualization_msgs/msg/ImageMarker", *fields)

    def _boxes(self, topic: str, header: Any, boxes: Boxes) -> Message:
        of_vision = {name: self._types[f"vision_msgs/msg/{name}"] for name in ("Point2D", "Pose2D", "BoundingBox2D")}
        detections = []
        for corners, i, name in zip(boxes.corners.astype(float), boxes.ids, boxes.names, strict=True):
            (u, v), (width, height) = (corners[:2] + corners[2:]) / 2, corners[2:] - corners[:2]
            center = of_vision["Pose2D"](of_vision["Point2D"](u, v), 0.0)
            box = of_vision["BoundingBox2D"](center, width, height)
            results = [self._hypothesis(name, 1.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))]
            detections.append(self._types["vision_msgs/msg/Detection2D"](header, results, box, str(i)))
        return self._message(topic, "vision_msgs/msg/Detection2DArray", header, detections)

    def _table(self, topic: str, type_name: str, stamp_ns: int, columns: Any) -> Message:
        if type_name not in self._types:
            fields = "".join(f"{_ros_type(column)}[] {name}\n" for name, column in columns.items())
            self._ros.register({type_name: "std_msgs/Header header\n" + fields})
        values = [_flat(column) for column in columns.values()]
        return self._message(topic, type_name, self._ros.header(stamp_ns, WORLD, 0), *values)

    def _markers(self, topic: str, header: Any, shown: Ellipsoids) -> Message:
        marker, seconds = self._types["visualization_msgs/msg/Marker"], self._types["builtin_interfaces/msg/Duration"]
        texture = self._types["sensor_msgs/msg/CompressedImage"](header, "", np.zeros(0, np.uint8))
        mesh = self._types["visualization_msgs/msg/MeshFile"]("", np.zeros(0, np.uint8))

        def one(k: int, action: int, pose: Any, scale: Sequence[float], color: Any, text: str) -> Any:
            size = self._types["geometry_msgs/msg/Vector3"](*map(float, scale))
            rest: tuple[Any, ...] = (seconds(0, 0), False, [], [], "", texture, [], text, "", mesh, False)
            return marker(header, "elements", k, SPHERE, action, pose, size, color, *rest)

        nowhere, clear = self._pose((0, 0, 0), (0, 0, 0, 1)), self._color((0, 0, 0))
        drawn = [one(0, DELETE_ALL, nowhere, (0, 0, 0), clear, "")]
        for k, (center, half, q, color, label) in enumerate(_rows(shown)):
            drawn.append(one(k, ADD, self._pose(center, q), 2 * half, self._color(color, 0.5), label))
        return self._message(topic, "visualization_msgs/msg/MarkerArray", drawn, part=VIEW)

    def _detections(self, topic: str, header: Any, ids: list[str], columns: Any, shown: Ellipsoids) -> Message:
        """Detections in space, of elements by class and confidence; of a query's hits by rank and score."""
        names = columns.get("label", columns.get("reason", ids))
        scores = columns.get("confidence", columns.get("rank_score"))
        detections = []
        for k, (center, half, q, _, _) in enumerate(_rows(shown)):
            size = self._types["geometry_msgs/msg/Vector3"](*map(float, 2 * half))
            box = self._types["vision_msgs/msg/BoundingBox3D"](self._pose(center, q), size)
            results = [self._hypothesis(names[k], float(scores[k]), center, q)]
            detections.append(self._types["vision_msgs/msg/Detection3D"](header, results, box, ids[k]))
        return self._message(topic, "vision_msgs/msg/Detection3DArray", header, detections, part=VIEW)

    def _cloud(self, topic: str, header: Any, cloud: Cloud) -> Message:
        n = len(cloud.points)
        red, green, blue = cloud.colors.astype(np.uint32).T
        rows = np.empty((n, 4), np.float32)
        rows[:, :3] = cloud.points
        rows[:, 3] = (red << 16 | green << 8 | blue).astype(np.uint32).view(np.float32)  # as PCL packs it
        field = self._types["sensor_msgs/msg/PointField"]
        fields = [field(name, 4 * k, 7, 1) for k, name in enumerate(("x", "y", "z", "rgb"))]
        shape = (1, n, fields, False, 16, 16 * n)
        return self._message(
            topic, "sensor_msgs/msg/PointCloud2", header, *shape, rows.reshape(-1).view(np.uint8), True
        )

    def _hypothesis(self, name: str, score: float, position: Sequence[float], q: Sequence[float]) -> Any:
        pose = self._types["geometry_msgs/msg/PoseWithCovariance"](self._pose(position, q), np.zeros(36))
        guess = self._types["vision_msgs/msg/ObjectHypothesis"](name, score)
        return self._types["vision_msgs/msg/ObjectHypothesisWithPose"](guess, pose)

    def _pose(self, position: Sequence[float], q: Sequence[float]) -> Any:
        point = self._types["geometry_msgs/msg/Point"](*map(float, position))
        return self._types["geometry_msgs/msg/Pose"](point, self._types["geometry_msgs/msg/Quaternion"](*map(float, q)))

    def _point(self, x: float, y: float) -> Any:
        return self._types["geometry_msgs/msg/Point"](float(x), float(y), 0.0)

    def _points(self, xy: Float64) -> list[Any]:
        return [self._point(x, y) for x, y in xy.tolist()]

    def _color(self, rgb: Sequence[int], alpha: float = 1.0) -> Any:
        return self._types["std_msgs/msg/ColorRGBA"](*(c / 255 for c in rgb[:3]), alpha)


def _rows(shown: Ellipsoids) -> Iterator[tuple[Any, Any, Any, tuple[int, int, int], str]]:
    return zip(shown.centers, shown.half_sizes, shown.quaternions, shown.colors, shown.labels, strict=True)


def _ros_type(column: Column) -> str:
    if isinstance(column, tuple):
        return "string"
    return NUMBERS.get(column.dtype.str[1:]) or column.dtype.name


def _flat(column: Column) -> list[str] | NDArray[Any]:
    return list(column) if isinstance(column, tuple) else np.ascontiguousarray(column).reshape(-1)
