"""ROS's compressed_depth_image_transport: 12 bytes of header, then depth as 16-bit PNG or as RVL.

The header is an int32 and two float32, A and B. 16-bit depth is stored as it is. Depth in floats is stored as quantised
inverse depth v: z = A / (v - B), 0 for unseen. RVL data begin with width and height, int32. All is little-endian.
"""

from __future__ import annotations

import math
import struct
from typing import Literal, assert_never

import cv2
import numpy as np

from vlmm_log.image_files import LARGEST
from vlmm_log.readers.images import ImageError, check_size, depth_of_file, media_type
from vlmm_log.types import Float32, UInt16

HEADER = struct.Struct("<iff")
SIZE = struct.Struct("<ii")
INVERSE_DEPTH = 0  # the only kind that the header's first number ever names

Form = Literal["png", "rvl"]


def decode(data: bytes | memoryview, format: str) -> UInt16 | Float32:  # noqa: A002 - ROS's name of the field
    """Depth (H, W): values as stored where ``format`` says 16UC1, m and NaN where it says 32FC1. Raises ImageError.

    ``format`` is the message's: "16UC1; compressedDepth png"; without "png" or "rvl" it is PNG. A PNG without the
    header is read too, if it needs no A and B.
    """
    encoding, _, transport = (part.strip() for part in format.partition(";"))
    header, body = _parts(data)
    match transport.removeprefix("compressedDepth").split():
        case [] | ["png"]:
            values = depth_of_file(body)
        case ["rvl"]:
            values = _from_rvl(body)
        case _:
            raise ImageError("compressedDepth image is neither PNG nor RVL")
    match encoding:
        case "16UC1" | "mono16":
            return values
        case "32FC1":
            return _from_inverse(values, header)
    raise ImageError("compressedDepth image is of neither 16UC1 nor 32FC1")


def encode(values: UInt16, form: Form) -> bytes:
    """16-bit depth (H, W), without loss; the ``format`` to go with it is "16UC1; compressedDepth <form>".

    Raises ValueError for any other array: the format rounds floats.
    """
    if values.dtype != np.uint16 or values.ndim != 2:
        raise ValueError(f"compressedDepth without loss takes uint16 (H, W), not {values.dtype} {values.shape}")
    header = HEADER.pack(INVERSE_DEPTH, 0.0, 0.0)
    match form:
        case "png":
            done, file = cv2.imencode(".png", values)
            if not done:
                raise ValueError(f"depth of {values.shape} px cannot be encoded")
            return header + file.tobytes()
        case "rvl":
            from vlmm_log import rvl

            return header + SIZE.pack(values.shape[1], values.shape[0]) + rvl.encode(values)
    assert_never(form)


def png_of(data: bytes | memoryview) -> bytes | memoryview | None:
    """The PNG file within the message's data; None where it is none."""
    body = _parts(data)[1]
    return body if media_type(body) == "image/png" else None


def _parts(data: bytes | memoryview) -> tuple[tuple[float, float] | None, bytes | memoryview]:
    """A and B, if there is a header, and what follows."""
    if media_type(data) is not None:
        return None, data
    if len(data) <= HEADER.size:
        raise ImageError("compressedDepth image ends within its header")
    _, a, b = HEADER.unpack_from(data)
    return (a, b), data[HEADER.size :]


def _from_rvl(body: bytes | memoryview) -> UInt16:
    from vlmm_log import rvl  # here: it brings a compiler along

    if len(body) <= SIZE.size:
        raise ImageError("RVL image ends within its header")
    width, height = SIZE.unpack_from(body)
    check_size(height, width, "depth")
    if width * height > LARGEST:
        raise ImageError("RVL image has a damaged size")
    try:
        return rvl.decode(body[SIZE.size :], width * height).reshape(height, width)
    except ValueError as e:
        raise ImageError(str(e)) from e


def _from_inverse(values: UInt16, header: tuple[float, float] | None) -> Float32:
    if header is None:
        raise ImageError("compressedDepth image of 32FC1 lacks the header that gives its scale")
    a, b = header
    if not (math.isfinite(a) and math.isfinite(b) and a > 0):
        raise ImageError("compressedDepth image has a damaged header")
    with np.errstate(divide="ignore", over="ignore"):  # v = B is infinitely far
        depth = np.float32(a) / (values.astype(np.float32) - np.float32(b))
    depth[values == 0] = np.nan
    return depth
