"""What chunks and messages hold compressed, up to the size that they state: a few bytes can stand for any number."""

from __future__ import annotations

import bz2
from collections.abc import Callable
from contextlib import suppress
from typing import Protocol

LARGEST = 1 << 30  # bytes; recorders close a chunk after some megabytes


class _Stream(Protocol):
    """A decompressor of bz2 or of lz4.frame."""

    @property
    def eof(self) -> bool:
        """Whether the stream ended."""

    @property
    def unused_data(self) -> bytes | None:
        """What follows its end."""

    def decompress(self, data: bytes, max_length: int = -1) -> bytes:
        """What follows, at most so much."""


def decompressed(data: bytes | memoryview, compression: str, size: int) -> bytes | memoryview:
    """The ``size`` bytes of a chunk. Raises ValueError where it holds others, or is damaged."""
    if not compression:
        plain: bytes | memoryview = data
    elif size > LARGEST:
        raise ValueError(f"chunk is larger than {LARGEST} bytes")
    elif compression == "zstd":
        plain = _of_zstd(data, size)
    else:
        plain = _of_streams(bytes(data), _stream_of(compression), size)
    if len(plain) != size:
        raise ValueError("chunk is damaged")
    return plain


def decompressed_head(data: bytes, compression: str) -> bytes:
    """What can be had of a chunk that is cut off: whole compressed blocks from its beginning."""
    stream, plain = _stream_of(compression)(), bytearray()
    with suppress(OSError, RuntimeError, EOFError, MemoryError):  # what came before stays
        for at in range(0, len(data), 4096):
            plain += stream.decompress(data[at : at + 4096], LARGEST - len(plain))
            if len(plain) >= LARGEST:
                break
    return bytes(plain)


def decompressed_message(data: bytes) -> bytes:
    """A message that ROS 2 compressed by itself. Raises ValueError."""
    import zstandard

    try:
        stated = zstandard.frame_content_size(data)
        return _of_zstd(data, LARGEST if stated < 0 else stated)
    except zstandard.ZstdError as e:
        raise ValueError("message is damaged") from e


def _of_zstd(data: bytes | memoryview, most: int) -> bytes:
    """One frame. The library reserves what the frame itself states, where it does."""
    import zstandard

    try:
        if most > LARGEST or zstandard.frame_content_size(data) > most:
            raise ValueError("more is compressed than is stated")
        return zstandard.ZstdDecompressor().decompress(data, max_output_size=most)
    except (zstandard.ZstdError, MemoryError) as e:
        raise ValueError("chunk is damaged") from e


def _stream_of(compression: str) -> Callable[[], _Stream]:
    if compression == "bz2":
        return bz2.BZ2Decompressor
    import lz4.frame  # type: ignore[import-untyped]

    return lz4.frame.LZ4FrameDecompressor  # type: ignore[no-any-return]


def _of_streams(data: bytes, stream_of: Callable[[], _Stream], size: int) -> bytes:
    """All streams in a row: recorders write one a chunk, rosbag ported to plain Python one a write."""
    parts: list[bytes] = []
    room = size + 1
    try:
        while data and room > 0:
            stream = stream_of()
            parts.append(stream.decompress(data, room))
            room -= len(parts[-1])
            if not stream.eof:
                raise ValueError("chunk is damaged")
            data = stream.unused_data or b""
    except (OSError, RuntimeError, EOFError, MemoryError) as e:
        raise ValueError("chunk is damaged") from e
    return b"".join(parts)
