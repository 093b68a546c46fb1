"""What a pair showed, as bytes and back to the bit. Known types alone: such a file may come from anywhere."""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlmm_log import entries
from vlmm_log.elements import OBSERVATION, Instances
from vlmm_log.pipeline.run import Look
from vlmm_log.pipeline.world_map import Still
from vlmm_log.sinks.content import Told
from vlmm_log.sinks.summary import Noted
from vlmm_log.types import Ego, EncodedImage, Features, Segments
from vlmm_log.workers.worker import Looked

VALUES = (v for v in vars(entries).values() if isinstance(v, type) and hasattr(v, "__dataclass_fields__"))
KINDS: Mapping[str, type] = {
    f"{kind.__module__}.{kind.__name__}": kind
    for kind in (*VALUES, Looked, Look, Told, Noted, Ego, Instances, Segments, Features, Still, EncodedImage)
}
HEAD = struct.Struct("<Q")  # bytes of the JSON that comes first; then come the parts
ROWS = "observations"  # the one type of rows
DENSE = 1 << 16  # bytes: labels of an image are mostly repetition


def pack(value: object) -> bytes:
    """Bytes of KINDS, arrays, texts, numbers, tuples, lists and mappings. Raises TypeError for others."""
    parts: list[bytes] = []
    head = json.dumps(_packed(value, parts)).encode()
    return b"".join([HEAD.pack(len(head)), head, *parts])


def unpack(data: bytes) -> Any:
    """What was packed. Arrays are read-only, each in memory of its own. Raises ValueError for what was not."""
    try:
        start = HEAD.size + HEAD.unpack_from(data)[0]
        return _unpacked(json.loads(data[HEAD.size : start]), memoryview(data)[start:])
    except (struct.error, KeyError, TypeError, IndexError, RecursionError, zlib.error) as e:
        raise ValueError(f"not what a run keeps: {e}") from e


def _packed(value: object, parts: list[bytes]) -> object:
    match value:
        case np.ndarray() | np.generic():
            return _packed_array(np.asarray(value), isinstance(value, np.generic), parts)
        case None | bool() | int() | float() | str():
            return value
        case bytes():
            return {"bytes": _put(value, parts)}
        case list():
            return [_packed(item, parts) for item in value]
        case tuple():
            return {"tuple": [_packed(item, parts) for item in value]}
        case Mapping():
            return {"map": [[_packed(key, parts), _packed(item, parts)] for key, item in value.items()]}
    kind = f"{type(value).__module__}.{type(value).__name__}"
    if KINDS.get(kind) is not type(value):
        raise TypeError(f"{kind}: not of the types that a run keeps")
    named = {f.name: _packed(getattr(value, f.name), parts) for f in fields(value) if f.init}  # type: ignore[arg-type]
    return {"kind": kind, "fields": named}


def _packed_array(array: NDArray[Any], scalar: bool, parts: list[bytes]) -> object:
    if array.dtype.hasobject or (array.dtype.names and array.dtype != OBSERVATION):
        raise TypeError(f"an array of {array.dtype}: not of the types that a run keeps")
    turned = array.flags.f_contiguous and not array.flags.c_contiguous  # sums depend on how numbers lie
    data = np.ascontiguousarray(array.T if turned else array).tobytes()
    deflated = len(data) > DENSE and array.dtype.kind in "iu"
    told = {
        "array": _put(zlib.compress(data, 1) if deflated else data, parts),
        "dtype": ROWS if array.dtype.names else array.dtype.str,
        "shape": array.shape,
    }
    marks = {"scalar": scalar, "turned": turned, "deflated": deflated}
    return told | {name: True for name, holds in marks.items() if holds}


def _put(data: bytes, parts: list[bytes]) -> list[int]:
    """First byte and size of a part, which comes behind the others."""
    start = sum(map(len, parts))
    parts.append(data)
    return [start, len(data)]


def _unpacked(value: Any, parts: memoryview) -> Any:
    match value:
        case {"kind": kind, "fields": named}:
            return KINDS[kind](**{name: _unpacked(item, parts) for name, item in named.items()})
        case {"array": _}:
            return _unpacked_array(value, parts)
        case {"bytes": [start, size]}:
            return bytes(parts[start : start + size])
        case {"tuple": items}:
            return tuple(_unpacked(item, parts) for item in items)
        case {"map": items}:
            return {_unpacked(key, parts): _unpacked(item, parts) for key, item in items}
        case list():
            return [_unpacked(item, parts) for item in value]
        case _:
            return value


def _unpacked_array(told: Mapping[str, Any], parts: memoryview) -> Any:
    start, size = told["array"]
    dtype = OBSERVATION if told["dtype"] == ROWS else np.dtype(told["dtype"])
    data = parts[start : start + size]
    whole = np.frombuffer(zlib.decompress(data) if told.get("deflated") else bytes(data), dtype)
    shape = told["shape"]
    array = whole.reshape(shape[::-1]).T if told.get("turned") else whole.reshape(shape)
    return array[()] if told.get("scalar") else array
