"""What a task's output depends on, as one hash."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator, Mapping
from pathlib import Path


def content_digest(path: Path) -> str:
    """SHA-256 (hex) of a file's bytes; of a folder, over the names, sizes and SHA-256 of all files in it.

    Every byte is read: about a second a gigabyte. Links are followed. The name of ``path`` itself does not count.
    Raises OSError.
    """
    if not path.is_dir():
        return _file_digest(path)
    whole = hashlib.sha256()
    for name in sorted(_files(path)):
        file = path / name
        whole.update(f"{name}\0{file.stat().st_size}\0{_file_digest(file)}\n".encode("utf-8", "surrogateescape"))
    return whole.hexdigest()


def fingerprint(parts: Mapping[str, str]) -> str:
    """SHA-256 (hex) of named texts, in whatever order they come."""
    text = "".join(f"{name}\0{len(parts[name])}\0{parts[name]}\n" for name in sorted(parts))
    return hashlib.sha256(text.encode("utf-8", "surrogateescape")).hexdigest()


def _file_digest(path: Path) -> str:
    with path.open("rb") as f:
        return hashlib.file_digest(f, "sha256").hexdigest()


def _files(folder: Path) -> Iterator[str]:
    """Names of all files below, with slashes. A folder that holds itself by a link is entered once."""
    entered = {folder.resolve()}
    for root, folders, names in os.walk(folder, followlinks=True):
        here = Path(root)
        new = [name for name in folders if (here / name).resolve() not in entered]
        entered |= {(here / name).resolve() for name in new}
        folders[:] = sorted(new)
        yield from ((here / name).relative_to(folder).as_posix() for name in names if (here / name).is_file())
