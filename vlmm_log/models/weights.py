"""Where trained weights are found. Nothing is ever downloaded."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from pathlib import Path

from vlmm_log.cache import cache_folder
from vlmm_log.types import InputError

RAFT_FILES = ("raft-things.pth", "raft_large_C_T_SKHT_V2-ff5fadd5.pth", "raft*.pth")  # the preferred ones first
CLIP_FILES = ("ViT-B-16*.safetensors", "ViT-B-16*.pt", "open_clip*.safetensors")


def find_raft(given: str) -> Path:
    """The RAFT weights file: as given (file or folder), else in VLMM_LOG_WEIGHTS, else in the user's cache.

    In a folder, the first of RAFT_FILES wins, then the first by name. Raises InputError, which says where was looked.
    """
    return _find(given, "RAFT", RAFT_FILES, "give --weights FILE, or use --flow dis, which needs none")


def find_clip(given: str) -> Path:
    """The weights file of open_clip's ViT-B/16: looked for as RAFT's is. Raises InputError, which says where."""
    remedy = "give --set objects.embedder=clip:FILE, or use words, which needs none"
    return _find(given, "CLIP", CLIP_FILES, remedy)


def user_cache() -> Path:
    """The folder for weights of this user."""
    return cache_folder("weights")


def fingerprint(path: Path) -> str:
    """Name and SHA-256 of a weights file."""
    with path.open("rb") as f:
        return f"{path.name} sha256:{hashlib.file_digest(f, 'sha256').hexdigest()}"


def reason(error: Exception) -> str:
    """The first line of what a loader says about a file; its kind where it says nothing."""
    return next(iter(str(error).splitlines()), type(error).__name__)[:120]


def _find(given: str, model: str, patterns: Sequence[str], remedy: str) -> Path:
    if given and Path(given).is_file():
        return Path(given)
    if given and not Path(given).is_dir():
        raise InputError(f"{given}: no such weights file or folder")
    folders = [Path(given)] if given else [*_from_environment(), user_cache()]
    for folder in folders:
        for pattern in patterns:
            if found := sorted(folder.glob(pattern)):
                return found[0]
    looked = ", ".join(str(folder) for folder in folders)
    raise InputError(f"no {model} weights ({', '.join(patterns)}) in {looked}; {remedy}")


def _from_environment() -> list[Path]:
    value = os.environ.get("VLMM_LOG_WEIGHTS")
    return [Path(value)] if value else []
