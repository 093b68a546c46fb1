"""Values in colours: those that the viewer shows them in."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vlmm_log.depth_pixels import metres
from vlmm_log.entries import DepthMap, LabelNames, Labels, Picture, Raster, Value
from vlmm_log.image_files import decoded
from vlmm_log.sinks.content import VALIDITY_NAMES
from vlmm_log.sinks.legend import COLORMAPS, UNKNOWN
from vlmm_log.sinks.map_entries import id_color
from vlmm_log.sinks.pair_entries import IMAGE, JUDGED_NAMES, LOOKS, Range
from vlmm_log.types import UInt8

NAMED: Mapping[str, LabelNames] = {f"{IMAGE}/validity": VALIDITY_NAMES, **JUDGED_NAMES}
NOTHING = (40, 40, 40)  # of a pixel of no instance
PLAIN: Range = (0.0, 1.0, "viridis")
TENSOR_PX = 16.0  # flow as bright as it gets


def picture(entity: str, value: Value) -> UInt8 | None:
    """A value as (H, W, 3) BGR; None where it cannot be shown."""
    match value:
        case Picture(data, _):
            found = decoded(data, cv2.IMREAD_COLOR)
            return None if found is None else np.asarray(found, np.uint8)
        case DepthMap():
            try:
                return _in_range(metres(value), LOOKS[f"{IMAGE}/depth"])
            except ValueError:
                return None
        case Raster(values, ()):
            return _in_range(values, LOOKS.get(entity, PLAIN))
        case Raster(values, ("u", "v")):
            return coloured(np.hypot(*values.astype(np.float32)), 0.0, TENSOR_PX, cv2.COLORMAP_VIRIDIS)
        case Labels(values) if entity in NAMED:
            return painted(values, {number: color[:3] for number, _, color in NAMED[entity].classes})
        case Labels(values):
            return painted(values, {int(i): id_color(int(i)) for i in np.unique(values) if i})
        case _:
            return None


def painted(labels: NDArray[Any], colors: Mapping[int, tuple[int, ...]]) -> UInt8:
    """Labels (H, W) in colours (H, W, 3) BGR, of RGB ones; dark where a label has none."""
    table = np.full((max(int(labels.max(initial=0)), *colors, 0) + 1, 3), NOTHING, np.uint8)
    for number, color in colors.items():
        table[number] = color[::-1]
    return np.asarray(table[labels], np.uint8)


def coloured(values: NDArray[Any], low: float, high: float, colormap: int) -> UInt8:
    """Numbers (H, W) in colours (H, W, 3) BGR, NaN grey."""
    known = np.isfinite(values)
    scaled = np.clip((np.where(known, values, low).astype(np.float32) - low) * (255 / (high - low)), 0, 255)
    colors = cv2.applyColorMap(scaled.astype(np.uint8), colormap)
    colors[~known] = UNKNOWN
    return np.asarray(colors, np.uint8)


def _in_range(values: NDArray[Any], look: Range) -> UInt8:
    low, high, colors = look
    return coloured(values, low, high, COLORMAPS[colors])
