"""Files written beside and renamed, so that no reader meets half of one."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from vlmm_log.types import InputError


@contextmanager
def replacing(*paths: Path, force: bool) -> Iterator[list[Path]]:
    """Names to write to, ``NAME.partial`` each. They take the place of ``paths``, in order, once the block is done.

    If it fails, they are removed and nothing is replaced. Raises InputError where something of the name exists
    (without ``force``) or the disk refuses.
    """
    partials = [path.with_name(path.name + ".partial") for path in paths]
    try:
        for path in (*paths, *partials):
            check_free(path, force)
        try:
            for path in paths:
                path.parent.mkdir(parents=True, exist_ok=True)
            yield partials
            for partial in partials:
                with partial.open("rb+") as f:
                    os.fsync(f.fileno())
            for partial, path in zip(partials, paths, strict=True):
                partial.replace(path)
        except BaseException:
            for partial in partials:
                partial.unlink(missing_ok=True)
            raise
    except OSError as e:
        raise InputError(f"{e.filename or paths[0]}: cannot be written: {e.strerror or e}; nothing was replaced") from e


def claim(
    paths: Iterable[Path],
    *,
    force: bool,
    inputs: Iterable[Path] = (),
    unfinished: bool = False,
    ours: Collection[Path] = (),
) -> None:
    """Refuse before a long run what could not be written after it.

    ``unfinished``: what an earlier run left as NAME.partial may be replaced; ``ours``: whole outputs that it had put in
    place already. Raises InputError where a name is a folder, taken (without ``force``), an input, named twice, or in a
    place that takes no file.
    """
    read = {path.resolve() for path in inputs}
    taken: set[Path] = set()
    for path in paths:
        if not path.name:
            raise InputError(f"{str(path)!r}: names no file")
        partial = path.with_name(path.name + ".partial")
        try:
            check_free(path, force or path.resolve() in ours)
            check_free(partial, force or unfinished)
            where = {path.resolve(), partial.resolve()}
            there = next(parent for parent in path.resolve().parents if parent.exists())
        except OSError as e:
            raise InputError(f"{path}: cannot be written: {e.strerror or e}; name another file") from e
        if where & read:
            raise InputError(f"{path}: is the input; name another file")
        if where & taken:
            raise InputError(f"{path}: is named for two outputs; name two files")
        if not takes_files(there):
            raise InputError(f"{path}: cannot be written: no files can be made in {there}")
        taken |= where


def takes_files(folder: Path) -> bool:
    """Whether files can be made in a folder: tried, since permissions do not tell of mounts and of root."""
    try:
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return False
    return True


def check_free(path: Path, force: bool) -> None:
    """Raises InputError where a name is taken (without ``force``), or can be no file's."""
    if "\0" in str(path):
        raise InputError(f"{path!s}: is no name of a file")
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise InputError(f"{path}: is no file, a device or a pipe; name a file")
    if path.is_dir():
        raise InputError(f"{path}: is a folder; name a file, for example {path / 'out'}")
    if path.exists() and not force:
        raise InputError(f"{path}: exists; give --force to replace it")
