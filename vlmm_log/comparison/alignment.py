"""Two recordings side by side: the values of one entity at one frame, as they stream."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Iterator
from dataclasses import dataclass

from vlmm_log.comparison.difference import Place
from vlmm_log.entries import Entry, Look, Value
from vlmm_log.recording import Recording

Key = tuple[str, int | None, int | None, str]  # entity, frame or else time, kind of value


@dataclass(frozen=True, eq=False)
class Match:
    """What two recordings hold of an entity at a frame. None: that one has nothing there."""

    entity: str
    at: Place
    a: Value | None
    b: Value | None
    late_ns: int = 0  # B's time minus A's


def matches(
    recordings: tuple[Recording, Recording], frames: tuple[Collection[int], Collection[int]], entities: Collection[str]
) -> Iterator[Match]:
    """All matches of some entities. ``frames`` are the indices of the pairs in each recording.

    Values are matched by frame index, or by time where they are of no frame, in the order of the file where an
    entity has several there. What only decides how a viewer draws is matched only where both recordings hold it.
    """
    looks = all(recording.looks for recording in recordings)
    for group in _groups(recordings, entities):
        waiting: tuple[dict[Key, deque[Entry]], dict[Key, deque[Entry]]] = ({}, {})
        streams = [recording.entries(group) for recording in recordings]
        for side, entry, last in _alternating(*streams):
            if isinstance(entry.value, Look) and not looks:
                continue
            partner = _partner(waiting, side, entry)
            if partner is not None:
                yield _match(*((entry, partner) if side == 0 else (partner, entry)))
            elif last or _alone(entry, frames[side], frames[1 - side], recordings[1 - side]):
                yield _unmatched(side, entry)
            else:
                waiting[side].setdefault(_key(entry), deque()).append(entry)
        for side in (0, 1):
            for left in waiting[side].values():
                yield from (_unmatched(side, entry) for entry in left)


def _groups(recordings: tuple[Recording, Recording], entities: Collection[str]) -> Iterator[list[str]]:
    """What is read at once: an entity, where that is cheap; then little waits. The small ones together."""
    if not all(recording.by_entity for recording in recordings):
        yield sorted(entities)
        return
    large = sorted(entity for entity in entities if entity.startswith("world/camera/image/"))
    yield from ([entity] for entity in large)
    yield sorted(set(entities) - set(large))


def _alternating(a: Iterator[Entry], b: Iterator[Entry]) -> Iterator[tuple[int, Entry, bool]]:
    """Both streams, the one that is behind first; with whether the other one has ended."""
    streams, at = [a, b], [-1, -1]
    running = [True, True]
    while any(running):
        side = 0 if running[0] and (at[0] <= at[1] or not running[1]) else 1
        entry = next(streams[side], None)
        if entry is None:
            running[side] = False
            continue
        at[side] = max(at[side], -1 if entry.index is None else entry.index)
        yield side, entry, not running[1 - side]


def _key(entry: Entry) -> Key:
    kind = entry.value.component if isinstance(entry.value, Look) else type(entry.value).__name__
    return entry.entity, entry.index, entry.stamp_ns if entry.index is None else None, kind


def _partner(waiting: tuple[dict[Key, deque[Entry]], ...], side: int, entry: Entry) -> Entry | None:
    key = _key(entry)
    others = waiting[1 - side].get(key)
    if not others:
        return None
    partner = others.popleft()
    if not others:
        del waiting[1 - side][key]
    return partner


def _alone(entry: Entry, own: Collection[int], others: Collection[int], other: Recording) -> bool:
    """Whether the other recording cannot hold a partner: then the entry need not wait for one.

    Of a run that was cut off, or a damaged file, the frames are not all known.
    """
    missing = entry.index is not None and entry.index in own and entry.index not in others
    whole = other.end is not None and not other.losses
    return (missing and whole) or entry.entity not in other.entities


def _match(a: Entry, b: Entry) -> Match:
    late_ns = 0 if a.stamp_ns is None or b.stamp_ns is None else b.stamp_ns - a.stamp_ns
    return Match(a.entity, Place(a.index, a.stamp_ns), a.value, b.value, late_ns)


def _unmatched(side: int, entry: Entry) -> Match:
    a, b = (entry.value, None) if side == 0 else (None, entry.value)
    return Match(entry.entity, Place(entry.index, entry.stamp_ns), a, b)
