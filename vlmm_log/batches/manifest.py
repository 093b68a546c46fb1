"""``manifest.json``: the tasks of a batch's last call, and how they stand. docs/manifest.schema.json describes it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from vlmm_log.batches.tasks import Outcome, State
from vlmm_log.outputs import replacing
from vlmm_log.types import InputError

NAME = "manifest.json"
FORMAT, VERSION = "vlmm-log batch", 1


def report(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """The outcomes as plain values, in the order of the sources."""
    return {"format": FORMAT, "version": VERSION, "tasks": [_task(o) for o in outcomes]}


def write_manifest(out: Path, outcomes: Sequence[Outcome]) -> None:
    """Write how the tasks stand: what an earlier call finished is done. The same state keeps the file as it is."""
    tasks = report(outcomes)
    for task in tasks["tasks"]:
        task["state"] = State.DONE if task["state"] == State.SKIPPED else task["state"]
    replace_text(out / NAME, json.dumps(tasks, indent=1) + "\n")


def read_manifest(out: Path) -> list[Outcome]:
    """The tasks of a batch's folder; figures are in the folders named. Raises InputError."""
    path = out / NAME
    try:
        told = json.loads(path.read_text("utf-8"))
        if told["format"] != FORMAT:
            raise InputError(f"{path}: is no manifest of a batch")
        if told["version"] != VERSION:
            raise InputError(f"{path}: is version {told['version']}, this vlmm-log reads {VERSION}; install another")
        return [_outcome(task) for task in told["tasks"]]
    except OSError as e:
        raise InputError(f"{path}: cannot be read: {e.strerror or e}; give a folder that `vlmm-log batch` wrote") from e
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as e:
        raise InputError(f"{path}: is no manifest of a batch: {type(e).__name__}: {e}") from e


def is_batch(path: Path) -> bool:
    """Whether a folder is one that a batch wrote."""
    return (path / NAME).is_file()


def replace_text(path: Path, text: str) -> None:
    """Write a file beside and rename it; one that holds the same text is left alone. Raises InputError."""
    data = text.encode()
    if path.is_file() and path.read_bytes() == data:
        return
    with replacing(path, force=True) as (partial,):
        partial.write_bytes(data)


def _task(o: Outcome) -> dict[str, Any]:
    return {
        "source": o.source,
        "folder": o.folder or None,
        "state": o.state,
        "error": o.error or None,
        "seconds": o.seconds,
        "pairs": o.pairs if o.row else None,
        "hash": o.hash or None,
    }


def _outcome(task: dict[str, Any]) -> Outcome:
    texts = {name: str(task[name] or "") for name in ("source", "error", "folder", "hash")}
    row = {} if task["pairs"] is None else {"pairs": int(task["pairs"])}
    if Path(texts["folder"]).name != texts["folder"] or texts["folder"] == "..":
        raise ValueError("a folder is no bare name")
    return Outcome(**texts, state=State(task["state"]), seconds=task["seconds"], row=row)
