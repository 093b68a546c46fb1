"""What encoded images say of themselves, and lossless files of bare pixels."""

from __future__ import annotations

from dataclasses import dataclass

import cv2

from vlmm_log.readers.images import ImageError, media_type
from vlmm_log.types import UInt8, UInt16

PNG_CHANNELS = {0: 1, 2: 3, 3: 3, 4: 1, 6: 3}  # colour type -> of colour
JPEG_FRAMES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}  # markers that a frame begins with


@dataclass(frozen=True)
class FileHeader:
    """The first bytes of an image file."""

    kind: str  # "png" or "jpeg"
    width: int  # px
    height: int
    channels: int  # 1 or 3
    bits: int  # a channel


def file_header(data: bytes | memoryview) -> FileHeader | None:
    """That of a PNG or JPEG, nothing being decoded; None of any other file. Raises ImageError of a damaged one.

    W3C, PNG, 11.2.2; ITU-T T.81, B.2.2.
    """
    match media_type(data):
        case "image/png":
            head = bytes(data[:26])
            if len(head) < 26 or head[12:16] != b"IHDR" or head[25] not in PNG_CHANNELS:
                raise ImageError("PNG file's header is damaged")
            width, height = int.from_bytes(head[16:20], "big"), int.from_bytes(head[20:24], "big")
            return FileHeader("png", width, height, PNG_CHANNELS[head[25]], head[24])
        case "image/jpeg":
            return _jpeg(bytes(data))
    return None


def _jpeg(data: bytes) -> FileHeader:
    at = 2
    while at + 10 <= len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        if marker in JPEG_FRAMES:
            height, width = int.from_bytes(data[at + 5 : at + 7], "big"), int.from_bytes(data[at + 7 : at + 9], "big")
            return FileHeader("jpeg", width, height, 1 if data[at + 9] == 1 else 3, data[at + 4])
        padding = marker == 0xFF
        at += 1 if padding else 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    raise ImageError("JPEG file's header is damaged")


def png(pixels: UInt8 | UInt16) -> bytes:
    """A PNG of colour (H, W, 3) RGB or of 16-bit depth (H, W), without loss."""
    done, file = cv2.imencode(".png", pixels if pixels.ndim == 2 else cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR))
    assert done
    return file.tobytes()
