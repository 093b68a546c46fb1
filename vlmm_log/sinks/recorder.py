"""A run's recordings: what is to be recorded is made once, and goes to every container."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Protocol

from vlmm_log.entries import Entry
from vlmm_log.protocols import Make, Moment, Result
from vlmm_log.sinks.content import Content, Told, told
from vlmm_log.types import FramePair, InputError, RunEnd


class Container(Protocol):
    """An open file of entries."""

    def put(self, entry: Entry) -> None:
        """Write one entry."""
        ...

    def pair_begins(self) -> None:
        """Whatever came before is worth keeping."""
        ...

    def finish(self, end: RunEnd) -> None:
        """Write how the run ended, and make the file whole. Raises OSError where it is not."""
        ...


@dataclass
class Recording:
    """A container that is written beside its place."""

    path: Path
    container: Container
    written: Path | None = None  # once closed: where it lies, None if it holds no pair

    @property
    def partial(self) -> Path:
        """Where it is written, and stays if the run is interrupted: readable."""
        return _partial(self.path)


def open_recording(path: Path, container: Callable[[Path], Container]) -> Recording:
    """A recording that will be ``path``. Raises InputError where it cannot be written."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return Recording(path, container(_partial(path)))
    except OSError as e:
        with suppress(OSError):
            _partial(path).unlink()
        raise InputError(f"{path}: cannot be written: {e.strerror or e}") from e


def abandon(recordings: Iterable[Recording]) -> None:
    """Let go of recordings of which nothing was written, and leave no file."""
    for recording in recordings:
        with suppress(InputError):
            _finish(recording, (), RunEnd(complete=False, input_hash="", frames=0, pairs=0))


class Recorder:
    """Writes recordings beside their paths and renames them once they are complete.

    An interrupted run's recordings stay as ``path`` + ".partial", readable; one without a pair is removed.
    """

    def __init__(self, recordings: Sequence[Recording], *, dense: bool) -> None:
        self.recordings = recordings
        self.made: Make = partial(told, dense=dense)
        self._content = Content(dense=dense)
        self._put(self._content.begin())

    def write(self, result: Result, at: Moment) -> None:
        """Record one result at its frame and time. Raises InputError where the disk takes no more."""
        if isinstance(result, FramePair):
            self._each(lambda container: container.pair_begins())
        self._put(self._content.of(result, at))

    def take(self, made: Told, at: Moment) -> None:
        """See protocols.Halved."""
        self._put(self._content.take(made, at))

    def close(self, end: RunEnd) -> None:
        """Finish all recordings, and put the complete ones in their place.

        Raises InputError where one could not be written whole; then it replaces nothing, and the others are kept.
        """
        rest = list(self._content.rest(end))
        errors = []
        for recording in self.recordings:
            try:
                _finish(recording, rest, end)
            except InputError as e:
                errors.append(e)
        if errors:
            for other in errors[1:]:
                errors[0].add_note(f"then: {other}")
            raise errors[0]

    def _put(self, entries: Iterable[Entry]) -> None:
        for entry in entries:
            self._each(lambda container, entry=entry: container.put(entry))  # type: ignore[misc]

    def _each(self, act: Callable[[Container], None]) -> None:
        for recording in self.recordings:
            try:
                act(recording.container)
            except OSError as e:
                raise _unwritable(recording, e) from e


def _partial(path: Path) -> Path:
    return path.with_name(path.name + ".partial")


def _finish(recording: Recording, rest: Iterable[Entry], end: RunEnd) -> None:
    try:
        _close(recording, rest, end)
        if end.pairs and end.complete:
            recording.partial.replace(recording.path)
            recording.written = recording.path
    except OSError as e:
        raise _unwritable(recording, e) from e


def _close(recording: Recording, rest: Iterable[Entry], end: RunEnd) -> None:
    """Let go of the container, also on a full disk: what that took can be read."""
    held = replace(end, complete=False)
    try:
        for entry in rest:
            recording.container.put(entry)
        held = end
    finally:
        try:
            recording.container.finish(held)
        finally:
            if end.pairs:
                recording.written = recording.partial
            else:
                recording.partial.unlink(missing_ok=True)


def _unwritable(recording: Recording, e: OSError) -> InputError:
    return InputError(f"{recording.partial}: cannot be written, is the disk full? ({e.strerror or e})")
