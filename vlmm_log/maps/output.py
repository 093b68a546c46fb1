"""Files written beside and renamed, so that no reader meets half of one."""

from __future__ import annotations

import os
from collections.abc import Iterator
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
            _check_free(path, force)
        try:
            paths[0].parent.mkdir(parents=True, exist_ok=True)
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
        raise InputError(f"{paths[0]}: cannot be written: {e.strerror or e}; nothing was replaced") from e


def _check_free(path: Path, force: bool) -> None:
    if "\0" in str(path):
        raise InputError(f"{path!s}: is no name of a file")
    if path.is_dir():
        raise InputError(f"{path}: is a folder; name a file")
    if path.exists() and not force:
        raise InputError(f"{path}: exists; give --force to replace it")
