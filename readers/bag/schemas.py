"""Decoders of messages: a payload and its schema become an object with the fields as attributes."""

from __future__ import annotations

import base64
import binascii
import importlib
import json
import re
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from types import SimpleNamespace
from typing import Any

from vlmm_log.readers.bag.containers import MessageError

Decoder = Callable[[bytes], object]
ROS_SCHEMAS = ("ros1msg", "ros2msg", "ros2idl", "omgidl")
IDL_RULE = "=" * 80 + "\n"


@dataclass(frozen=True)
class Schema:
    """What a container says about the messages of a channel."""

    type: str
    encoding: str  # of the messages: "ros1", "cdr", "json", "protobuf"
    language: str  # of the definition: "ros1msg", "ros2msg", "ros2idl", "omgidl", "jsonschema", "protobuf"; "": none
    definition: bytes


def type_name(name: str, encoding: str, language: str) -> str:
    """The ROS 2 spelling of a ROS type, "sensor_msgs/msg/Image"; any other name as it is."""
    from rosbags.typesys.msg import normalize_msgtype

    is_ros = encoding == "ros1" or language in ROS_SCHEMAS or (encoding == "cdr" and "/" in name)
    return normalize_msgtype(name.replace("::", "/")) if is_ros and name else name


@cache
def decoder(schema: Schema) -> Decoder:
    """Decodes payloads of a schema, and raises MessageError where that fails. The schema is read at first use."""

    def decode(raw: bytes) -> object:
        if not raw:
            raise MessageError("message is empty")
        return _decoder_read(schema)(raw)

    return decode


@cache
def _decoder_read(schema: Schema) -> Decoder:
    match schema.encoding:
        case "cdr" | "ros1":
            return _ros_decoder(schema)
        case "json":
            return _json_decoder(schema)
        case "protobuf":
            return _protobuf_decoder(schema)
        case other:
            return _refusing(f"message encoding {other!r} is not read")


def _refusing(reason: str) -> Decoder:
    def refuse(_: bytes) -> object:
        raise MessageError(reason)

    return refuse


# What generated code raises on bytes that are no such message, besides the library's own errors.
GARBAGE = (
    *(ValueError, LookupError, ArithmeticError, TypeError, AttributeError, AssertionError, struct.error, MemoryError),
    *(RuntimeError, SyntaxError),  # a type that holds itself, a name of digits
)
MOST_UNROLLED = 4096  # texts or messages in an array of fixed length: generated code has a line for each


def _ros_decoder(schema: Schema) -> Decoder:
    """By the definition in the file; by the distribution's own where the file has none."""
    from rosbags.serde import SerdeError
    from rosbags.typesys import Stores, TypesysError, get_typestore

    latest = get_typestore(Stores.ROS1_NOETIC if schema.encoding == "ros1" else Stores.ROS2_JAZZY)
    store = latest
    if schema.language and schema.definition.strip():
        store = get_typestore(Stores.EMPTY)
        try:
            found = _definitions(schema)
            _check_lengths(found)
            store.register(_completed(found, latest.fielddefs))
        except (TypesysError, *GARBAGE):
            return _refusing("message definition cannot be read")
    if schema.type not in store.fielddefs:
        return _refusing("type has no definition, neither in the file nor known")
    read = store.deserialize_ros1 if schema.encoding == "ros1" else store.deserialize_cdr

    def decode(raw: bytes) -> object:
        try:
            return read(raw, schema.type)
        except (SerdeError, TypesysError, *GARBAGE) as e:
            raise MessageError("message does not match its definition") from e

    return decode


def _definitions(schema: Schema) -> dict[str, Any]:
    """Types of a definition: the type itself and those that it is made of."""
    from rosbags.typesys import get_types_from_idl, get_types_from_msg

    text = schema.definition.decode()
    if schema.language in ("ros1msg", "ros2msg"):
        return dict(get_types_from_msg(text, schema.type))
    _check_idl(text)
    if not text.startswith(f"{IDL_RULE}IDL: "):
        return dict(get_types_from_idl(text))
    found: dict[str, Any] = {}
    for part in text.split(IDL_RULE)[1:]:
        found |= get_types_from_idl(part.split("\n", 1)[1])
    return found


