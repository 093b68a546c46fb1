"""Depth as ROS has it (REP 118): 16-bit millimetres where it is stored so, else metres."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vlmm_log.entries import DepthMap
from vlmm_log.image_files import decoded
from vlmm_log.types import EncodedImage

MILLIMETRES = 1000.0


def pixels(depth: DepthMap) -> NDArray[Any]:
    """Depth (H, W) as stored. Raises ValueError where the image file is none."""
    if not isinstance(depth.stored, EncodedImage):
        return depth.stored
    values = decoded(depth.stored.data, cv2.IMREAD_UNCHANGED)
    if values is None:
        raise ValueError("depth image cannot be decoded")
    return values


def metric_pixels(depth: DepthMap) -> tuple[str, NDArray[Any]]:
    """Encoding and pixels of a ROS image."""
    values = pixels(depth)
    if values.dtype == np.uint16 and depth.units_per_meter == MILLIMETRES:
        return "16UC1", values
    return "32FC1", metres(depth)


def metres(depth: DepthMap) -> NDArray[np.float32]:
    """Depth (H, W) m, NaN where unseen. Quotients in float32, as everywhere here: one depth has the same bits."""
    values = pixels(depth)
    quotients = np.divide(values, np.float32(depth.units_per_meter), dtype=np.float32)
    quotients[values == 0] = np.nan
    return np.asarray(quotients, np.float32)
