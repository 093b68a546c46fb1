"""Approximate-time synchronisation of a stream: the pairing of ``stamps.associate`` with a bounded memory."""

from __future__ import annotations

import heapq
from bisect import bisect_left, insort
from collections import deque
from collections.abc import Generator, Iterable, Iterator
from dataclasses import dataclass, field

from vlmm_log.readers.stamps import SET_BACK, SORTED_IN, TOO_LATE
from vlmm_log.readers.stored import Kind, Shot
from vlmm_log.types import Skipped

LATENESS_NS = 2_000_000_000  # an image comes at most so much later than one with a later stamp
MOST_WAITING = 2000  # of a kind; cameras take hundreds in the time that images may be late
STRAGGLERS = 4  # images in a row that come later than that: their clock was set back
Pair = tuple[Shot, Shot]
PARTNER: dict[Kind, Kind] = {"rgb": "depth", "depth": "rgb"}
CALLED: dict[Kind, str] = {"rgb": "colour", "depth": "depth"}


@dataclass
class _Waiting:
    """Images that are not decided yet, by time, and decisions that are not in order yet."""

    tolerance_ns: int
    pending: dict[Kind, list[Shot]] = field(default_factory=lambda: {"rgb": [], "depth": []})
    latest: dict[Kind, int] = field(default_factory=dict)
    decided: list[tuple[int, int, Pair | Skipped]] = field(default_factory=list)  # heap by time
    recent: dict[Kind, deque[int]] = field(
        default_factory=lambda: {"rgb": deque(maxlen=512), "depth": deque(maxlen=512)}
    )
    count: int = 0

    def add(self, shot: Shot) -> None:
        if shot.stamp_ns in self.recent[shot.kind]:
            self.tell(Skipped(shot.stamp_ns, shot.what, "stamp repeated", _index(shot)))
            return
        latest = self.latest.get(shot.kind, shot.stamp_ns)
        self.latest[shot.kind] = max(shot.stamp_ns, latest)
        if len(self.pending[shot.kind]) >= MOST_WAITING:
            reason = f"{MOST_WAITING} images wait for others at its time"
            self.tell(Skipped(shot.stamp_ns, shot.what, reason, _index(shot)))
            return
        if shot.stamp_ns < latest:
            self.tell(Skipped(shot.stamp_ns, shot.what, SORTED_IN, _index(shot)))
        self.recent[shot.kind].append(shot.stamp_ns)
        insort(self.pending[shot.kind], shot, key=_stamp)

    def tell(self, item: Pair | Skipped) -> None:
        stamp = item.stamp_ns if isinstance(item, Skipped) else item[1].stamp_ns
        heapq.heappush(self.decided, (stamp, self.count, item))
        self.count += 1

    @property
    def oldest_ns(self) -> int:
        """No image still to come is older."""
        return max(self.latest.values(), default=-(2**62)) - LATENESS_NS

    def frontier(self, kind: Kind) -> int:
        """Every image of a kind up to this stamp is here."""
        return max(self.latest.get(kind, -(2**62)), self.oldest_ns)

    def decide(self, frontier: dict[Kind, int]) -> None:
        """Pair what is nearest to each other, as long as no image still to come could be nearer."""
        if not any(self._known(shots[0], frontier) for shots in self.pending.values() if shots):
            return
        while self._paired(frontier):
            pass
        for kind, shots in self.pending.items():
            alone = [x for x in shots if self._known(x, frontier) and self._best(x) is None]
            reason = f"no {CALLED[PARTNER[kind]]} image within {self.tolerance_ns / 1e9:g} s"
            for shot in alone:
                shots.remove(shot)
                self.tell(Skipped(shot.stamp_ns, shot.what, reason, _index(shot)))

    def _paired(self, frontier: dict[Kind, int]) -> bool:
        """Whether any two were paired: all that are each other's nearest, which none of the others changes."""
        found = []
        for shot in self.pending["rgb"]:
            choice = self._best(shot) if self._known(shot, frontier) else None
            if choice is not None and self._known(choice, frontier) and self._best(choice) is shot:
                found.append((shot, choice))
        for shot, choice in found:
            self.pending["rgb"].remove(shot)
            self.pending["depth"].remove(choice)
            self.tell((shot, choice))
        return bool(found)

    def ordered(self, until_ns: int) -> Iterator[Pair | Skipped]:
        """What is decided before a time and before everything undecided, by time."""
        undecided = [shots[0].stamp_ns for shots in self.pending.values() if shots]
        until_ns = min([until_ns, *(stamp - self.tolerance_ns for stamp in undecided)])
        while self.decided and self.decided[0][0] < until_ns:
            yield heapq.heappop(self.decided)[2]

    def _known(self, shot: Shot, frontier: dict[Kind, int]) -> bool:
        return shot.stamp_ns + self.tolerance_ns <= frontier[PARTNER[shot.kind]]

    def _best(self, shot: Shot) -> Shot | None:
        """The nearest partner; of equally near ones the pair that comes first, as in ``associate``."""
        others = self.pending[PARTNER[shot.kind]]
        after = bisect_left(others, shot.stamp_ns, key=_stamp)
        near = [(abs(x.stamp_ns - shot.stamp_ns), k, x) for k, x in enumerate(others[max(after - 1, 0) : after + 1])]
        apart_ns, _, best = min(near, default=(self.tolerance_ns + 1, 0, shot))
        return best if apart_ns <= self.tolerance_ns else None


def synchronised(shots: Iterable[Shot | Skipped], tolerance_ns: int) -> Generator[Pair | Skipped]:
    """Colour and depth images that belong together, each used once, by the depth image's stamp; and what is left out.

    The same pairs as ``stamps.associate`` gives of all stamps, as long as no image comes LATENESS_NS late. Where the
    clock is set back further, time starts again: what follows is paired by itself.
    """
    waiting = _Waiting(tolerance_ns)
    late: list[Shot] = []
    for shot in shots:
        if isinstance(shot, Skipped):
            waiting.tell(shot)
            continue
        in_time = shot.stamp_ns >= waiting.oldest_ns
        if in_time:
            _drop(late, waiting)
        late.append(shot)
        if not in_time:
            if len(late) < STRAGGLERS:
                continue
            yield from _rest(waiting)
            waiting = _Waiting(tolerance_ns)
            waiting.tell(Skipped(late[0].stamp_ns, late[0].what, SET_BACK))
        while late:
            waiting.add(late.pop(0))
        frontier = {kind: waiting.frontier(kind) for kind in PARTNER}
        waiting.decide(frontier)
        yield from waiting.ordered(min(frontier.values()) - tolerance_ns)
    _drop(late, waiting)
    yield from _rest(waiting)


def _drop(late: list[Shot], waiting: _Waiting) -> None:
    """What was around them has been given out already: frames go by time."""
    for shot in late:
        waiting.tell(Skipped(shot.stamp_ns, shot.what, f"{TOO_LATE}: by over {LATENESS_NS / 1e9:g} s", _index(shot)))
    late.clear()


def _rest(waiting: _Waiting) -> Iterator[Pair | Skipped]:
    """What is to be had without images still to come."""
    waiting.decide(dict.fromkeys(PARTNER, 2**63))
    yield from waiting.ordered(2**63)


def _stamp(shot: Shot) -> int:
    return shot.stamp_ns


def _index(shot: Shot) -> int | None:
    return shot.index if shot.kind == "rgb" else None
