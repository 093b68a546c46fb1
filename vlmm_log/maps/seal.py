"""A checksum inside a Parquet file: it lies before the footer, where Parquet's readers do not look.

A damaged footer can abort the process inside Arrow, beyond any ``except``: only what is whole may be given to it.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

from vlmm_log.types import InputError


def seal(path: Path) -> None:
    """Put the checksum of a Parquet file into it. Parquet's offsets count from the start, so the footer may move."""
    data = path.read_bytes()
    footer = _footer(data)
    with path.open("rb+") as f:
        f.seek(footer)
        f.write(hashlib.sha256(data).digest() + data[footer:])


def sealed(path: Path) -> bytes:
    """The file's bytes, its checksum tested."""
    try:
        data = path.read_bytes()
    except OSError as e:
        raise InputError(f"{path}: cannot be read: {e.strerror or e}") from e
    footer = _footer(data)
    mark = footer - hashlib.sha256().digest_size
    if mark < 0 or hashlib.sha256(data[:mark] + data[footer:]).digest() != data[mark:footer]:
        raise InputError(f"{path}: is damaged, or no Parquet file that vlmm-log wrote: its checksum does not fit")
    return data


def _footer(data: bytes) -> int:
    """Where the footer begins: its length and four letters end the file."""
    return len(data) - 8 - int.from_bytes(data[-8:-4], "little")
