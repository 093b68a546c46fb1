"""Pictures inside a page."""

from __future__ import annotations

import base64

import cv2

from vlmm_log.types import UInt8

WIDTH = 320  # px


def data_uri(pixels: UInt8) -> str:
    """A small JPEG of (H, W, 3) BGR."""
    height = max(round(pixels.shape[0] * WIDTH / pixels.shape[1]), 1)
    small = cv2.resize(pixels, (WIDTH, height), interpolation=cv2.INTER_AREA)
    _, file = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 85])
    return f"data:image/jpeg;base64,{base64.b64encode(file.tobytes()).decode()}"
