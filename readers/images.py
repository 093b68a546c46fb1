"""Encoded images to arrays."""

from __future__ import annotations

import cv2
import numpy as np

from vlmm_log.types import Float32, UInt8

SMALLEST = 32  # px a side; dense optical flow needs some room


class ImageError(Exception):
    """Why an image cannot be used, in a few words that can be counted."""


def decode_rgb(data: bytes) -> UInt8:
    """Colour or grey PNG, JPEG, ... as (H, W, 3) RGB. Raises ImageError."""
    image = _decode(data, cv2.IMREAD_COLOR_RGB, "colour")
    return np.asarray(image, np.uint8)


def decode_depth(data: bytes, units_per_meter: float, min_m: float, max_m: float) -> Float32:
    """16-bit depth as (H, W) m; 0 and what lies out of range is NaN. Raises ImageError."""
    raw = _decode(data, cv2.IMREAD_UNCHANGED, "depth")
    if raw.ndim != 2:
        raise ImageError(f"depth image has {raw.shape[2]} channels; one is expected")
    if raw.dtype != np.uint16:
        raise ImageError(f"depth image is {raw.dtype.itemsize * 8}-bit; 16-bit PNG is expected")
    depth = raw.astype(np.float32)
    depth *= np.float32(1.0 / units_per_meter)
    depth[(raw == 0) | (raw < min_m * units_per_meter) | (raw > max_m * units_per_meter)] = np.nan
    return depth


def _decode(data: bytes, flags: int, what: str) -> cv2.typing.MatLike:
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags) if data else None
    except cv2.error:
        image = None
    if image is None:
        raise ImageError(f"{what} image cannot be decoded")
    if min(image.shape[:2]) < SMALLEST:
        raise ImageError(f"{what} image is smaller than {SMALLEST} px")
    return image


def media_type(data: bytes) -> str | None:
    """The media type that the bytes themselves declare: PNG or JPEG, else None."""
    if data.startswith(b"\x89PNG\r\n\x1a\n"):
        return "image/png"
    return "image/jpeg" if data.startswith(b"\xff\xd8\xff") else None
