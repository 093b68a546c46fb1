"""What messages say: stamps, images, cameras and poses, whether ROS 1, ROS 2 or Foxglove wrote them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from vlmm_log.readers.bag.containers import MessageError
from vlmm_log.readers.intrinsics import Intrinsics, checked
from vlmm_log.readers.stamps import LATEST_NS
from vlmm_log.readers.stored import StoredImage
from vlmm_log.types import Float64, InputError

RAW_IMAGES = {"sensor_msgs/msg/Image", "foxglove.RawImage", "foxglove_msgs/msg/RawImage"}
ENCODED_IMAGES = {"sensor_msgs/msg/CompressedImage", "foxglove.CompressedImage", "foxglove_msgs/msg/CompressedImage"}
IMAGES = RAW_IMAGES | ENCODED_IMAGES
CAMERAS = {"sensor_msgs/msg/CameraInfo", "foxglove.CameraCalibration", "foxglove_msgs/msg/CameraCalibration"}
TRANSFORMS = {
    "tf2_msgs/msg/TFMessage",
    "tf/msg/tfMessage",
    "foxglove.FrameTransform",
    "foxglove.FrameTransforms",
    "foxglove_msgs/msg/FrameTransform",
    "foxglove_msgs/msg/FrameTransforms",
}
POSES = {
    "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/TransformStamped",
    "nav_msgs/msg/Path",
    "foxglove.PoseInFrame",
    "foxglove_msgs/msg/PoseInFrame",
}
# Of messages that lack a field, or hold something else in it; JSON holds infinities too.
UNREADABLE = (AttributeError, ValueError, TypeError, OverflowError)
MODELS = {"": "plumb_bob", "plumb_bob": "plumb_bob", "rational_polynomial": "rational_polynomial"}
MODELS |= {"equidistant": "equidistant", "kannala_brandt": "equidistant", "fisheye": "equidistant"}


@dataclass(frozen=True, eq=False)
class Placed:
    """A pose or transform: of ``child`` in ``parent``."""

    stamp_ns: int
    parent: str
    child: str  # "" where the message does not say
    values: Float64  # (7,) x y z m, qx qy qz qw


def stamp_of(message: Any) -> int:
    """The header's stamp, ns. Raises MessageError where there is none."""
    time = getattr(message, "timestamp", None)
    if time is None:
        time = getattr(getattr(message, "header", None), "stamp", None)
    seconds = _first(time, "sec", "seconds", "secs")
    nanos = _first(time, "nanosec", "nanos", "nsec", "nsecs")
    if seconds is None and nanos is None:
        raise MessageError("message has no stamp")
    try:
        stamp_ns = int(seconds or 0) * 1_000_000_000 + int(nanos or 0)
    except (ValueError, TypeError, OverflowError) as e:  # JSON holds what it likes
        raise MessageError("message's stamp is no number") from e
    if abs(stamp_ns) > LATEST_NS:
        raise MessageError("message's stamp is beyond what nanoseconds in 64 bits hold")
    return stamp_ns


def frame_of(message: Any) -> str:
    """The frame that the header names, without a leading slash; "" where it names none."""
    header = getattr(message, "header", None)
    return str(getattr(message if header is None else header, "frame_id", "")).lstrip("/")


def image_of(message: Any, type_name: str) -> StoredImage:
    """The image of a message. Raises MessageError."""
    data = message.data
    data = memoryview(data if isinstance(data, bytes | bytearray) else np.ascontiguousarray(data).data).cast("B")
    if type_name in RAW_IMAGES:
        return StoredImage(
            data,
            str(message.encoding),
            int(message.height),
            int(message.width),
            int(message.step),
            bool(getattr(message, "is_bigendian", False)),
        )
    form = str(message.format)
    if any(video in form.lower() for video in ("h264", "h265", "hevc", "vp9", "av1", "theora")):
        raise MessageError(f"video streams ({form}) are not decoded; export single images")
    return StoredImage(data, form if "compresseddepth" in form.lower() else "")


def camera_of(message: Any, topic: str, image_topic: str) -> Intrinsics:
    """The camera of an image topic: P of a rectified one, else K and the lens distortion, which is not judged here.

    ROS: sensor_msgs/CameraInfo; P is that of the rectified image, K and D those of the raw one. Raises InputError.
    """
    K = _numbers(message, "K", "k", size=9)
    P = _numbers(message, "P", "p", size=12)
    D = np.asarray(_first(message, "D", "d") if _first(message, "D", "d") is not None else [], np.float64)
    words = re.split(r"[^a-z]+", "/".join(image_topic.lower().split("/")[-2:]))
    rectified = "rect" in words or "rectified" in words
    matrix, which = (P.reshape(3, 4)[:, :3], "P") if rectified and P[0] else (K.reshape(3, 3), "K")
    if not matrix[0, 0] or not np.isfinite(matrix).all():
        raise InputError(f"{topic}: camera info without focal length (not calibrated); give --intrinsics fx,fy,cx,cy")
    if matrix[0, 1]:
        raise InputError(
            f"{topic}: camera matrix has a skew of {matrix[0, 1]:g}, which is not undone; give --intrinsics fx,fy,cx,cy"
        )
    named = str(getattr(message, "distortion_model", ""))
    lens, model = ((), "plumb_bob") if rectified or not np.any(D) else (tuple(map(float, D)), MODELS.get(named, named))
    if model == "plumb_bob" and len(lens) == 8:
        model = "rational_polynomial"
    camera = Intrinsics(
        float(matrix[0, 0]),
        float(matrix[1, 1]),
        float(matrix[0, 2]),
        float(matrix[1, 2]),
        int(message.width),
        int(message.height),
        0.0,
        f"{topic} ({which})",
        lens,
        model,
    )
    checked(replace(camera, distortion=()), topic)
    return camera


def transforms_of(message: Any) -> Iterator[Placed]:
    """Every transform of a tf message. Raises MessageError."""
    listed = getattr(message, "transforms", None)
    for t in [message] if listed is None else listed:
        if hasattr(t, "transform"):
            parent, child = frame_of(t), str(t.child_frame_id).lstrip("/")
            yield Placed(stamp_of(t), parent, child, _values(t.transform.translation, t.transform.rotation))
        else:  # Foxglove
            parent, child = str(t.parent_frame_id).lstrip("/"), str(t.child_frame_id).lstrip("/")
            yield Placed(stamp_of(t), parent, child, _values(t.translation, t.rotation))


def poses_of(message: Any) -> Iterator[Placed]:
    """Every pose of an Odometry, PoseStamped, PoseWithCovarianceStamped, TransformStamped, Path or PoseInFrame."""
    if hasattr(message, "poses"):  # Path
        for stamped in message.poses:
            yield from poses_of(stamped)
        return
    if hasattr(message, "transform"):
        yield from transforms_of(message)
        return
    pose = message.pose
    pose = getattr(pose, "pose", pose)  # under a covariance
    child = str(getattr(message, "child_frame_id", "")).lstrip("/")
    yield Placed(stamp_of(message), frame_of(message), child, _values(pose.position, pose.orientation))


def _values(p: Any, q: Any) -> Float64:
    return np.array([p.x, p.y, p.z, q.x, q.y, q.z, q.w], np.float64)


def _first(record: Any, *names: str) -> Any:
    return next((getattr(record, name) for name in names if hasattr(record, name)), None)


def _numbers(message: Any, *names: str, size: int) -> Float64:
    values = np.asarray(_first(message, *names) if _first(message, *names) is not None else [], np.float64)
    return values if values.size == size else np.zeros(size)
