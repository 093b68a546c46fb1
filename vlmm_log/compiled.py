"""Numeric kernels compiled by numba, and where they are kept between runs."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

from vlmm_log.cache import kernels_folder

F = TypeVar("F", bound=Callable[..., Any])
KEPT = 24  # rooms' kernels, of a few versions of this package side by side


# No fastmath: what it reorders depends on which parts a cache held when the rest was compiled, and equal runs would
# differ in their last bits. It gains 4 %.
def jit(kernel: F) -> F:
    """Compiled once for this user: the install may be read-only, and a file's own date does not tell what it calls."""
    njit = partial(numba.njit, error_model="numpy", nogil=True)
    config: Any = numba.config
    before = config.CACHE_DIR
    config.CACHE_DIR = before or str(_cache(Path(kernel.__code__.co_filename).parent))
    try:
        return cast("F", njit(cache=True)(kernel))
    except (RuntimeError, OSError):  # no folder that can be written
        return cast("F", njit()(kernel))
    finally:
        config.CACHE_DIR = before


@cache
def _cache(room: Path) -> Path:
    """A folder for these very kernels."""
    folder = kernels_folder(room)
    if not folder.exists():
        _forget(folder.parent)
    return folder


def _forget(kept: Path) -> None:
    """Remove all but the newest kernels: an upgrade leaves old ones behind."""
    try:
        old = sorted((f for f in kept.iterdir() if f.is_dir()), key=lambda f: f.stat().st_mtime)[:-KEPT]
    except OSError:  # none yet, or another process does the same
        return
    for folder in old:
        shutil.rmtree(folder, ignore_errors=True)
