"""ROS messages of both generations: how they are built, and serialised."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from vlmm_log.types import Float64

IMAGE = "sensor_msgs/msg/Image"
COMPRESSED_IMAGE = "sensor_msgs/msg/CompressedImage"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
NUMBER = "std_msgs/msg/Float64"
NS = 1_000_000_000
END_NS = 2**31 * NS  # the first time that is beyond the 32 bits of seconds; ROS 1 has a bit more, rosbags not


@dataclass(frozen=True)
class Placed:
    """A transform: where ``child`` lies in ``parent``."""

    parent: str
    child: str
    position: Float64  # (3,) m
    quaternion: Float64  # (4,) x y z w


@dataclass
class Ros:
    """One generation of ROS. Messages come serialised: as rosserial of ROS 1, or as CDR."""

    version: Literal[1, 2]

    @cached_property
    def store(self) -> Any:
        """rosbags' types: those of Noetic or Jazzy, the last of ROS 1 and a long-term release of ROS 2."""
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        store = get_typestore(Stores.ROS1_NOETIC if self.version == 1 else Stores.ROS2_JAZZY)
        if TRANSFORMS not in store.types:  # tf2_msgs is not among what rosbags knows of ROS 1
            store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms\n", TRANSFORMS))
        return store

    def register(self, definitions: Mapping[str, str]) -> None:
        """Add types: name -> definition, as a .msg file has it."""
        from rosbags.typesys import get_types_from_msg

        for name, text in definitions.items():
            self.store.register(get_types_from_msg(text, name))

    def image(self, header: Any, encoding: str, pixels: NDArray[Any]) -> bytes:
        """sensor_msgs/Image of an array (H, W) or (H, W, 3)."""
        data = np.ascontiguousarray(pixels)
        data = data.astype(data.dtype.newbyteorder("<"), copy=False)
        step = data.strides[0]
        fields = (header, data.shape[0], data.shape[1], encoding, 0, step, data.reshape(-1).view(np.uint8))
        return self.serialised(IMAGE, self.store.types[IMAGE](*fields))

    def compressed_image(self, header: Any, form: str, data: bytes | memoryview) -> bytes:
        """sensor_msgs/CompressedImage."""
        message = self.store.types[COMPRESSED_IMAGE](header, form, np.frombuffer(data, np.uint8))
        return self.serialised(COMPRESSED_IMAGE, message)

    def camera_info(
        self, header: Any, K: Float64, size: tuple[int, int], D: Sequence[float] = (), model: str = "plumb_bob"
    ) -> bytes:
        """sensor_msgs/CameraInfo of a camera (3, 3) px that is not rectified, its images of ``size`` (H, W)."""
        P = np.hstack([K, np.zeros((3, 1))]).ravel()
        roi = self.store.types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
        lens = np.array(D or (0.0,) * 5)
        fields = (header, *size, model, lens, np.asarray(K, np.float64).ravel(), np.eye(3).ravel(), P, 0, 0, roi)
        return self.serialised(CAMERA_INFO, self.store.types[CAMERA_INFO](*fields))

    def transforms(self, stamp_ns: int, count: int, placed: Sequence[Placed]) -> bytes:
        """tf2_msgs/TFMessage."""
        vector, rotation, transform, stamped = (
            self.store.types[f"geometry_msgs/msg/{name}"]
            for name in ("Vector3", "Quaternion", "Transform", "TransformStamped")
        )
        listed = [
            stamped(
                self.header(stamp_ns, p.parent, count),
                p.child,
                transform(vector(*map(float, p.position)), rotation(*map(float, p.quaternion))),
            )
            for p in placed
        ]
        return self.serialised(TRANSFORMS, self.store.types[TRANSFORMS](listed))

    def number(self, value: float) -> bytes:
        """std_msgs/Float64."""
        return self.serialised(NUMBER, self.store.types[NUMBER](value))

    def header(self, stamp_ns: int, frame: str, count: int) -> Any:
        """std_msgs/Header; ROS 1 also counts a topic's messages in it."""
        stamp = self.store.types["builtin_interfaces/msg/Time"](stamp_ns // NS, stamp_ns % NS)
        numbered = (count,) if self.version == 1 else ()
        return self.store.types["std_msgs/msg/Header"](*numbered, stamp, frame)

    def definition(self, type_name: str) -> str:
        """The type's message definition, with those of the types in it."""
        return str(self.store.generate_msgdef(type_name, ros_version=self.version)[0])

    def serialised(self, type_name: str, message: object) -> bytes:
        """A message of the store's types as bytes."""
        serialise = self.store.serialize_ros1 if self.version == 1 else self.store.serialize_cdr
        return bytes(serialise(message, type_name))
