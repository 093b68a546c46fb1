"""Stored images to arrays: encoded files, and bare pixels by the names of ROS's sensor_msgs/image_encodings."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vlmm_log.image_files import decoded
from vlmm_log.readers.stored import StoredImage
from vlmm_log.types import Float32, Float64, UInt8, UInt16

SMALLEST = 32  # px a side; dense optical flow needs some room
NEAREST_M, FARTHEST_M = 1e-9, 1e9  # beyond, single precision squares none: unseen


class ImageError(Exception):
    """Why an image cannot be used, in a few words that can be counted."""


@dataclass(frozen=True)
class _Pixels:
    kind: str  # numpy's name of one number, without its byte order
    numbers: int = 1  # a pixel
    to_rgb: int | None = None  # OpenCV's conversion code; None: it is RGB


def _colours() -> dict[str, _Pixels]:
    """By encoding. Bayer patterns go by their upper left 2x2 px, in rows; OpenCV's names of two letters do not."""
    orders = {
        "rgb": (3, None),
        "bgr": (3, cv2.COLOR_BGR2RGB),
        "rgba": (4, cv2.COLOR_RGBA2RGB),
        "bgra": (4, cv2.COLOR_BGRA2RGB),
        "mono": (1, cv2.COLOR_GRAY2RGB),
        "bayer_rggb": (1, cv2.COLOR_BayerRGGB2RGB),
        "bayer_bggr": (1, cv2.COLOR_BayerBGGR2RGB),
        "bayer_gbrg": (1, cv2.COLOR_BayerGBRG2RGB),
        "bayer_grbg": (1, cv2.COLOR_BayerGRBG2RGB),
    }
    named = {f"{name}{8 * n}": _Pixels(f"u{n}", *order) for name, order in orders.items() for n in (1, 2)}
    uyvy, yuyv = (_Pixels("u1", 2, code) for code in (cv2.COLOR_YUV2RGB_UYVY, cv2.COLOR_YUV2RGB_YUYV))
    unnamed = {"8UC1": named["mono8"], "8UC3": named["bgr8"], "8UC4": named["bgra8"]}
    return named | unnamed | {"yuv422": uyvy, "uyvy": uyvy, "yuv422_yuy2": yuyv, "yuyv": yuyv}


_COLOURS = _colours()
_DEPTHS = {"16UC1": _Pixels("u2"), "mono16": _Pixels("u2"), "32FC1": _Pixels("f4"), "64FC1": _Pixels("f8")}


def decode_rgb(image: StoredImage) -> UInt8:
    """Colour or grey of any known encoding as (H, W, 3) RGB; 16 bits keep their upper 8. Raises ImageError."""
    if not image.encoding:
        return np.asarray(_decode(image.data, cv2.IMREAD_COLOR_RGB, "colour"), np.uint8)
    layout = _COLOURS.get(image.encoding)
    if layout is None:
        raise ImageError(f"encoding {_quoted(image.encoding)} is not one that colour is read from")
    pixels = _pixels(image, layout, "colour")
    if layout.numbers == 2 and image.width % 2:
        raise ImageError("colour image in YUV 4:2:2 has an odd width")
    if layout.kind == "u2":
        pixels = (pixels >> 8).astype(np.uint8)
    if layout.to_rgb is None:
        return np.array(pixels, np.uint8)  # a copy: the log may use its bytes again
    return np.asarray(cv2.cvtColor(pixels, layout.to_rgb), np.uint8)


def decode_depth(image: StoredImage, units_per_meter: float, min_m: float, max_m: float) -> Float32:
    """Depth as (H, W) m; NaN for 0, for what is not finite and for what is out of range. Raises ImageError.

    A division, not a product with the reciprocal: so one depth stored in different units has equal bits here.
    """
    values = depth_values(image)
    if values.dtype == np.uint16:
        return np.take(_depths(units_per_meter, min_m, max_m), values.view(np.uint16))
    return in_range(values, units_per_meter, min_m, max_m)


