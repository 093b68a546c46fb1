"""Foxglove's schemas: a log in Protobuf or JSON gives the frames of its ROS twin."""

import base64
import json

import cv2
import numpy as np
import pytest
from mcap.writer import Writer
from test_bag import COLOURS, DEPTH, DEPTHS, INFO, OPTICAL, RGB, STAMPS, at, images, made, read

import bags
from bags import Messages
from vlmm_log.types import Frame, InputError, Skipped

POSES = {"FrameTransform": "/tf", "FrameTransforms": "/tf", "PoseInFrame": "/pose"}
# https://github.com/foxglove/foxglove-sdk/tree/main/schemas/proto: field -> (number, type); a list is a repeated field.
FIELDS = {
    "Vector3": {"x": (1, "double"), "y": (2, "double"), "z": (3, "double")},
    "Quaternion": {"x": (1, "double"), "y": (2, "double"), "z": (3, "double"), "w": (4, "double")},
    "Pose": {"position": (1, "Vector3"), "orientation": (2, "Quaternion")},
    "PoseInFrame": {"timestamp": (1, "Timestamp"), "frame_id": (2, "string"), "pose": (3, "Pose")},
    "FrameTransform": {
        "timestamp": (1, "Timestamp"),
        "parent_frame_id": (2, "string"),
        "child_frame_id": (3, "string"),
        "translation": (4, "Vector3"),
        "rotation": (5, "Quaternion"),
    },
    "FrameTransforms": {"transforms": (1, ["FrameTransform"])},
    "CameraCalibration": {
        "timestamp": (1, "Timestamp"),
        "width": (2, "fixed32"),
        "height": (3, "fixed32"),
        "distortion_model": (4, "string"),
        "D": (5, ["double"]),
        "K": (6, ["double"]),
        "R": (7, ["double"]),
        "P": (8, ["double"]),
        "frame_id": (9, "string"),
    },
    "RawImage": {
        "timestamp": (1, "Timestamp"),
        "width": (2, "fixed32"),
        "height": (3, "fixed32"),
        "encoding": (4, "string"),
        "step": (5, "fixed32"),
        "data": (6, "bytes"),
        "frame_id": (7, "string"),
    },
    "CompressedImage": {
        "timestamp": (1, "Timestamp"),
        "data": (2, "bytes"),
        "format": (3, "string"),
        "frame_id": (4, "string"),
    },
}


def descriptors():
    """The schemas as a FileDescriptorSet, with Google's Timestamp."""
    pb2 = pytest.importorskip("google.protobuf.descriptor_pb2", reason="protobuf is not installed")
    from google.protobuf import timestamp_pb2

    field = pb2.FieldDescriptorProto
    file = pb2.FileDescriptorProto(name="foxglove.proto", package="foxglove", syntax="proto3")
    file.dependency.append("google/protobuf/timestamp.proto")
    for name, fields in FIELDS.items():
        message = file.message_type.add(name=name)
        for key, (number, kind) in fields.items():
            label = field.LABEL_REPEATED if isinstance(kind, list) else field.LABEL_OPTIONAL
            kind = kind[0] if isinstance(kind, list) else kind
            if kind in ("double", "fixed32", "string", "bytes"):
                message.field.add(name=key, number=number, label=label, type=getattr(field, f"TYPE_{kind.upper()}"))
            else:
                full = ".google.protobuf.Timestamp" if kind == "Timestamp" else f".foxglove.{kind}"
                message.field.add(name=key, number=number, label=label, type=field.TYPE_MESSAGE, type_name=full)
    times = pb2.FileDescriptorProto()
    timestamp_pb2.DESCRIPTOR.CopyToProto(times)
    return pb2.FileDescriptorSet(file=[file, times])


