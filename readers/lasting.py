"""A log that goes away while it is read is told: what never was there costs its frames, this may be a whole disk."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TypeVar

from vlmm_log.readers.bag.containers import is_part
from vlmm_log.readers.numbered import COLOURS, DEPTHS
from vlmm_log.types import InputError

T = TypeVar("T")


def lasting(path: Path | None, items: Iterable[T]) -> Iterator[T]:
    """The items read of a log. Raises InputError after the last one if images or bags were lost or cut meanwhile."""
    before = {} if path is None else _files(path)
    yield from items
    now = {} if path is None else _files(path)
    lost = sorted(name for name, size in before.items() if now.get(name, -1) < size)
    if lost:
        raise InputError(f"{path}: {len(lost)} of its files were lost or cut while it was read, {lost[0]} one of them")


def _files(path: Path) -> dict[str, int]:
    """Bags with their sizes, bytes; images, which may be many, without."""
    if not path.is_dir():
        return {path.name: path.stat().st_size} if path.exists() else {}
    files = [Path(folder) / name for folder, _, names in os.walk(path) for name in names]
    parts = {str(p.relative_to(path)): p.stat().st_size for p in files if is_part(p) and p.exists()}
    return parts | {str(p.relative_to(path)): 0 for p in files if p.suffix.lower() in (*COLOURS, *DEPTHS)}
