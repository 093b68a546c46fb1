"""What a run's results put into a recording, as entries: the same whatever container they go to."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from vlmm_log.elements import Sightings, Tracked, WorldMap
from vlmm_log.entries import EGO_UNRELIABLE, Column, Entry, LabelNames, LogLine, Scalar, StateNames, Table
from vlmm_log.protocols import Moment, Result
from vlmm_log.queries import Answer
from vlmm_log.sinks import pair_entries as of_pair
from vlmm_log.sinks.digest import digest
from vlmm_log.sinks.map_entries import MapEntries
from vlmm_log.sinks.pair_entries import IMAGE, Named
from vlmm_log.sinks.stages import stage_of
from vlmm_log.sinks.views import VALIDITY_COLORS
from vlmm_log.types import (
    Ego,
    FlowField,
    Frame,
    FramePair,
    Judgement,
    Motion,
    Odometry,
    Posterior,
    RunEnd,
    Segments,
    Skipped,
)

VALIDITY_NAMES = LabelNames(tuple((int(v), v.name.lower(), color) for v, color in VALIDITY_COLORS.items()))
STILL = LabelNames | StateNames  # what holds for the whole recording


REMEMBERED = FramePair | Skipped | Odometry | Sightings | Tracked | WorldMap | Answer | Judgement
"""What is told by what came before it. All else a pair shows by itself."""


@dataclass(frozen=True)
class Told:
    """What recordings keep of one result, whenever it came."""

    stage: str
    named: tuple[Named, ...]
    digest: int


def told(result: Result, pair: FramePair, *, dense: bool) -> Told:
    """Of a result that a pair shows by itself: the costly part of recording it, wherever that is done."""
    return Told(stage_of(result) or "", tuple(_of_pair(result, pair, dense=dense)), digest(result))


def _of_pair(result: Result, pair: FramePair, *, dense: bool) -> Iterator[Named]:
    match result:
        case FlowField():
            yield from of_pair.of_flow(result, dense=dense)
        case Segments():
            yield from map(_warning, result.notes)
        case Ego():
            yield from of_pair.of_ego(result)
            if not result.reliable:
                share = f"{result.matches} matches, inlier share {result.inlier_share:.2f}"
                yield _warning(f"{EGO_UNRELIABLE}: {share}; do not trust this pair")
        case Motion():
            if not result.valid_share:
                yield _warning("no pixel of this pair could be scored")
            yield from of_pair.of_motion(pair, result, dense=dense)
        case Posterior():
            yield from of_pair.of_posterior(result, dense=dense)
        case _:
            pass


class Content:
    """Results to entries. Remembers what was said already, so that it is said once."""

    def __init__(self, *, dense: bool) -> None:
        self._dense = dense
        self._map = MapEntries()
        self._pair: FramePair | None = None
        self._camera: bytes = b""
        self._judged = False
        self._digests: dict[str, int] = {}  # stage -> digest of its result, of the pair in hand
        self._at = Moment(0, None, 0.0)
        self._of_pair = self._at

    def begin(self) -> Iterator[Entry]:
        """What is known before the first result."""
        yield Entry(f"{IMAGE}/validity", VALIDITY_NAMES, None, None)

    def of(self, result: Result, at: Moment) -> Iterator[Entry]:
        """The entries of one result."""
        if isinstance(result, FramePair):
            yield from self._ended_pair()
            self._pair, self._of_pair = result, at
        if not isinstance(result, REMEMBERED):
            assert self._pair is not None, "a pair comes before what it shows"
            yield from self.take(told(result, self._pair, dense=self._dense), at)
            return
        yield from self._told(stage_of(result), self._named(result, at), at)
        if not isinstance(result, Skipped):
            name = stage_of(result) or "input"
            self._digests[name] = digest((self._digests[name], result) if name in self._digests else result)

    def take(self, of_result: Told, at: Moment) -> Iterator[Entry]:
        """The entries of a result of which ``told`` was made."""
        yield from self._told(of_result.stage, of_result.named, at)
        self._digests[of_result.stage] = of_result.digest

    def _told(self, stage: str | None, named: Iterable[Named], at: Moment) -> Iterator[Entry]:
        self._at = at
        yield from _entries(named, at)
        if stage is not None:
            yield from _entries([(f"stats/stage_ms/{stage}", Scalar(at.elapsed_ms))], at)

    def rest(self, end: RunEnd) -> Iterator[Entry]:
        """What is left to say."""
        yield from self._ended_pair()
        lines = [("log", LogLine(text, "INFO")) for text in end.told]
        yield from _entries([*lines, *self._map.rest()], self._at)

    def _ended_pair(self) -> Iterator[Entry]:
        """Digests of all stages of a pair: what tells where two runs part, beyond what lean fields show."""
        if self._digests:
            columns: dict[str, Column] = {
                "stage": tuple(self._digests),
                "xxh3": np.array(list(self._digests.values()), np.uint64),
            }
            yield from _entries([("digests", Table(columns))], self._of_pair)
        self._digests = {}

    def _named(self, result: Result, at: Moment) -> Iterator[Named]:
        match result:
            case FramePair():
                yield from self._of_frame(result.first)
            case Skipped():
                yield _warning(f"{result.what}: {result.reason}")
            case Odometry():
                yield "world/camera", of_pair.of_pose(result.T_world_first)
            case Tracked():
                yield from self._map.of_tracked(result)
            case WorldMap():
                yield from self._map.of_world(result, at.index)
            case Answer():
                yield from self._map.of_answer(result)
            case Judgement():
                if not self._judged:
                    self._judged = True
                    yield from of_pair.JUDGED_NAMES.items()
                yield from of_pair.of_judgement(result, dense=self._dense)
            case _:
                pass

    def _of_frame(self, frame: Frame) -> Iterator[Named]:
        if frame.K.tobytes() != self._camera:
            self._camera = frame.K.tobytes()
            yield IMAGE, of_pair.of_camera(frame)
        yield from of_pair.of_images(frame)


def _entries(named: Iterable[Named], at: Moment) -> Iterator[Entry]:
    for entity, value in named:
        still = isinstance(value, STILL)
        yield Entry(entity, value, None if still else at.stamp_ns, None if still else at.index)


def _warning(text: str) -> Named:
    return "log", LogLine(text, "WARN")
