"""What two runs say of themselves: settings, inputs, versions."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping
from typing import Any, TypedDict

from vlmm_log.comparison.difference import Change
from vlmm_log.comparison.tolerance import Choice
from vlmm_log.types import Run, RunEnd

CONCERNS = ("noise", "keyframes", "read", "flow", "gate", "ego", "objects", "tracks", "map", "query", "grid", "log")
"""Tables of settings, what decides most first: the noise model decides what counts as motion."""


COMPARED = ("settings", "inputs")  # by these names they are chosen or ignored, as entities are


class Changes(TypedDict):
    """What a Difference says of the runs themselves."""

    settings: tuple[Change, ...]
    inputs: tuple[Change, ...]
    about: tuple[Change, ...]


def changes(a: tuple[Run, RunEnd | None], b: tuple[Run, RunEnd | None], choice: Choice) -> Changes:
    """All that is told of both runs. What is not chosen is told, too, and no difference by itself."""
    settings, inputs = settings_changes(a[0].settings, b[0].settings), input_changes(a, b)
    about = about_changes(a[0], b[0])
    if not choice.takes("inputs"):
        inputs, about = (), (*inputs, *about)
    if not choice.takes("settings"):
        settings, about = (), (*settings, *about)
    return Changes(settings=settings, inputs=inputs, about=about)


def settings_changes(a: str, b: str) -> tuple[Change, ...]:
    """Settings (TOML) that are not the same, the noise model first, the profile they started from last."""
    x, y = dict(_flat(tomllib.loads(a))), dict(_flat(tomllib.loads(b)))
    names = [name for name in dict.fromkeys((*x, *y)) if _other(x.get(name), y.get(name))]
    return tuple(Change(name, x.get(name), y.get(name)) for name in sorted(names, key=_place))


def _place(name: str) -> int:
    table = name.partition(".")[0]
    return CONCERNS.index(table) if table in CONCERNS else len(CONCERNS)


def _flat(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in table.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def _other(a: object, b: object) -> bool:
    return a != b and not (a != a and b != b)


def input_changes(a: tuple[Run, RunEnd | None], b: tuple[Run, RunEnd | None]) -> tuple[Change, ...]:
    """What was read: its content, whether it has poses, which way is up. Of unfinished runs the content is unknown."""
    (run_a, end_a), (run_b, end_b) = a, b
    told = {"has_poses": (run_a.has_poses, run_b.has_poses), "world_up": (run_a.world_up, run_b.world_up)}
    if end_a is not None and end_b is not None and end_a.complete and end_b.complete:
        told = {"input_hash": (end_a.input_hash, end_b.input_hash), "frames": (end_a.frames, end_b.frames), **told}
    return tuple(Change(name, x, y) for name, (x, y) in told.items() if x != y)


def about_changes(a: Run, b: Run) -> tuple[Change, ...]:
    """What is worth knowing of a difference, and none by itself: names, readers, versions of libraries and weights."""
    told = [Change("source", a.source, b.source), Change("reader", a.reader, b.reader)]
    names = dict.fromkeys((*a.versions, *b.versions))
    told += [Change(f"version of {name}", a.versions.get(name), b.versions.get(name)) for name in names]
    told += [Change("note", note, None) for note in a.notes if note not in b.notes]
    told += [Change("note", None, note) for note in b.notes if note not in a.notes]
    return tuple(change for change in told if change.a != change.b)
