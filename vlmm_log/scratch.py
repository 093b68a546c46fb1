"""Temporary folders. What a killed run left of them is removed by the next run that needs one."""

from __future__ import annotations

import os
import shutil
import tempfile
import weakref
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory

from vlmm_log.locks import locked

PREFIX = "vlmm-log-run-"  # of no other program: what is not locked is removed


def scratch(within: Path | None = None) -> TemporaryDirectory[str]:
    """A new folder, removed with the object, and by others once this process has died. Raises OSError."""
    room = within or Path(tempfile.gettempdir())
    _sweep(room)
    while True:
        folder = TemporaryDirectory(prefix=PREFIX, dir=room, ignore_cleanup_errors=True)
        with suppress(FileNotFoundError):  # swept by somebody before it was locked
            lock = os.open(folder.name, os.O_RDONLY)
            weakref.finalize(folder, os.close, lock)
            if locked(lock) is not False and Path(folder.name).exists():
                return folder


def _sweep(room: Path) -> None:
    """Remove this user's folders that no living process has locked."""
    for left in room.glob(f"{PREFIX}*"):
        with suppress(OSError):  # somebody else's, in use, or gone meanwhile
            if left.lstat().st_uid != os.getuid() or not left.is_dir() or left.is_symlink():
                continue
            lock = os.open(left, os.O_RDONLY)
            try:
                if locked(lock):
                    shutil.rmtree(left)
            finally:
                os.close(lock)
