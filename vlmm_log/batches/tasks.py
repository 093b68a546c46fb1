"""The nouns of a batch: a task and its outcome, plain enough to travel between processes and machines."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any

RECORDINGS = ("rrd", "mcap")


class State(StrEnum):
    """How a task stands."""

    PENDING = "pending"  # did not end: the call was interrupted
    DONE = "done"
    SKIPPED = "skipped"  # was done by an earlier call
    FAILED = "failed"


@dataclass(frozen=True)
class Task:
    """One log, and what is to be made of it."""

    source: str  # absolute path
    out: str  # absolute path of the batch's folder
    settings: str  # TOML, whole; {source} in it stands for the log's path
    queries: tuple[str, ...] = ()
    recordings: tuple[str, ...] = ("rrd",)  # of RECORDINGS

    @property
    def name(self) -> str:
        """The log's, as its folder or file is called."""
        return Path(self.source).name


@dataclass(frozen=True)
class Outcome:
    """What came of a task."""

    source: str
    state: State
    error: str = ""  # one line
    folder: str = ""  # name in the batch's folder; empty where it is not known
    hash: str = ""  # SHA-256 that the folder is named by
    seconds: float | None = None  # that the log took when it was processed
    row: Mapping[str, Any] = field(default_factory=dict)  # figures of the run, flat

    @property
    def name(self) -> str:
        """The log's, as its folder or file is called."""
        return Path(self.source).name

    @property
    def pairs(self) -> int:
        """Keyframe pairs that were processed."""
        return int(self.row.get("pairs", 0))


Work = Callable[[Task], Outcome]
Running = Generator[Outcome, None, None]
"""The outcomes of tasks as they end; closing it ends what runs."""


def failed(task: Task, error: str) -> Outcome:
    """The outcome of a task that could not be done: the same as often as it fails alike."""
    return Outcome(task.source, State.FAILED, "; ".join(error.splitlines()))
