"""Entries as Rerun's archetypes."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any, assert_never

import numpy as np
import pyarrow as pa
import rerun as rr

from vlmm_log.elements import CLASS_COLORS, MotionClass
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
    Value,
)
from vlmm_log.sinks.columns import RVL, Columns, blobs, tensors
from vlmm_log.sinks.map_entries import id_color
from vlmm_log.sinks.pair_entries import LOOKS, Range
from vlmm_log.types import EncodedImage

STATE_COLORS = {  # fused class, and what an element does at present
    **{kind.name.lower(): color for kind, color in CLASS_COLORS.items()},
    "still": (90, 90, 90),
    "moves": CLASS_COLORS[MotionClass.MOVING],
    "unseen": (40, 40, 40),
}


class RerunValues:
    """Logs entries to a stream, each below ``prefix``. Small values wait for ``flush``."""

    def __init__(self, rec: rr.RecordingStream, prefix: str = "", looks: Mapping[str, Range] = LOOKS) -> None:
        self._rec, self._prefix = rec, prefix
        self._columns = Columns(rec)
        self._at: tuple[int | None, int | None] = (None, None)
        self._untold = dict(looks)
        rec.set_log_time_enabled(False)  # nothing but the input decides what is written

    def put(self, entry: Entry) -> None:
        """Log one entry."""
        entity = self._prefix + entry.entity
        if entry.entity in self._untold:
            self._rec.log(entity, _look(entry.value, self._untold.pop(entry.entity)), static=True)
        if self._columns.take(entity, entry):
            return
        if entry.stamp_ns is not None:
            self._set_time(entry.stamp_ns, entry.index)
        shown = archetypes(entry.value)
        if shown:
            self._rec.log(entity, *shown, static=entry.stamp_ns is None)

    def flush(self, least: int = 1) -> None:
        """Send what waits; of scalars and states, what has at least so many rows."""
        self._columns.flush(least)

    def _set_time(self, stamp_ns: int, index: int | None) -> None:
        if (stamp_ns, index) == self._at:
            return
        self._at = (stamp_ns, index)
        if index is None:
            self._rec.disable_timeline("frame")
        else:
            self._rec.set_time("frame", sequence=index)
        self._rec.set_time("time", timestamp=np.datetime64(stamp_ns, "ns"))


def _look(value: Value, look: Range) -> Any:
    """Range and colours of a dense field."""
    low, high, colors = look
    if isinstance(value, DepthMap):
        kind = rr.EncodedDepthImage if isinstance(value.stored, EncodedImage) else rr.DepthImage
        return kind.from_fields(
            colormap=colors, depth_range=[low * value.units_per_meter, high * value.units_per_meter]
        )
    if isinstance(value, Steps):  # the media type here too, or the viewer warns of what it cannot guess
        steps = [low / value.step, high / value.step]
        return rr.EncodedDepthImage.from_fields(
            meter=1 / value.step, colormap=colors, depth_range=steps, media_type=RVL
        )
    return rr.DepthImage.from_fields(meter=1.0, colormap=colors, depth_range=[low, high])


def archetypes(value: Value) -> list[Any]:
    """What Rerun logs of a value."""
    match value:
        case Picture(data, media_type):
            return [rr.EncodedImage(contents=blobs(data), media_type=media_type)]
        case DepthMap(stored, units):
            if isinstance(stored, EncodedImage):
                return [rr.EncodedDepthImage(blob=blobs(stored.data), media_type=stored.media_type, meter=units)]
            return [rr.DepthImage(stored, meter=units)]
        case Steps(image, step):
            return [rr.EncodedDepthImage(blob=blobs(image), media_type=RVL, meter=1 / step)]
        case Raster(values, ()):
            return [rr.DepthImage(values)]
        case Raster():
            return [rr.Tensor.from_fields(data=tensors(value))]
        case Labels(values):
            form = _format(values.dtype.str, *values.shape)
            return [rr.SegmentationImage.from_fields(buffer=blobs(values), format=form)]
        case LabelNames(classes):
            return [rr.AnnotationContext(list(classes))]
        case Pose(translation, quaternion):
            return [rr.Transform3D(translation=translation, quaternion=rr.Quaternion(xyzw=quaternion))]
        case Camera(K, width, height):
            axes = rr.ViewCoordinates.RDF
            return [rr.Pinhole(image_from_camera=K, resolution=[width, height], camera_xyz=axes)]
        case Arrows(origins, vectors, color):
            return [rr.Arrows2D(origins=origins, vectors=vectors, colors=color)]
        case Boxes():
            return [_boxes(value)]
        case Table(columns, shown):
            return _table(columns, len(value), shown)
        case Cloud(points, colors, radius):
            return [rr.Points3D(points, colors=colors, radii=radius)]
        case Scalar(number):
            return [rr.Scalars(number)]
        case LogLine(text, level):
            return [rr.TextLog(text, level=level)]
        case States(lanes):
            return [rr.StateChange(state=list(lanes))]
        case StateNames(label):
            return [_state_names(label)]
        case Look():
            return []
        case _:
            assert_never(value)


@cache
def _format(kind: str, height: int, width: int) -> pa.Array:
    """An image format as Rerun's array: made once."""
    datatype = rr.ChannelDatatype.from_np_dtype(np.dtype(kind))
    form = rr.components.ImageFormat(width=width, height=height, channel_datatype=datatype)
    return rr.components.ImageFormatBatch(form).as_arrow_array()


def _boxes(boxes: Boxes) -> rr.Boxes2D:
    labels = [f"{i} {name}".strip() for i, name in zip(boxes.ids, boxes.names, strict=True)]
    colors = [id_color(int(i)) for i in boxes.ids]
    return rr.Boxes2D(array=boxes.corners, array_format=rr.Box2DFormat.XYXY, labels=labels, colors=colors)


def _table(columns: Any, rows: int, shown: Ellipsoids | None) -> list[Any]:
    if not rows and shown is None:
        return [rr.Clear(recursive=False)]  # empty columns alone would leave the last rows in sight
    ellipsoids = [] if shown is None else [_ellipsoids(shown)]
    return [*ellipsoids, rr.AnyValues(**{name: _arrow(column) for name, column in columns.items()})]


def _arrow(column: Column) -> Any:
    """A column that Rerun keeps; one of several numbers a row as fixed-size lists."""
    if isinstance(column, tuple):
        return pa.array(column, pa.utf8())
    if column.ndim == 2:
        return pa.FixedSizeListArray.from_arrays(pa.array(np.ascontiguousarray(column).ravel()), column.shape[1])
    return column


def _ellipsoids(shown: Ellipsoids) -> rr.Ellipsoids3D:
    return rr.Ellipsoids3D(
        centers=shown.centers,
        half_sizes=shown.half_sizes,
        quaternions=shown.quaternions,
        colors=np.array(shown.colors, np.uint8).reshape(-1, 3),
        labels=list(shown.labels),
        show_labels=None if shown.labelled else False,
    )


def _state_names(label: str) -> rr.StateConfiguration:
    """Colours of the states; the class's lane tells what the element is, too."""
    told = [f"{label}: {name}" if label and name not in ("still", "moves", "unseen") else name for name in STATE_COLORS]
    return rr.StateConfiguration(values=list(STATE_COLORS), labels=told, colors=list(STATE_COLORS.values()))
