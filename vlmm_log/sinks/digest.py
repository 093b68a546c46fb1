"""Digests of results: two runs part where these do, also where the recorded, thinner fields look the same."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xxhash

from vlmm_log.elements import Sightings, WorldMap
from vlmm_log.types import EncodedImage, FlowField, FramePair, Segments

INPUTS = (FramePair, FlowField, Segments, Sightings)  # within a later stage's result: digested on their own


def digest(result: object) -> int:
    """XXH3 (64 bits) over all numbers and texts that a stage's result holds, but for what is its input."""
    h = xxhash.xxh3_64()
    _add(h, result.columns if isinstance(result, WorldMap) else result)  # of the map: its elements
    return h.intdigest()


def _add(h: xxhash.xxh3_64, value: object) -> None:
    match value:
        case np.ndarray():
            _text(h, f"{value.dtype} {value.shape}")
            h.update(np.ascontiguousarray(value).reshape(-1).view(np.uint8).data)
        case EncodedImage():
            pass  # its pixels count
        case Mapping():
            for key, item in value.items():
                _text(h, repr(key))
                _add(h, item)
        case tuple() if all(isinstance(item, str) for item in value):
            _text(h, repr(value))
        case tuple() | list():
            _text(h, f"{len(value)}")
            for item in value:
                _add(h, item)
        case _ if hasattr(value, "__dataclass_fields__"):
            for name in value.__dataclass_fields__:
                part = getattr(value, name)
                if not isinstance(part, INPUTS) and not callable(part) and not _unknown(name, part):
                    _add(h, part)
        case _:
            _text(h, repr(value))


def _unknown(name: str, part: object) -> bool:
    """Whether a run without a calibration left the column open: its digests are those of before there was one."""
    return name == "p_moving" and isinstance(part, np.ndarray) and part.ndim == 1 and bool(np.isnan(part).all())


def _text(h: xxhash.xxh3_64, text: str) -> None:
    h.update(text.encode("utf-8", "backslashreplace"))
