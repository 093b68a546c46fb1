"""Folders written beside and renamed, so that no reader meets half of one."""

from __future__ import annotations

import ctypes
import os
import shutil
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from vlmm_log.outputs import takes_files
from vlmm_log.types import InputError

LOGS = ("metadata.yaml", "rgb.txt")  # of which a log's folder holds one
REPLACED = "replaced"
HERE, EXCHANGE = -100, 2  # of renameat2


def is_log(folder: Path) -> bool:
    """Whether a folder is a log, as ``convert`` and ``simulate`` write them."""
    return any((folder / name).is_file() for name in LOGS)


def claim_folder(
    path: Path, inputs: Iterable[Path], *, force: bool, replaceable: Callable[[Path], bool] = is_log
) -> None:
    """Refuse before a long run what could not be written after it.

    Raises InputError where the name is an input (or another output) or holds one, is taken (without ``force``), or
    lies where no folder can be made. With ``force`` too, only what is ``replaceable`` is replaced.
    """
    try:
        full, partial = path.resolve(), _partial(path)
        for source in (name.resolve() for name in inputs):
            if source.is_relative_to(full) or source.is_relative_to(partial.resolve()):
                raise InputError(f"{path}: is or holds {source}, which the run needs; name another folder")
        _check_free(path, replaceable if force else None)
        _check_free(partial, (lambda _: True) if force else None)
        there = next(parent for parent in full.parents if parent.exists())
    except (OSError, ValueError) as e:
        raise InputError(f"{path!s}: cannot be written: {e}; name another folder") from e
    if not takes_files(there):
        raise InputError(f"{path}: cannot be written: no folders can be made in {there}")


@contextmanager
def replacing_folder(path: Path) -> Iterator[Path]:
    """A folder of the same name to make and fill, in ``NAME.partial``. It takes the place of ``path`` in the end.

    If the block fails, it is removed and nothing is replaced. ``path`` was claimed before. Raises InputError where
    the disk refuses.
    """
    partial = _partial(path)
    staged = partial / path.resolve().name
    try:
        try:
            _put_back(partial / REPLACED, path)
            _remove(partial)
            partial.mkdir(parents=True)
            yield staged
            _put(staged, path, partial / REPLACED)
        finally:
            _remove(partial)
    except OSError as e:
        raise InputError(f"{path}: cannot be written: {e.strerror or e}; nothing was replaced") from e


def _put(staged: Path, path: Path, aside: Path) -> None:
    """Rename one folder to the place of another one, in one step where the system can, so that a kill loses neither.

    Elsewhere the other one is put aside, and back if that fails.
    """
    if not path.exists():
        staged.replace(path)
        return
    if _exchanged(staged, path):
        return
    path.replace(aside)
    try:
        staged.replace(path)
    except OSError:
        aside.replace(path)
        raise


def _exchanged(a: Path, b: Path) -> bool:
    """Whether two folders bear each other's names now: Linux can do that."""
    try:
        renameat2 = ctypes.CDLL(None).renameat2
    except (AttributeError, OSError):
        return False
    return bool(renameat2(HERE, os.fsencode(a), HERE, os.fsencode(b), EXCHANGE) == 0)


def _put_back(aside: Path, path: Path) -> None:
    """What a run put aside that was killed before it put another one in its place."""
    if aside.exists() and not path.exists():
        aside.replace(path)


def _partial(path: Path) -> Path:
    full = path.resolve()
    return path.parent / (full.name + ".partial") if path.name else full.with_name(full.name + ".partial")


def _check_free(path: Path, replaceable: Callable[[Path], bool] | None) -> None:
    if path.exists() and not path.is_dir():  # a device's name could be replaced too
        raise InputError(f"{path}: is no folder; name a folder")
    if not path.is_dir() or not any(path.iterdir()):
        return
    if replaceable is None:
        raise InputError(f"{path}: exists; give --force to replace it")
    if not replaceable(path):
        raise InputError(f"{path}: is a folder that holds other things, so it is not replaced; name another one")


def _remove(path: Path) -> None:
    if path.exists():
        shutil.rmtree(path)
