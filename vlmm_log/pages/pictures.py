"""Pictures inside a page."""

from __future__ import annotations

import base64
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vlmm_log.types import UInt8

WIDTH = 320  # px


def coloured(values: NDArray[Any], low: float, high: float, colormap: int) -> UInt8:
    """Numbers (H, W) in colours (H, W, 3) BGR, NaN black."""
    known = np.isfinite(values)
    scaled = np.clip((np.where(known, values, low).astype(np.float32) - low) * (255 / (high - low)), 0, 255)
    colors = cv2.applyColorMap(scaled.astype(np.uint8), colormap)
    colors[~known] = 0
    return np.asarray(colors, np.uint8)


def data_uri(pixels: UInt8) -> str:
    """A small JPEG of (H, W, 3) BGR."""
    height = max(round(pixels.shape[0] * WIDTH / pixels.shape[1]), 1)
    small = cv2.resize(pixels, (WIDTH, height), interpolation=cv2.INTER_AREA)
    _, file = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 85])
    return f"data:image/jpeg;base64,{base64.b64encode(file.tobytes()).decode()}"