def protobuf_messages():
    pytest.importorskip("google.protobuf", reason="protobuf is not installed")
    from google.protobuf import descriptor_pool, json_format, message_factory

    files = descriptors()
    pool = descriptor_pool.DescriptorPool()
    for file in reversed(files.file):
        pool.Add(file)

    def data(name, fields):
        message = message_factory.GetMessageClass(pool.FindMessageTypeByName(f"foxglove.{name}"))()
        text = json.dumps(json_ready(fields, "protobuf"))
        return json_format.Parse(text, message).SerializeToString()

    return "protobuf", lambda name: files.SerializeToString(), data


def json_messages():
    def definition(name):
        kinds = {"bytes": {"type": "string", "contentEncoding": "base64"}}
        properties = {key: kinds.get(str(kind), {}) for key, (_, kind) in FIELDS[name].items()}
        return json.dumps({"title": name, "type": "object", "properties": properties}).encode()

    return "jsonschema", definition, lambda name, fields: json.dumps(json_ready(fields, "json")).encode()


def json_ready(value, encoding):
    """As both spell it in JSON, but for the time, an (s, ns) pair here."""
    match value:
        case dict():
            return {key: json_ready(v, encoding) for key, v in value.items()}
        case list():
            return [json_ready(v, encoding) for v in value]
        case bytes():
            return base64.b64encode(value).decode()
        case (sec, nsec):
            text = np.datetime_as_string(np.datetime64(sec * 10**9 + nsec, "ns"))
            return f"{text}Z" if encoding == "protobuf" else {"sec": sec, "nsec": nsec}
        case _:
            return value


MESSAGES = {"protobuf": protobuf_messages, "json": json_messages}


def write(path, encoding, records):
    """An MCAP file of (topic, log_ns, schema, fields); its path."""
    language, definition, data = MESSAGES[encoding]()
    channels = {}
    with path.open("wb") as f:
        writer = Writer(f, chunk_size=16_000)
        writer.start()
        for topic, log_ns, name, fields in records:
            if topic not in channels:
                schema = writer.register_schema(f"foxglove.{name}", language, definition(name))
                channels[topic] = writer.register_channel(topic, encoding, schema)
            raw = fields if isinstance(fields, bytes) else data(name, fields)
            writer.add_message(channels[topic], log_ns, raw, log_ns)
        writer.finish()
    return path


def time(stamp_ns):
    return divmod(stamp_ns, 10**9)


