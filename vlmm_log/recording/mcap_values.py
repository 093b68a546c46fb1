"""Messages of an MCAP recording as values: by their schema those of ROS or of Foxglove. Images are alike in both."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlmm_log.entries import DepthMap, Labels, Picture, Raster, Value
from vlmm_log.readers.bag.schemas import Schema
from vlmm_log.recording import foxglove_messages, ros_messages

Parts = dict[str, Any]
"""Part -> message: "" where one message holds the whole value."""

Reader = Callable[[Any], Value]

CHANNELS = (("",), ("u", "v"), ("x", "y", "z"), ("xx", "xy", "xz", "yy", "yz", "zz"))  # parts that make a value
PIXELS = {"32FC1": "<f4", "16UC1": "<u2", "mono16": "<u2", "mono8": "u1"}


def parts_with(part: str) -> tuple[str, ...]:
    """All parts of a value, by one of them."""
    return next((parts for parts in CHANNELS if part in parts), (part,))


def value(kind: str, schema: Schema, parts: Parts) -> Value:
    """A value of all its messages. Raises ValueError, LookupError, AttributeError or TypeError where it is damaged."""
    if "" in parts:
        return _readers(schema)[kind](parts[""])
    names = parts_with(next(iter(parts)))
    return Raster(np.stack([_pixels(parts[name]) for name in names]), names)


@cache
def _readers(schema: Schema) -> Mapping[str, Reader]:
    """Kind of value -> how it is read from a message."""
    match schema.encoding:
        case "cdr":
            return {**IMAGES, **ros_messages.READERS}
        case "json":
            return foxglove_messages.json_readers(schema.definition)
        case _:
            return {**IMAGES, **foxglove_messages.READERS}


def _pixels(message: Any) -> NDArray[Any]:
    pixels = np.frombuffer(message.data, PIXELS[message.encoding])
    return pixels.reshape(int(message.height), int(message.width))


def _picture(message: Any) -> Picture:
    return Picture(bytes(message.data), f"image/{message.format}")


def _depth(message: Any) -> DepthMap:
    return DepthMap(_pixels(message), 1000.0 if message.encoding == "16UC1" else 1.0)


IMAGES: Mapping[str, Reader] = {
    "Picture": _picture,
    "DepthMap": _depth,
    "Raster": lambda message: Raster(_pixels(message)),
    "Labels": lambda message: Labels(_pixels(message)),
}