@lru_cache(maxsize=4)
def _depths(units_per_meter: float, min_m: float, max_m: float) -> Float32:
    """What each 16-bit value means: a look-up is five times faster than division and comparison of an image."""
    return in_range(np.arange(1 << 16, dtype=np.uint16), units_per_meter, min_m, max_m)


def in_range(values: UInt16 | Float32 | Float64, units_per_meter: float, min_m: float, max_m: float) -> Float32:
    """Stored depth as m; NaN for 0, for what is not finite and for what is out of range."""
    with np.errstate(all="ignore"):  # damaged floats overflow to infinity, which is out of range
        depth = np.divide(values, np.float32(units_per_meter), dtype=np.float32)
        out = depth < np.float32(max(min_m, NEAREST_M))
        out |= depth > np.float32(min(max_m, FARTHEST_M))
    np.copyto(depth, np.float32(np.nan), where=out)
    return depth


def depth_values(image: StoredImage) -> UInt16 | Float32:
    """Depth (H, W) as stored, before any scale: 16-bit integers, or floats. Raises ImageError."""
    if not image.encoding:
        return depth_of_file(image.data)
    if "compressedDepth" in image.encoding:
        from vlmm_log.readers import compressed_depth  # here, since it imports this file

        return compressed_depth.decode(image.data, image.encoding)
    layout = _DEPTHS.get(image.encoding)
    if layout is None:
        raise ImageError(f"depth image has encoding {_quoted(image.encoding)}; 16UC1 or 32FC1 is expected")
    pixels = _pixels(image, layout, "depth")
    if layout.kind == "u2":
        return pixels.astype(np.uint16)
    with np.errstate(all="ignore"):  # doubles beyond float32 become infinite
        return pixels.astype(np.float32)


def depth_of_file(data: bytes | memoryview) -> UInt16:
    """An encoded file of 16-bit depth (H, W), values as stored. Raises ImageError."""
    raw = _decode(data, cv2.IMREAD_UNCHANGED, "depth")
    if raw.ndim != 2:
        raise ImageError(f"depth image has {raw.shape[2]} channels; one is expected")
    if raw.dtype != np.uint16:
        raise ImageError(f"depth image is {raw.dtype.itemsize * 8}-bit; 16-bit PNG is expected")
    return np.asarray(raw, np.uint16)


def check_size(height: int, width: int, what: str) -> None:
    """Raises ImageError where the image is too small to be used."""
    if min(height, width) < SMALLEST:
        raise ImageError(f"{what} image is smaller than {SMALLEST} px")


def media_type(data: bytes | memoryview) -> str | None:
    """The media type that the bytes themselves declare: PNG or JPEG, else None."""
    start = bytes(data[:8])
    if start == b"\x89PNG\r\n\x1a\n":
        return "image/png"
    return "image/jpeg" if start.startswith(b"\xff\xd8\xff") else None


def _decode(data: bytes | memoryview, flags: int, what: str) -> cv2.typing.MatLike:
    image = decoded(data, flags)
    if image is None:
        raise ImageError(f"{what} image cannot be decoded")
    check_size(image.shape[0], image.shape[1], what)
    return image


def _pixels(image: StoredImage, layout: _Pixels, what: str) -> NDArray[Any]:
    """Bare pixels (H, W) or (H, W, numbers) as a view of the stored bytes."""
    if not image.data:
        raise ImageError(f"{what} image has no data")
    check_size(image.height, image.width, what)
    kind = np.dtype(layout.kind).newbyteorder(">" if image.big_endian else "<")
    row = image.width * layout.numbers * kind.itemsize
    if image.step < row:
        raise ImageError("image rows are longer than its step says")
    if len(image.data) < image.height * image.step:
        raise ImageError("image data is shorter than its height and step say")
    rows = np.frombuffer(image.data, np.uint8, image.height * image.step).reshape(image.height, image.step)
    pixels = rows[:, :row].view(kind)
    return pixels if layout.numbers == 1 else pixels.reshape(image.height, image.width, layout.numbers)


def _quoted(encoding: str) -> str:
    return repr(encoding[:40])  # as ASCII escapes where it is not printable
