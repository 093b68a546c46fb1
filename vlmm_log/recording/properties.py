"""What a recording says of its run: texts and JSON, whose types nobody has checked."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from vlmm_log.maps.saved import WORLD_UP
from vlmm_log.settings import Settings
from vlmm_log.types import InputError, Run, RunEnd

TEXTS = ("source", "reader", "settings", "world_up")


def run_of(path: Path, told: Mapping[str, Any]) -> Run:
    """The run of texts, JSON in them where a value is none. Raises InputError where they are not of this version."""
    try:
        texts = {name: told[name] for name in TEXTS}
        versions, notes = json.loads(told["versions"]), json.loads(told["notes"])
        if not all(isinstance(x, str) for x in (*texts.values(), *versions.values(), *notes)):
            raise ValueError("a text is none")
        if texts["world_up"] not in WORLD_UP:
            raise ValueError("world_up is no axis")
        Settings.from_toml(texts["settings"], str(path))
        return Run(**texts, versions=dict(versions), has_poses=bool(told["has_poses"]), notes=tuple(notes))
    except (KeyError, ValueError, TypeError, AttributeError, RecursionError) as e:
        raise _not_ours(path, e) from e


def end_of(path: Path, told: Mapping[str, Any]) -> RunEnd:
    """What came of the run. Raises InputError as ``run_of`` does."""
    try:
        end = RunEnd(told["complete"], told["input_hash"], told["frames"], told["pairs"])
    except KeyError as e:
        raise _not_ours(path, e) from e
    kinds = (type(end.complete), type(end.input_hash), type(end.frames), type(end.pairs))
    if kinds != (bool, str, int, int):
        raise _not_ours(path, ValueError("the run's end is none"))
    return end


def _not_ours(path: Path, e: Exception) -> InputError:
    return InputError(f"{path}: its properties are not those of this version: {e}; process the log again")
