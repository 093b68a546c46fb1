"""Depth as containers hold it: integers and their unit, or metres."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from vlmm_log.readers.images import ImageError, media_type
from vlmm_log.readers.stored import StoredImage
from vlmm_log.types import Float32, UInt16
from vlmm_log.writers.encoded import file_header

MILLIMETRES = 1000.0
LARGEST = 65535


@dataclass(frozen=True, eq=False)
class Stored:
    """Depth as 16-bit integers, and what that cost."""

    values: UInt16  # (H, W), 0 unseen
    rounding_m: float  # largest
    lost: int  # pixels whose depth no such integer holds; they are unseen now


def as_image(values: UInt16 | Float32, units_per_meter: float) -> tuple[str, UInt16 | Float32]:
    """Encoding and pixels of a ROS image (REP 118): 16-bit millimetres where values are such, else float metres.

    ``values`` (H, W) as stored, ``units_per_meter`` of them. Metres are quotients in float32, so that their product
    with the unit, rounded, is the stored integer again, each of 65536. Integer 0 becomes NaN.
    """
    if values.dtype == np.uint16 and units_per_meter == MILLIMETRES:
        return "16UC1", values
    if values.dtype == np.float32 and units_per_meter == 1:
        return "32FC1", values
    metres = np.divide(values, np.float32(units_per_meter), dtype=np.float32)
    if values.dtype == np.uint16:
        metres[values == 0] = np.nan
    return "32FC1", metres


def in_units(values: UInt16 | Float32, units_per_meter: float, wanted: float) -> Stored:
    """Depth (H, W) of one unit as integers of another one, ``wanted`` per metre."""
    if values.dtype == np.uint16 and units_per_meter == wanted:
        return Stored(np.asarray(values, np.uint16), 0.0, 0)
    with np.errstate(invalid="ignore", over="ignore"):  # NaN and infinity are unseen
        exact = values.astype(np.float64) * wanted / units_per_meter
        whole = np.rint(exact)
        fits = (whole >= 1) & (whole <= LARGEST)
        lost = int(np.count_nonzero((exact > 0) & np.isfinite(exact) & ~fits))
    rounding = np.abs(whole[fits] - exact[fits]).max(initial=0.0) / wanted
    return Stored(np.where(fits, whole, 0).astype(np.uint16), float(rounding), lost)


def shifted(values: UInt16 | Float32, dx: int, dy: int) -> UInt16 | Float32:
    """Depth (H, W) moved right by dx and down by dy; unseen, that is 0 or NaN, where nothing comes from."""
    if (dx, dy) == (0, 0):
        return values
    move = np.array([[1.0, 0, dx], [0, 1, dy]])
    size = (values.shape[1], values.shape[0])
    unseen = 0.0 if values.dtype == np.uint16 else float("nan")
    moved = cv2.warpAffine(values, move, size, flags=cv2.INTER_NEAREST, borderValue=unseen)
    return np.asarray(moved, np.uint16) if values.dtype == np.uint16 else np.asarray(moved, np.float32)


def png_of_depth(image: StoredImage) -> bytes | memoryview | None:
    """The 16-bit PNG file that the log itself holds; None where it holds depth otherwise. Raises ImageError."""
    data: bytes | memoryview | None = image.data
    if "compressedDepth" in image.encoding:
        if not image.encoding.startswith(("16UC1", "mono16")):
            return None  # integers that stand for inverse depth
        from vlmm_log.readers.compressed_depth import png_of

        data = png_of(image.data)
    elif image.encoding:
        return None
    if data is None or media_type(data) != "image/png":
        return None
    header = file_header(data)
    if header is None or header.channels != 1 or header.bits != 16:
        raise ImageError("depth image is no 16-bit PNG of one channel")
    return data
