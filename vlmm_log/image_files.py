"""Encoded images, decoded once their own header says a size that is worth its memory: a small file may claim any."""

from __future__ import annotations

import re
import struct

import cv2
import numpy as np

LARGEST = 1 << 26  # px of an image
_PNM = re.compile(rb"P[1-6](?:\s|#[^\n]*\n)+(\d{1,9})(?:\s|#[^\n]*\n)+(\d{1,9})\s")
_TIFF_SIZES = (256, 257)  # tags: width, height


def decoded(data: bytes | memoryview, flags: int) -> cv2.typing.MatLike | None:
    """The image of PNG, JPEG, WebP, TIFF or PNM; None where it is damaged, too large or of another kind.

    As it is stored: a camera's note on how it was held turns no colour away from its depth.
    """
    size = stated_size(data)
    if size is None or not (0 < size[0] <= LARGEST and 0 < size[1] <= LARGEST // size[0]):
        return None
    try:
        return cv2.imdecode(np.frombuffer(data, np.uint8), flags | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error:
        return None


def stated_size(data: bytes | memoryview) -> tuple[int, int] | None:
    """Width and height px as the file's own header says; None where it says none."""
    head = bytes(data[:64])
    try:
        if head.startswith(b"\x89PNG\r\n\x1a\n"):
            return _of_png(data)
        if head.startswith(b"\xff\xd8"):
            return _of_jpeg(bytes(data))
        if head.startswith(b"RIFF") and head[8:12] == b"WEBP":
            return _of_webp(head)
        if head.startswith((b"II*\0", b"MM\0*")):
            return _of_tiff(bytes(data), "<" if head.startswith(b"II") else ">")
    except (struct.error, LookupError, ValueError):  # it ends within its header
        return None
    pnm = _PNM.match(bytes(data[:1024]))
    return (int(pnm[1]), int(pnm[2])) if pnm else None


def _of_png(data: bytes | memoryview) -> tuple[int, int] | None:
    """Of its first chunk; None where a chunk is longer than the file: OpenCV would reserve what it states."""
    at, kind = 8, b""
    while kind != b"IEND":
        length, kind = struct.unpack_from(">I4s", data, at)
        at += 12 + length
        if at > len(data):
            return None
    width, height = struct.unpack_from(">II", data, 16)
    return width, height


def _of_jpeg(data: bytes) -> tuple[int, int]:
    """Of the first frame header: ITU-T T.81, B.2.2."""
    at = 2
    while True:
        at = data.index(b"\xff", at)
        while data[at] == 0xFF:
            at += 1
        marker = data[at]
        at += 1
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            height, width = struct.unpack_from(">HH", data, at + 3)
            return width, height
        if marker not in (0x00, 0x01, *range(0xD0, 0xD9)):  # these stand alone
            at += struct.unpack_from(">H", data, at)[0]


def _of_webp(head: bytes) -> tuple[int, int]:
    """Of its first chunk: RFC 9649."""
    match head[12:16]:
        case b"VP8X":
            width, height = (int.from_bytes(head[k : k + 3], "little") + 1 for k in (24, 27))
        case b"VP8L":
            (bits,) = struct.unpack_from("<I", head, 21)
            width, height = (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
        case _:
            width, height = (n & 0x3FFF for n in struct.unpack_from("<HH", head, 26))
    return width, height


def _of_tiff(data: bytes, order: str) -> tuple[int, int]:
    """Of its first directory: TIFF 6.0, section 2."""
    (at,) = struct.unpack_from(f"{order}I", data, 4)
    (entries,) = struct.unpack_from(f"{order}H", data, at)
    sizes = {}
    for k in range(entries):
        tag, kind, _ = struct.unpack_from(f"{order}HHI", data, at + 2 + 12 * k)
        if tag in _TIFF_SIZES and kind in (3, 4):  # SHORT, LONG
            (sizes[tag],) = struct.unpack_from(order + ("H" if kind == 3 else "I"), data, at + 10 + 12 * k)
    return sizes[_TIFF_SIZES[0]], sizes[_TIFF_SIZES[1]]
