"""Where trained weights are found. Nothing is ever downloaded."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

from vlmm_log.types import InputError

RAFT_PREFERRED = ("raft-things.pth", "raft_large_C_T_SKHT_V2-ff5fadd5.pth")


def find_raft(given: str) -> Path:
    """The RAFT weights file: as given (file or folder), else in VLMM_LOG_WEIGHTS, else in the user's cache.

    In a folder, a preferred name wins, then the first ``raft*.pth`` by name. Raises InputError, which says where
    was looked.
    """
    if given and Path(given).is_file():
        return Path(given)
    if given and not Path(given).is_dir():
        raise InputError(f"{given}: no such weights file or folder")
    folders = [Path(given)] if given else [*_from_environment(), user_cache()]
    for folder in folders:
        found = sorted(folder.glob("raft*.pth"))
        preferred = [folder / name for name in RAFT_PREFERRED if folder / name in found]
        if found:
            return (preferred or found)[0]
    raise InputError(
        f"no RAFT weights (raft*.pth) in {', '.join(str(f) for f in folders)}; "
        "give --weights FILE, or use --flow dis, which needs none"
    )


def user_cache() -> Path:
    """The folder for weights of this user."""
    base = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA") or str(Path.home() / ".cache")
    return Path(base) / "vlmm-log" / "weights"


def fingerprint(path: Path) -> str:
    """Name and SHA-256 of a weights file."""
    with path.open("rb") as f:
        return f"{path.name} sha256:{hashlib.file_digest(f, 'sha256').hexdigest()}"


def _from_environment() -> list[Path]:
    value = os.environ.get("VLMM_LOG_WEIGHTS")
    return [Path(value)] if value else []
