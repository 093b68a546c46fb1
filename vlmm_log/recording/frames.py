"""What a recording holds of one frame, frame by frame: a few values in memory, however long it is."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass

from vlmm_log.entries import EGO_UNRELIABLE, Entry, LogLine, Look, Scalar, Value
from vlmm_log.recording import Recording, is_mcap

EVERY_PAIR = ("world/camera", "digests", "stats/inlier_share", "stats/valid_share")
FIGURES = {  # entity -> field of PairFigures
    "stats/median_d_m": "median_d_m",
    "stats/flagged_share": "flagged_share",
    "stats/inlier_share": "inlier_share",
}
AHEAD = 64  # frames
NAN = float("nan")


@dataclass(frozen=True)
class PairFigures:
    """What a recording says of a pair in a line."""

    stamp_ns: int
    median_d_m: float = NAN  # sigmas; NaN: none was scored
    flagged_share: float = NAN  # of the scored pixels
    inlier_share: float = NAN  # of ego-refinement; NaN: off
    ego_reliable: bool = True


def pairs(recording: Recording) -> dict[int, PairFigures]:
    """Figures of every pair by frame index, ascending, from what is small. Raises InputError as ``entries`` does."""
    stamps: dict[int, int] = {}
    figures: dict[int, dict[str, float]] = {}
    unreliable: set[int] = set()
    for e in recording.entries({*EVERY_PAIR, *FIGURES, "log"}):
        if e.index is None or e.stamp_ns is None:
            continue
        if e.entity in EVERY_PAIR:
            stamps[e.index] = e.stamp_ns
        match e.value:
            case Scalar(value) if e.entity in FIGURES:
                figures.setdefault(e.index, {})[FIGURES[e.entity]] = value
            case LogLine(text, _) if text.startswith(EGO_UNRELIABLE):
                unreliable.add(e.index)
            case _:
                pass
    return {i: PairFigures(stamps[i], **figures.get(i, {}), ego_reliable=i not in unreliable) for i in sorted(stamps)}


def by_frame(
    recording: Recording, entities: Collection[str], frames: Sequence[int]
) -> Iterator[tuple[int, dict[str, Value]]]:
    """Index and values by entity of some frames, which ascend; an entity that has none there is left out.

    Raises InputError where the recording cannot be read.
    """
    wanted = frozenset(frames)
    # An MCAP file has a frame's values beside each other, a Rerun recording an entity's.
    groups = [sorted(entities)] if is_mcap(recording.path) else [[entity] for entity in sorted(entities)]
    streams = [_Stream(recording.entries(group, wanted)) for group in groups]
    for index in frames:
        yield index, {entry.entity: entry.value for stream in streams for entry in stream.of(index)}


class _Stream:
    """Entries by frame, as many read ahead as it takes to find those that were written late."""

    def __init__(self, entries: Iterator[Entry]) -> None:
        self._entries = entries
        self._ahead: dict[int, list[Entry]] = {}
        self._newest = -1

    def of(self, index: int) -> list[Entry]:
        """The entries of a frame. Those of earlier ones are let go."""
        for passed in [i for i in self._ahead if i < index]:
            del self._ahead[passed]
        while (self._newest <= index or index not in self._ahead) and len(self._ahead) < AHEAD:
            entry = next(self._entries, None)
            if entry is None:
                break
            if entry.index is not None and entry.index >= index and not isinstance(entry.value, Look):
                self._ahead.setdefault(entry.index, []).append(entry)
                self._newest = max(self._newest, entry.index)
        return self._ahead.pop(index, [])