def _check_idl(text: str) -> None:
    """Raises ValueError for an IDL that computes: a shift makes numbers of any size, brackets take ages to parse."""
    bare = re.sub(r'"(?:\\.|[^"\\])*"', "", text)
    if "<<" in bare or re.search(r"\([^)]*\(", bare):
        raise ValueError("an IDL that computes")


def _check_lengths(found: Mapping[str, Any]) -> None:
    """Raises ValueError for arrays of so many texts or messages that no code can be generated for them."""
    from rosbags.interfaces import Nodetype

    for _, fields in found.values():
        for _, (kind, of) in fields:
            if kind == Nodetype.ARRAY and of[1] > MOST_UNROLLED and not _is_number(of[0]):
                raise ValueError(f"array of {of[1]} elements")


def _is_number(desc: Any) -> bool:
    return isinstance(desc[1], tuple) and desc[1][0] not in ("string", "wstring")


def _completed(found: dict[str, Any], known: Mapping[str, Any]) -> dict[str, Any]:
    """The definitions, and those that they name without spelling them out. Raises LookupError for an unknown name."""

    def named(desc: Any) -> Any:
        while isinstance(desc[1], tuple) and isinstance(desc[1][0], tuple):  # an array's element
            desc = desc[1][0]
        return desc[1]  # a type's name, or a tuple for a primitive

    found = dict(found)
    unread = list(found)
    while unread:
        names = {named(desc) for _, desc in found[unread.pop()][1]}
        missing = {name for name in names if isinstance(name, str)} - found.keys()
        found |= {name: known[name] for name in missing}
        unread += missing
    return found


def _json_decoder(schema: Schema) -> Decoder:
    """Objects become namespaces; strings that the JSON schema calls base64 become bytes."""
    try:
        shape = json.loads(schema.definition) if schema.definition.strip() else {}
    except (ValueError, RecursionError):
        return _refusing("message definition cannot be read")

    def decode(raw: bytes) -> object:
        try:
            return _namespace(json.loads(raw), shape)
        except binascii.Error as e:
            raise MessageError("base64 in a JSON message cannot be decoded") from e
        except (ValueError, RecursionError) as e:
            raise MessageError("message is no JSON") from e

    return decode


def _namespace(value: Any, shape: Any) -> Any:
    shape = shape if isinstance(shape, dict) else {}
    match value:
        case dict():
            fields = shape.get("properties")
            fields = fields if isinstance(fields, dict) else {}
            return SimpleNamespace(**{name: _namespace(v, fields.get(name)) for name, v in value.items()})
        case list():
            return [_namespace(v, shape.get("items")) for v in value]
        case str() if shape.get("contentEncoding") == "base64":
            return base64.b64decode(value, validate=True)
        case _:
            return value


def _protobuf_decoder(schema: Schema) -> Decoder:
    """By the FileDescriptorSet in the file, with its own pool, so that files cannot disturb each other."""
    try:
        pb2 = importlib.import_module("google.protobuf.descriptor_pb2")
        pools = importlib.import_module("google.protobuf.descriptor_pool")
        factory = importlib.import_module("google.protobuf.message_factory")
        errors = importlib.import_module("google.protobuf.message")
    except ImportError:
        return _refusing("protobuf is not installed: pip install 'vlmm-log[foxglove]'")
    try:
        files = {f.name: f for f in pb2.FileDescriptorSet.FromString(schema.definition).file}
        pool = pools.DescriptorPool()
        while files:  # files may stand in any order, the pool wants what they import first
            ready = [f for f in files.values() if not files.keys() & set(f.dependency)]
            for f in ready or files.values():
                pool.Add(f)
            files = {} if not ready else {n: f for n, f in files.items() if f not in ready}
        message = factory.GetMessageClass(pool.FindMessageTypeByName(schema.type))
    except (errors.DecodeError, *GARBAGE):
        return _refusing("message definition cannot be read")

    def decode(raw: bytes) -> object:
        try:
            return message.FromString(raw)
        except errors.DecodeError as e:
            raise MessageError("message does not match its definition") from e

    return decode
