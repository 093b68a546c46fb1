"""Stored images as ROS's image messages hold them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlmm_log.readers import compressed_depth
from vlmm_log.readers.images import decode_rgb, depth_values
from vlmm_log.readers.stored import StoredImage
from vlmm_log.ros.messages import COMPRESSED_IMAGE, IMAGE
from vlmm_log.writers.depth import as_image, png_of_depth, shifted
from vlmm_log.writers.encoded import file_header, png

PNG_DEPTH = "16UC1; compressedDepth png"
NO_HEADER = compressed_depth.HEADER.pack(compressed_depth.INVERSE_DEPTH, 0.0, 0.0)  # as 16 bits need none


@dataclass(frozen=True, eq=False)
class Built:
    """One image message, but for its header."""

    type: str
    suffix: str  # of the topic
    form: str  # encoding of an array, format of bytes
    content: NDArray[Any] | bytes
    size: tuple[int, int]  # (H, W)


def raw_rgb(image: StoredImage) -> Built:
    """Colour as rgb8. Raises ImageError."""
    pixels = decode_rgb(image)
    return Built(IMAGE, "", "rgb8", pixels, (pixels.shape[0], pixels.shape[1]))


def encoded_rgb(image: StoredImage) -> Built:
    """Colour as the PNG or JPEG file that the log holds, else as a PNG. Raises ImageError.

    A file's bytes pass as they are, its pixels damaged or not; it must have a header.
    """
    header = None if image.encoding else file_header(image.data)
    if header is None:
        data = png(decode_rgb(image))
        header = file_header(data)
        assert header is not None
    else:
        data = bytes(image.data)
    names = (f"mono{header.bits}", "") if header.channels == 1 else (f"rgb{header.bits}", f"bgr{header.bits}")
    form = f"{names[0]}; {header.kind} compressed {names[1]}"  # as compressed_image_transport writes it
    return Built(COMPRESSED_IMAGE, "/compressed", form, data, (header.height, header.width))


def raw_depth(image: StoredImage, units_per_meter: float, shift: tuple[int, int]) -> Built:
    """Depth as 16UC1 in mm or 32FC1 in m, see depth.as_image. Raises ImageError."""
    encoding, pixels = as_image(shifted(depth_values(image), *shift), units_per_meter)
    return Built(IMAGE, "", encoding, pixels, (pixels.shape[0], pixels.shape[1]))


def encoded_depth(image: StoredImage, units_per_meter: float, shift: tuple[int, int]) -> Built:
    """Depth as compressedDepth, its integers in the log's own unit; raw where that would round. Raises ImageError.

    A PNG's bytes pass as they are, and so do those of compressedDepth.
    """
    bare = shift == (0, 0)
    if bare and (file := png_of_depth(image)) is not None:
        header = file_header(file)
        assert header is not None
        return _compressed(PNG_DEPTH, NO_HEADER + bytes(file), (header.height, header.width))
    values = depth_values(image)
    size = (values.shape[0], values.shape[1])
    scaled = image.encoding.startswith("32FC1") and units_per_meter != 1  # floats are metres, by REP 118
    if bare and "compressedDepth" in image.encoding and not scaled:
        return _compressed(image.encoding, bytes(image.data), size)
    if values.dtype != np.uint16:
        return raw_depth(image, units_per_meter, shift)
    moved = np.asarray(shifted(values, *shift), np.uint16)
    return _compressed(PNG_DEPTH, compressed_depth.encode(moved, "png"), size)


def _compressed(form: str, data: bytes, size: tuple[int, int]) -> Built:
    return Built(COMPRESSED_IMAGE, "/compressedDepth", form, data, size)
