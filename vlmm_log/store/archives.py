"""Archives of strangers, unpacked: files and folders below one folder, nothing else, and no more than is plausible.

Only names and contents are taken from an archive: no owner, mode, time or link.
"""

from __future__ import annotations

import gzip
import stat
import tarfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import IO, BinaryIO, cast

from vlmm_log.types import InputError

RATIO = 20  # bytes unpacked for one packed; images are hardly compressed again
MEMBERS = 50_000
HEADER = 1 << 20  # bytes of one header of a tar archive
CHUNK = 1 << 20
BROKEN = (tarfile.TarError, zipfile.BadZipFile, zlib.error, EOFError, gzip.BadGzipFile)


@dataclass(frozen=True)
class Member:
    """One entry of an archive."""

    name: str
    kind: str  # "file", "folder", or what else it is
    size: int  # bytes, as the archive says
    open: Callable[[], IO[bytes] | None]


def unpack(archive: Path, folder: Path) -> int:
    """Write what an archive holds below NAME/ to ``folder``, which is made; how many members lie outside of NAME/.

    NAME is the folder's own. Those outside are left out, unless they would escape. Raises InputError where the archive
    is broken, holds anything but files and folders, or would escape or fill the disk.
    """
    limit = RATIO * archive.stat().st_size + CHUNK
    outside = written = 0
    try:
        with _members(archive, limit) as members:
            for number, member in enumerate(members):
                parts = _inner_parts(archive, member)
                if number >= MEMBERS:
                    raise InputError(f"{archive}: holds more than {MEMBERS} members; it is not unpacked")
                if not parts or parts[0] != folder.name:
                    outside += bool(parts)
                    continue
                written += member.size
                if written > limit:
                    raise InputError(f"{archive}: would be more than {limit / 1e6:.0f} MB; it is not unpacked")
                _write(archive, member, folder.joinpath(*parts[1:]))
    except BROKEN as e:
        raise InputError(f"{archive}: is broken: {e or type(e).__name__}; remove it to fetch it again") from e
    if not folder.is_dir():
        raise InputError(f"{archive}: holds no folder {folder.name}")
    return outside


@contextmanager
def _members(archive: Path, limit: int) -> Iterator[Iterator[Member]]:
    if archive.suffix == ".zip":
        with zipfile.ZipFile(archive) as zipped:
            yield (_of_zip(zipped, info) for info in zipped.infolist())
    else:
        with gzip.open(archive) as stream:
            bounded = _Bounded(stream, limit)
            with tarfile.open(fileobj=cast(BinaryIO, bounded), mode="r:") as tar:
                yield (_of_tar(tar, info) for info in tar)
                bounded.read_padding()


def _of_zip(zipped: zipfile.ZipFile, info: zipfile.ZipInfo) -> Member:
    mode = info.external_attr >> 16
    kind = "folder" if info.is_dir() else "file"
    if stat.S_IFMT(mode) not in (0, stat.S_IFREG, stat.S_IFDIR):
        kind = "link or device"
    if info.flag_bits & 1 or info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        kind = "file that is encrypted or packed in an unusual way"
    return Member(info.filename, kind, info.file_size, lambda: zipped.open(info))


def _of_tar(tar: tarfile.TarFile, info: tarfile.TarInfo) -> Member:
    kind = "file" if info.isreg() and not info.issparse() else "folder" if info.isdir() else "link or device"
    return Member(info.name, kind, info.size, lambda: tar.extractfile(info))


def _inner_parts(archive: Path, member: Member) -> tuple[str, ...]:
    """The parts of a member's path. Raises InputError where it is no file or folder, or would lie elsewhere."""
    name = member.name
    path = PurePosixPath(name)
    if path.is_absolute() or ".." in path.parts or "\\" in name or ":" in name or not name.isprintable():
        raise InputError(f"{archive}: {name!r} would be written elsewhere; it is not unpacked")
    if member.kind not in ("file", "folder"):
        raise InputError(f"{archive}: {name!r} is a {member.kind}; only files and folders are unpacked")
    return path.parts


def _write(archive: Path, member: Member, to: Path) -> None:
    if member.kind == "folder":
        to.mkdir(parents=True, exist_ok=True)
        return
    to.parent.mkdir(parents=True, exist_ok=True)
    source = member.open()
    if source is None:
        raise InputError(f"{archive}: {member.name!r} cannot be read")
    try:
        with source, to.open("xb") as f:
            left = member.size
            while data := source.read(min(CHUNK, left)):
                f.write(data)
                left -= len(data)
    except FileExistsError as e:
        raise InputError(f"{archive}: holds {member.name!r} twice; it is not unpacked") from e
    if left:
        raise InputError(f"{archive}: {member.name!r} ends early; remove it to fetch it again")


class _Bounded:
    """A stream that refuses to be read or skipped beyond a limit, or as one large header."""

    def __init__(self, stream: BinaryIO | gzip.GzipFile, limit: int) -> None:
        self._stream = stream
        self._limit = limit + MEMBERS * tarfile.BLOCKSIZE

    def read(self, size: int) -> bytes:
        """As a file does."""
        if size > HEADER:
            raise tarfile.ReadError(f"a header of {size} bytes")
        return self._stream.read(size)

    def seek(self, position: int) -> int:
        """As a file does."""
        if position > self._limit:
            raise tarfile.ReadError(f"goes on after {self._limit / 1e6:.0f} MB")
        return self._stream.seek(position)

    def tell(self) -> int:
        """Where it stands."""
        return self._stream.tell()

    def read_padding(self) -> None:
        """Read to the end, so that the checksum of the stream is compared; only zeros follow the last member."""
        while data := self._stream.read(CHUNK):
            self.seek(self.tell())
            if data.count(0) != len(data):
                raise tarfile.ReadError("a header cannot be read")