def raw_image(stamp_ns, pixels, encoding):
    data = pixels.tobytes()
    size = {"width": pixels.shape[1], "height": pixels.shape[0], "step": len(data) // len(pixels)}
    return {"timestamp": time(stamp_ns), "frame_id": OPTICAL, "encoding": encoding, **size, "data": data}


def png(stamp_ns, pixels):
    data = cv2.imencode(".png", pixels[..., ::-1] if pixels.ndim == 3 else pixels)[1].tobytes()
    return {"timestamp": time(stamp_ns), "frame_id": OPTICAL, "format": "png", "data": data}


def calibration(stamp_ns):
    k = list(bags.K)
    p = [*k[:3], 0.0, *k[3:6], 0.0, *k[6:], 0.0]
    lens = {"distortion_model": "plumb_bob", "D": [0.0] * 5, "K": k, "R": np.eye(3).reshape(-1).tolist(), "P": p}
    return {"timestamp": time(stamp_ns), "frame_id": OPTICAL, "width": 64, "height": 48, **lens}


def placed(stamp_ns, name):
    v = at(stamp_ns)
    p, q = dict(zip("xyz", v[:3], strict=True)), dict(zip("xyzw", v[3:], strict=True))
    if name == "PoseInFrame":
        return {"timestamp": time(stamp_ns), "frame_id": "world", "pose": {"position": p, "orientation": q}}
    frames = {"parent_frame_id": "world", "child_frame_id": OPTICAL}
    transform = {"timestamp": time(stamp_ns), **frames, "translation": p, "rotation": q}
    return transform if name == "FrameTransform" else {"transforms": [transform]}


def records(pose="FrameTransform"):
    for stamp, colour, depth in zip(STAMPS, COLOURS, DEPTHS, strict=True):
        yield POSES[pose], stamp, pose, placed(stamp, pose)
        yield RGB, stamp, "RawImage", raw_image(stamp, colour, "rgb8")
        yield DEPTH, stamp, "RawImage", raw_image(stamp, depth, "16UC1")
        yield INFO, stamp, "CameraCalibration", calibration(stamp)


def encoded(records):
    """The same with PNGs for bare pixels; Foxglove's format says of both but "png"."""
    for (topic, log_ns, name, fields), k in zip(records, range(1000), strict=False):
        if name == "RawImage":
            yield topic, log_ns, "CompressedImage", png(log_ns, (COLOURS if topic == RGB else DEPTHS)[k // 4])
        else:
            yield topic, log_ns, name, fields


def twin(tmp_path):
    """The frames of the ROS 2 log that says the same."""
    m = Messages("mcap")
    poses = (("/tf", t, m.tf(t, ("world", OPTICAL, at(t)))) for t in STAMPS)
    return read(made(tmp_path, "mcap", images(m, latency_ns=0), poses))[0]


def assert_equal_frames(frames, expected):
    assert len(frames) == len(expected) == len(STAMPS)
    for f, e in zip(frames, expected, strict=True):
        assert (f.stamp_ns, f.index) == (e.stamp_ns, e.index)
        np.testing.assert_array_equal(f.rgb, e.rgb)
        np.testing.assert_array_equal(f.depth, e.depth)
        np.testing.assert_array_equal(f.K, e.K)
        np.testing.assert_allclose(f.T_world_cam, e.T_world_cam, atol=1e-12)


@pytest.mark.parametrize("encoding", MESSAGES)
@pytest.mark.parametrize("pose", POSES)
def test_frames_are_those_of_the_ros_twin(tmp_path, encoding, pose):
    frames, left_out = read(write(tmp_path / "foxglove.mcap", encoding, records(pose)))
    assert_equal_frames(frames, twin(tmp_path))
    assert not left_out


@pytest.mark.parametrize("encoding", MESSAGES)
def test_a_png_of_16_grey_bits_is_depth(tmp_path, encoding):
    frames, left_out = read(write(tmp_path / "foxglove.mcap", encoding, encoded(records())))
    assert_equal_frames(frames, twin(tmp_path))
    assert not left_out
    np.testing.assert_array_equal(cv2.imdecode(np.frombuffer(frames[0].encoded_depth.data, np.uint8), -1), DEPTHS[0])


@pytest.mark.parametrize("value", [b"1e400", b"-1", b"null", b'"wide"', b"[]", b'{"a": 1}'])
@pytest.mark.parametrize("topic", [RGB, DEPTH, INFO, "/tf"])
@pytest.mark.parametrize("which", ["one", "all"])
def test_json_of_other_kinds_is_left_out_or_refused(tmp_path, topic, value, which):
    _, _, data = json_messages()
    wrong = []
    for name_of, log_ns, name, fields in records():
        raw = data(name, fields)
        if name_of == topic and (which == "all" or log_ns == STAMPS[2]):
            for key in ("width", "step", "D", "timestamp", "translation"):
                if key in fields:
                    written = json.dumps({key: json_ready(fields[key], "json")})[1:-1].encode()
                    assert written in raw
                    raw = raw.replace(written, json.dumps(key).encode() + b": " + value)
        wrong.append((name_of, log_ns, name, raw))
    path = write(tmp_path / "odd.mcap", "json", wrong)
    try:
        frames, left_out = read(path)
    except InputError:
        assert which == "all" or topic == INFO
        return
    assert all(isinstance(x, Frame) for x in frames)
    assert all(isinstance(x, Skipped) for x in left_out)
    if which == "one" and topic in (RGB, DEPTH):
        assert STAMPS[2] not in [f.stamp_ns for f in frames]
        assert left_out


def test_a_log_without_tf_has_no_poses(tmp_path):
    frames, _ = read(write(tmp_path / "still.mcap", "json", (r for r in records() if r[0] != "/tf")))
    assert [f.T_world_cam for f in frames] == [None] * len(STAMPS)
