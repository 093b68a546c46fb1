"""One file of a ROS 2 bag: a .db3 or .mcap, perhaps compressed as a whole."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Protocol

from vlmm_log.readers.bag.channels import ZSTD_MAGIC
from vlmm_log.readers.bag.containers import Container
from vlmm_log.types import InputError, Int64, Skipped

SQLITE_MAGIC = b"SQLite format 3\x00"
MCAP_MAGIC = b"\x89MCAP0\r\n"
MOST_TIMES = 1000  # its size, that a compressed file becomes: it is not to fill the disk


class Part(Container, Protocol):
    """A container that gives all log times even where it must read payloads for them."""

    def all_times(self, topic: str) -> Int64:
        """Like ``log_times``, but never None."""


def first_bytes(path: Path) -> bytes:
    """What tells kinds of files apart. Raises InputError where there is nothing to read."""
    try:
        with path.open("rb") as file:
            magic = file.read(16)
    except OSError as e:
        raise InputError(f"{path}: cannot be read: {e}") from e
    if not magic:
        raise InputError(f"{path}: is empty; record or copy it again")
    return magic


def opener(path: Path) -> Callable[[Path], Part]:
    """What opens a file, by its first bytes. Raises InputError."""
    from vlmm_log.readers.bag.mcap_file import open_mcap
    from vlmm_log.readers.bag.rosbag1 import open_rosbag1
    from vlmm_log.readers.bag.sqlite import open_sqlite

    magic = first_bytes(path)
    known: dict[bytes, Callable[[Path], Part]] = {
        SQLITE_MAGIC: open_sqlite,
        MCAP_MAGIC: open_mcap,
        b"#ROSBAG": open_rosbag1,
    }
    for first, found in known.items():
        if magic.startswith(first):
            return found
    raise InputError(f"{path}: is no bag, its first bytes are others; give a .bag, .db3 or .mcap")


def expanded(path: Path, folder: TemporaryDirectory[str]) -> tuple[Path, tuple[Skipped, ...]]:
    """The file itself, or what it holds compressed, written below the folder; what could not be had of it."""
    if not first_bytes(path).startswith(ZSTD_MAGIC):
        return path, ()
    import zstandard

    plain = Path(folder.name) / (path.stem if path.suffix.lower() in (".zstd", ".zst") else path.name)
    losses: tuple[Skipped, ...] = ()
    with path.open("rb") as source, plain.open("wb") as target:
        try:
            for piece in zstandard.ZstdDecompressor().read_to_iter(source):
                target.write(piece)
                if target.tell() > MOST_TIMES * path.stat().st_size:
                    losses = (Skipped(0, f"{path.name} after {target.tell()} bytes", "file is compressed too much"),)
                    break
        except zstandard.ZstdError:
            losses = (Skipped(0, f"{path.name} after {target.tell()} bytes", "file cannot be decompressed"),)
    return plain, losses
