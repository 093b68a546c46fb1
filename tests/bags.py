"""Small bags of every kind, written with the libraries alone: plain functions."""

from functools import cache

import numpy as np
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

KINDS = ("bag", "ros2", "ros2-mcap", "mcap")
ORIGIN_NS = 1_700_000_000_123_456_789
STEP_NS = 33_333_333
K = (60.0, 0.0, 31.5, 0.0, 60.0, 23.5, 0.0, 0.0, 1.0)


@cache
def store(kind):
    types = get_typestore(Stores.ROS1_NOETIC if kind == "bag" else Stores.ROS2_JAZZY)
    if kind == "bag":  # not among the library's own
        text = "geometry_msgs/TransformStamped[] transforms"
        types.register(get_types_from_msg(text, "tf2_msgs/msg/TFMessage"))
    return types


class Messages:
    """ROS messages of one generation."""

    def __init__(self, kind):
        self.ros1 = kind == "bag"
        self.types = store(kind).types

    def make(self, name, **fields):
        return self.types[name](**fields)

    def header(self, stamp_ns, frame):
        time = self.make("builtin_interfaces/msg/Time", sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
        return self.make("std_msgs/msg/Header", **({"seq": 0} if self.ros1 else {}), stamp=time, frame_id=frame)

    def image(self, stamp_ns, frame, pixels, encoding, *, padding=0, big_endian=False):
        rows = pixels.astype(pixels.dtype.newbyteorder(">" if big_endian else "<")).reshape(len(pixels), -1)
        rows = np.ascontiguousarray(rows).view(np.uint8)
        rows = np.pad(rows, ((0, 0), (0, padding)), constant_values=7)
        return self.make(
            "sensor_msgs/msg/Image",
            header=self.header(stamp_ns, frame),
            height=pixels.shape[0],
            width=pixels.shape[1],
            encoding=encoding,
            is_bigendian=int(big_endian),
            step=rows.shape[1],
            data=rows.reshape(-1),
        )

    def compressed(self, stamp_ns, frame, data, form):
        data = np.frombuffer(data, np.uint8)
        return self.make("sensor_msgs/msg/CompressedImage", header=self.header(stamp_ns, frame), format=form, data=data)

    def camera_info(self, stamp_ns, frame, *, size=(64, 48), k=K, p=None, d=(), model="plumb_bob"):
        p = (*k[:3], 0.0, *k[3:6], 0.0, *k[6:], 0.0) if p is None else p
        roi = self.make("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
        arrays = {"d": np.array(d, float), "k": np.array(k), "r": np.eye(3).reshape(-1), "p": np.array(p)}
        return self.make(
            "sensor_msgs/msg/CameraInfo",
            header=self.header(stamp_ns, frame),
            height=size[1],
            width=size[0],
            distortion_model=model,
            **({name.upper(): value for name, value in arrays.items()} if self.ros1 else arrays),
            binning_x=0,
            binning_y=0,
            roi=roi,
        )

    def tf(self, stamp_ns, *links):
        """Of (parent, child, seven numbers)."""
        made = []
        for parent, child, v in links:
            x = self.make("geometry_msgs/msg/Vector3", x=v[0], y=v[1], z=v[2])
            q = self.make("geometry_msgs/msg/Quaternion", x=v[3], y=v[4], z=v[5], w=v[6])
            T = self.make("geometry_msgs/msg/Transform", translation=x, rotation=q)
            head = self.header(stamp_ns, parent)
            made.append(self.make("geometry_msgs/msg/TransformStamped", header=head, child_frame_id=child, transform=T))
        return self.make("tf2_msgs/msg/TFMessage", transforms=made)

    def pose(self, v):
        p = self.make("geometry_msgs/msg/Point", x=v[0], y=v[1], z=v[2])
        q = self.make("geometry_msgs/msg/Quaternion", x=v[3], y=v[4], z=v[5], w=v[6])
        return self.make("geometry_msgs/msg/Pose", position=p, orientation=q)

    def pose_stamped(self, stamp_ns, frame, v):
        return self.make("geometry_msgs/msg/PoseStamped", header=self.header(stamp_ns, frame), pose=self.pose(v))

    def path(self, stamp_ns, frame, stamped):
        return self.make("nav_msgs/msg/Path", header=self.header(stamp_ns, frame), poses=list(stamped))

    def odometry(self, stamp_ns, frame, child, v):
        zero = self.make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
        twist = self.make("geometry_msgs/msg/Twist", linear=zero, angular=zero)
        spread = np.zeros(36)
        return self.make(
            "nav_msgs/msg/Odometry",
            header=self.header(stamp_ns, frame),
            child_frame_id=child,
            pose=self.make("geometry_msgs/msg/PoseWithCovariance", pose=self.pose(v), covariance=spread),
            twist=self.make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=spread),
        )


def write(path, kind, records):
    """A bag of (topic, log_ns, message or bytes, type name or None), in that order; its path."""
    types = store(kind)
    named = [(topic, ns, m, name or m.__msgtype__) for topic, ns, m, name in map(_whole, records)]

    def data(message, name):
        if isinstance(message, bytes):
            return message
        return bytes(types.serialize_ros1(message, name) if kind == "bag" else types.serialize_cdr(message, name))

    if kind == "mcap":
        _write_mcap(path, types, [(topic, ns, data(m, name), name) for topic, ns, m, name in named])
        return path
    plugin = StoragePlugin.MCAP if kind == "ros2-mcap" else StoragePlugin.SQLITE3
    opened = Writer1(path) if kind == "bag" else Writer2(path, version=9, storage_plugin=plugin)
    with opened as writer:
        connections = {}
        for topic, ns, m, name in named:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, name, typestore=types)
            writer.write(connections[topic], ns, data(m, name))
    return path


def _whole(record):
    return (*record, None) if len(record) == 3 else record


def _write_mcap(path, types, records):
    with path.open("wb") as f:
        writer = McapWriter(f, chunk_size=16_000)
        writer.start(profile="ros2", library="test")
        channels = {}
        for topic, ns, data, name in records:
            if topic not in channels:
                text = types.generate_msgdef(name, ros_version=2)[0]
                schema = writer.register_schema(name, "ros2msg", text.encode())
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            writer.add_message(channels[topic], ns, data, ns)
        writer.finish()


def suffixed(folder, kind):
    """Where a bag of a kind would lie."""
    return folder / {"bag": "log.bag", "mcap": "log.mcap", "ros2": "log_ros2", "ros2-mcap": "log_ros2_mcap"}[kind]
