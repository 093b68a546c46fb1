"""``diff``: what differs between two recordings or maps, and where they part."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path

from vlmm_log.ask import load_map
from vlmm_log.comparison import told
from vlmm_log.comparison.alignment import Match, matches
from vlmm_log.comparison.difference import (
    Difference,
    Divergence,
    ElementsDifference,
    EntityDifference,
    Figures,
    FrameDifference,
    Place,
    StageDifference,
)
from vlmm_log.comparison.maps import elements_difference, query_difference
from vlmm_log.comparison.measures import figures
from vlmm_log.comparison.stages import STAGES, rank, stage_of
from vlmm_log.comparison.tolerance import Choice, Tolerance
from vlmm_log.comparison.words import markdown, readable
from vlmm_log.entries import Look, Table
from vlmm_log.outputs import claim, replacing
from vlmm_log.protocols import Progress
from vlmm_log.recording import Recording, is_recording, open_recording
from vlmm_log.recording.frames import pairs
from vlmm_log.sinks.legend import LEGEND
from vlmm_log.sinks.map_entries import element_columns
from vlmm_log.types import InputError

DIGESTS, ELEMENTS, QUERIES = "digests", "world/map/elements", "world/map/query/"
WORDS = {"run", LEGEND}  # settings, versions and notes to read: compared as what they are
EVERYTHING = Choice()
EXACT = Tolerance()


def diff(
    a: str | Path,
    b: str | Path,
    *,
    tolerance: Tolerance = EXACT,
    choice: Choice = EVERYTHING,
    json: str | Path | None = None,
    html: str | Path | None = None,
    rrd: str | Path | None = None,
    force: bool = False,
    progress: Progress | None = None,
) -> Difference:
    """What differs between two recordings (.rrd, .mcap) or maps (.json, .parquet), B against A.

    Values are matched by entity and frame index. With ``json`` the difference is written as JSON
    (docs/diff.schema.json), with ``html`` as one page, with ``rrd`` as a recording that shows A, B and their difference
    on one timeline; a recording needs recordings. Raises InputError where a file cannot be read or written, or the two
    share no frame.
    """
    paths = Path(a), Path(b)
    outputs = [None if name is None else Path(name) for name in (json, html, rrd)]
    claim([path for path in outputs if path is not None], force=force, inputs=paths)
    _check_outputs(*outputs[1:])
    for path in paths:
        if path.is_dir():
            raise InputError(f"{path}: is a folder; give recordings (.rrd, .mcap), maps or two folders of batch")
    if all(is_recording(path) for path in paths):
        done, shared = _of_recordings(paths, tolerance, choice, outputs[2], progress)
    else:
        if rrd is not None:
            raise InputError(f"{rrd}: a map holds nothing in time to show; compare recordings")
        done, shared = _of_maps(paths, tolerance, choice), None
    if outputs[0] is not None:
        from vlmm_log.comparison.report import write_json

        with replacing(outputs[0], force=force) as (partial,):
            write_json(partial, done)
    if outputs[1] is not None:
        from vlmm_log.comparison.page import write_page

        with replacing(outputs[1], force=force) as (partial,):
            write_page(partial, done, shared)
    return done


def _of_maps(paths: tuple[Path, Path], tolerance: Tolerance, choice: Choice) -> Difference:
    choice.check([ELEMENTS, *told.COMPARED])
    tolerance.check([ELEMENTS])
    a, b = (load_map(path) for path in paths)
    tables = [Table(element_columns(saved.world.columns)) for saved in (a, b)]
    spans = [(s.world.columns.first_ns, s.world.columns.last_ns) for s in (a, b)]
    if all(first.size for first, _ in spans):
        (start_a, stop_a), (start_b, stop_b) = ((first.min(), last.max()) for first, last in spans)
        if stop_a < start_b or stop_b < start_a:
            raise _unrelated(paths, "their elements were seen at different times")
    return Difference(
        readable(paths[0]),
        readable(paths[1]),
        **told.changes((a.run, a.end), (b.run, b.end), choice),
        elements=elements_difference(tables[0], tables[1], *tolerance.of(ELEMENTS))
        if choice.takes(ELEMENTS)
        else ElementsDifference(0),
    )


def _unrelated(paths: tuple[Path, Path], why: str) -> InputError:
    return InputError(f"{paths[0]} and {paths[1]}: cannot be compared: {why}; give two runs of one log")


@dataclass
class Comparison:
    """A comparison under way: takes each match, keeps what the difference is made of."""

    tolerance: Tolerance
    entities: dict[str, _Entity] = field(default_factory=dict)
    stages: dict[str, list[Place]] = field(default_factory=dict)  # whose digests differ
    last: dict[str, tuple[Table | None, Table | None]] = field(default_factory=dict)  # elements and answers, of A, of B
    stages_compared: frozenset[str] = frozenset(STAGES)  # by their digests
    both: set[str] = field(default_factory=set)  # of them, those that both have at one frame

    def take(self, match: Match) -> None:
        """One match."""
        if match.entity == ELEMENTS or match.entity.startswith(QUERIES):
            self._remember(match)
        if match.entity == DIGESTS:
            if isinstance(match.a, Table) and isinstance(match.b, Table):
                self._digests(match.at, match.a, match.b)
            return
        self.entities.setdefault(match.entity, _Entity()).take(match, *self.tolerance.of(match.entity))

    def _remember(self, match: Match) -> None:
        """The last tables that both have at one frame; before there are any, the last of each."""
        a, b = (value if isinstance(value, Table) else None for value in (match.a, match.b))
        known = self.last.get(match.entity, (None, None))
        if a is not None and b is not None:
            self.last[match.entity] = a, b
            self.both.add(match.entity)
        elif match.entity not in self.both:
            self.last[match.entity] = known[0] if a is None else a, known[1] if b is None else b

    def _digests(self, at: Place, a: Table, b: Table) -> None:
        x, y = (dict(zip(t.columns["stage"], t.columns["xxh3"], strict=True)) for t in (a, b))
        for stage in x.keys() & y.keys() & self.stages_compared:
            if x[stage] != y[stage]:
                self.stages.setdefault(str(stage), []).append(at)

    def entity_differences(self) -> tuple[EntityDifference, ...]:
        """Of all entities that differ, in the order of the stages."""
        found = [e.difference(name) for name, e in self.entities.items() if e.differs]
        return tuple(sorted(found, key=lambda d: (rank(d.stage), d.entity)))

    def stage_differences(self) -> tuple[StageDifference, ...]:
        """Of all stages whose digests differ, in order."""
        return tuple(
            StageDifference(stage, len(places), min(places, key=lambda p: p.order))
            for stage, places in sorted(self.stages.items(), key=lambda item: rank(item[0]))
        )


@dataclass
class _Entity:
    compared: int = 0
    only: tuple[list[Place], list[Place]] = field(default_factory=lambda: ([], []))
    frames: list[FrameDifference] = field(default_factory=list)
    looks: list[FrameDifference] = field(default_factory=list)  # matter where what they are made from is the same

    @property
    def differs(self) -> bool:
        return bool(self.frames or self.looks or self.only[0] or self.only[1])

    def take(self, match: Match, atol: float, rtol: float) -> None:
        if isinstance(match.a, Look) or isinstance(match.b, Look):
            self._look(match)
            return
        if match.a is None or match.b is None:
            self.only[match.a is None].append(match.at)
            return
        self.compared += 1
        found = figures(match.entity, match.a, match.b, atol, rtol)
        if match.late_ns:
            late = f"time: {match.late_ns:+d} ns"
            told = f"{late}; {found.told}" if found.told else late
            found = replace(found, told=told) if found.differs else Figures(1, 1, told=late)
        if found.differs:
            self.frames.append(FrameDifference(match.at, found))

    def _look(self, match: Match) -> None:
        if match.a != match.b:
            look = match.a or match.b
            assert isinstance(look, Look)
            told = f"drawn otherwise: {look.component or 'columns'}"
            self.looks.append(FrameDifference(match.at, Figures(1, 1, told=told)))

    def difference(self, name: str) -> EntityDifference:
        only_a, only_b = (tuple(sorted(places, key=lambda p: p.order)) for places in self.only)
        otherwise = self.frames or only_a or only_b
        frames = tuple(sorted(self.frames if otherwise else self.looks, key=lambda f: f.at.order))
        return EntityDifference(name, stage_of(name), self.compared, only_a, only_b, frames)


def _check_outputs(html: Path | None, rrd: Path | None) -> None:
    for path, suffix in ((html, ".html"), (rrd, ".rrd")):
        if path is not None and path.suffix != suffix:
            raise InputError(f"{path}: is to be called {path.with_suffix(suffix).name}: it will be such a file")


def _of_recordings(
    paths: tuple[Path, Path], tolerance: Tolerance, choice: Choice, rrd: Path | None, progress: Progress | None
) -> tuple[Difference, tuple[Recording, Recording]]:
    a, b = (open_recording(path) for path in paths)
    stamps = _stamps(a), _stamps(b)
    both = stamps[0].keys() & stamps[1].keys()
    if all(stamps) and not any(stamps[0][index] == stamps[1][index] for index in both):
        raise _unrelated(paths, "they share no frame")
    comparison = Comparison(tolerance)
    known = (a.entities | b.entities) - WORDS
    choice.check([*known, *told.COMPARED])
    tolerance.check(known)
    entities = {entity for entity in known if choice.takes(entity)}
    comparison.stages_compared = _exact_stages(known, choice, tolerance)
    stream = _told(matches((a, b), stamps, entities), len(entities), progress)
    if rrd is None:
        for match in stream:
            comparison.take(match)
        return _difference(paths, (a, b), stamps, comparison, choice), (a, b)
    from vlmm_log.comparison.merged import Merged

    with replacing(rrd, force=True) as (partial,), closing(Merged(partial, (a, b))) as merged:  # claimed before
        for match in stream:
            comparison.take(match)
            merged.take(match)
        done = _difference(paths, (a, b), stamps, comparison, choice)
        merged.finish(markdown(done))
    return done, (a, b)


def _exact_stages(known: frozenset[str], choice: Choice, tolerance: Tolerance) -> frozenset[str]:
    """The stages whose digests count: all of their entities are compared, and to the bit."""
    if choice.only or not choice.takes(DIGESTS) or tolerance.of(DIGESTS) != (0, 0):
        return frozenset()
    loose = {stage_of(e) for e in known if not choice.takes(e) or tolerance.of(e) != (0, 0)}
    return frozenset(STAGES) - loose


def _told(stream: Iterator[Match], expected: int, progress: Progress | None) -> Iterator[Match]:
    """The same stream; entities are told as they come by."""
    seen: set[str] = set()
    for match in stream:
        if progress is not None and match.entity not in seen:
            seen.add(match.entity)
            progress(len(seen), expected)
        yield match


def _stamps(recording: Recording) -> dict[int, int]:
    """Frame index -> time of the pairs that a recording holds."""
    return {index: pair.stamp_ns for index, pair in pairs(recording).items()}


def _difference(
    paths: tuple[Path, Path],
    recordings: tuple[Recording, Recording],
    stamps: tuple[dict[int, int], dict[int, int]],
    comparison: Comparison,
    choice: Choice,
) -> Difference:
    a, b = recordings
    entities, stages = comparison.entity_differences(), comparison.stage_differences()
    last = comparison.last
    elements = last.get(ELEMENTS, (None, None))
    asked = {name: t for name, t in last.items() if name.startswith(QUERIES) and None not in t}  # in both
    queries = (query_difference(name.removeprefix(QUERIES), *t) for name, t in asked.items())
    return Difference(
        readable(paths[0]),
        readable(paths[1]),
        **told.changes((a.run, a.end), (b.run, b.end), choice),
        frames=(len(stamps[0]), len(stamps[1]), len(stamps[0].keys() & stamps[1].keys())),
        missing=(*_missing("A", a, len(stamps[0])), *_missing("B", b, len(stamps[1]))),
        first=_first(entities, stages),
        stages=stages,
        entities=entities,
        elements=elements_difference(elements[0], elements[1], *comparison.tolerance.of(ELEMENTS)),
        queries=tuple(q for q in queries if q is not None),
    )


def _missing(side: str, recording: Recording, pairs: int) -> Iterator[str]:
    end = recording.end
    if end is None or not end.complete:
        yield f"{side} is incomplete: it holds {pairs} pairs, and its run went no further or was cut off"
    yield from (f"{side}: {loss}" for loss in recording.losses)


def _first(entities: Sequence[EntityDifference], stages: Sequence[StageDifference]) -> Divergence | None:
    """The first frame that differs, and the earliest stage there. What holds for all of a recording comes last."""
    found = [(s.first, s.stage, "") for s in stages] + [(e.first, e.stage, e.entity) for e in entities]
    if not found:
        return None

    def order(item: tuple[Place, str, str]) -> tuple[bool, tuple[int, int], int, bool]:
        at, stage, entity = item
        return at.stamp_ns is None, at.order, rank(stage), not entity

    return Divergence(*min(found, key=order))
