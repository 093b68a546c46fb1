"""Logs become one stream of frames. Imported as ``vlmm_log.readers``.

A reader is an object with ``name``, ``recognises(path)`` and ``open(path, settings)``; it stands in READERS.
"""

from __future__ import annotations

from pathlib import Path
from typing import cast

from vlmm_log.protocols import Log, Reader
from vlmm_log.readers.bag.log import Bag
from vlmm_log.readers.bonn import Bonn
from vlmm_log.readers.own import Own
from vlmm_log.readers.plain import Icl, Plain
from vlmm_log.readers.seven_scenes import SevenScenes
from vlmm_log.readers.thor import Thor
from vlmm_log.readers.tum import Tum
from vlmm_log.settings import ReadSettings
from vlmm_log.types import InputError

READERS: tuple[Reader, ...] = (Bonn(), Icl(), Tum(), Bag(), Thor(), SevenScenes(), Plain())
KINDS = "rgb.txt and depth.txt, rgb/ and depth/, frame-000000.color.png, .bag, .db3 or .mcap"


def recognise(path: Path) -> Reader:
    """The first reader that knows the path. Raises InputError where none does."""
    if not path.exists():
        raise InputError(f"{path}: no such file or folder")
    for reader in READERS:
        if reader.recognises(path):
            return reader
    inside = sorted(p.name for p in path.iterdir() if p.is_dir()) if path.is_dir() else []
    logs = [name for name in inside if any(reader.recognises(path / name) for reader in READERS)]
    hint = f"; it holds logs, take one: {', '.join(logs[:5])}" if logs else ""
    raise InputError(f"{path}: no known kind of log ({KINDS}){hint}")


def opened(source: str | Path | Log, s: ReadSettings) -> tuple[Log, str]:
    """The log of a path, or a log that is open already, and its reader's name. Raises InputError."""
    if isinstance(source, str | Path):
        path = Path(source)
        reader = recognise(path)
        return reader.open(path, s), reader.name
    return cast(Log, Own(source)), type(source).__name__


def open_log(path: str | Path, s: ReadSettings | None = None) -> Log:
    """The log at a path, its lists read and its images not yet. Raises InputError where it cannot be used."""
    return opened(path, s or ReadSettings())[0]
