"""A batch's folder: a folder a log, made beside and renamed once it is whole. One batch at a time writes there."""

from __future__ import annotations

import json
import os
import re
import secrets
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from vlmm_log.locks import locked
from vlmm_log.types import InputError

FIGURES, LOCK = "figures.json", ".lock"
FORMAT, VERSION = "vlmm-log figures", 1
STAGED = re.compile(r".+\.partial-[0-9a-f]{8}")
LONGEST = 100  # characters of a log's name that its folder bears


def folder_name(log: str, fingerprint: str) -> str:
    """The log's name without what shells and terminals take amiss, and 12 hex digits."""
    plain = "".join(c if c.isalnum() or c in "._-" else "_" for c in log).strip(".-")
    return f"{plain[:LONGEST] or 'log'}-{fingerprint[:12]}"


def figures(folder: Path, fingerprint: str) -> dict[str, Any] | None:
    """What a finished task told of itself; None where the folder is not whole or was made of something else."""
    try:
        told = json.loads((folder / FIGURES).read_text("utf-8"))
        known = (told["format"], told["version"], told["hash"]) == (FORMAT, VERSION, fingerprint)
        whole = all((folder / name).stat().st_size == size for name, size in told["files"].items())
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None
    return dict(told) if known and whole else None


@contextmanager
def staged(folder: Path) -> Iterator[Path]:
    """A folder to fill, which takes the name ``folder`` once the block is done; it is removed where that fails.

    What lies there is put aside first: it was not whole. Where somebody else finished the same meanwhile, theirs stays.
    """
    staging = _beside(folder)
    staging.mkdir(parents=True)
    try:
        yield staging
        try:
            staging.rename(folder)
        except OSError:
            if figures(folder, _told_hash(staging)) is None:
                folder.rename(_beside(folder))  # swept later
                staging.rename(folder)
    finally:
        shutil.rmtree(staging, ignore_errors=True)


def write_figures(staging: Path, told: Mapping[str, Any]) -> None:
    """Write what a task tells of itself, after its other files: their sizes are in it."""
    files = {path.name: path.stat().st_size for path in sorted(staging.iterdir())}
    whole = {"format": FORMAT, "version": VERSION, **told, "files": files}
    with (staging / FIGURES).open("w", encoding="utf-8") as f:
        f.write(json.dumps(whole, indent=1) + "\n")
        f.flush()
        os.fsync(f.fileno())


def sweep(out: Path) -> None:
    """Remove what interrupted tasks left."""
    for path in out.iterdir():
        if path.is_dir() and STAGED.fullmatch(path.name):
            shutil.rmtree(path, ignore_errors=True)


@contextmanager
def claimed(out: Path, sources: Iterable[Path]) -> Iterator[None]:
    """The batch's folder, made where it is missing, and closed to other batches on this machine within the block.

    Raises InputError where it is a file, lies in a source, cannot be written, or another batch writes there.
    """
    if out.exists() and not out.is_dir():
        raise InputError(f"{out}: is a file; name a folder for the batch")
    for source in sources:
        if out.resolve().is_relative_to(source.resolve()):
            raise InputError(f"{out}: lies in the log {source}, and would change it; name another folder")
    try:
        out.mkdir(parents=True, exist_ok=True)
        lock = (out / LOCK).open("a")
    except OSError as e:
        raise InputError(f"{out}: cannot be written: {e.strerror or e}; name another folder") from e
    with lock:
        if locked(lock.fileno()) is False:
            raise InputError(f"{out}: another batch writes there; wait for it, or name another folder")
        sweep(out)
        try:
            yield
        finally:
            sweep(out)


def _beside(folder: Path) -> Path:
    return folder.with_name(f"{folder.name}.partial-{secrets.token_hex(4)}")


def _told_hash(staging: Path) -> str:
    return str(json.loads((staging / FIGURES).read_text("utf-8"))["hash"])
