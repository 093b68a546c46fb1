"""Trials and baselines over logs with truth, judged pixel by pixel and element by element."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from vlmm_log.elements import Elements, MotionClass
from vlmm_log.evaluation import scores as sc
from vlmm_log.evaluation.baselines.protocol import Baseline
from vlmm_log.evaluation.counts import Counts, FrameCounts, count
from vlmm_log.evaluation.noise_fit import NoiseFit
from vlmm_log.evaluation.outcome import judgement
from vlmm_log.evaluation.scores import Scores
from vlmm_log.evaluation.shelf import Shelf
from vlmm_log.evaluation.things import Judged, ThingCounts
from vlmm_log.evaluation.trial import Plan, Seen, Trial
from vlmm_log.evaluation.truth import PairTruth, Truth
from vlmm_log.evaluation.worst import Worst
from vlmm_log.pipeline.fusion import motion_evidence
from vlmm_log.protocols import Log, Models, Moment, MovabilityPrior, Sink
from vlmm_log.settings import Settings
from vlmm_log.sinks.many import Many, watched_by
from vlmm_log.types import Float32, Float64, FramePair, RunEnd, Skipped

FAR_M = 2.5
OWN = "full"  # row of the settings' own answers


@dataclass
class PixelScore:
    """One score under judgement."""

    threshold: float
    counts: Counts = field(default_factory=Counts)


@dataclass(frozen=True, eq=False)
class ElementScores:
    """What one log's elements are, and how each way ranks them."""

    columns: Elements
    judged: Judged
    evidence: Float64  # (n,) of having moved, as the map has it: what probabilities are fitted to
    ways: Mapping[str, tuple[Scores, ...]]  # name -> candidates


@dataclass
class Bench:
    """What was found so far. Logs come one after the other."""

    withheld: MovabilityPrior | None = None  # a prior that does not know the names themselves
    pixels: dict[tuple[str, str], PixelScore] = field(default_factory=dict)
    elements: list[ElementScores] = field(default_factory=list)
    things: dict[str, list[ThingCounts]] = field(default_factory=dict)
    noise: NoiseFit = field(default_factory=NoiseFit)
    worst: Worst = field(default_factory=Worst)

    def score(
        self, trial: str, name: str, value: Float32, threshold: float, truth: PairTruth, pair: FramePair
    ) -> FrameCounts:
        """Count one score of one pair."""
        held = self.pixels.setdefault((trial, name), PixelScore(threshold))
        with np.errstate(invalid="ignore"):
            held.counts.frames.append(count(value, threshold, truth, pair.first.depth > FAR_M))
        return held.counts.frames[-1]


@dataclass
class LogRun:
    """One log on the bench."""

    bench: Bench
    name: str
    truth: Truth
    trials: Sequence[Trial]
    baselines: Sequence[tuple[Baseline, Sink | None]]
    counts: Mapping[str, ThingCounts]  # of trials that are asked about identities
    apart: set[str] = field(default_factory=set)  # trials whose elements are not the first one's: tracks differ
    judged_pairs: int = 0

    @staticmethod
    def start(
        bench: Bench,
        log: Log,
        truth: Truth,
        planned: Sequence[Plan],
        baselines: Sequence[Baseline],
        shelf: Shelf | None,
        force: bool,
    ) -> LogRun:
        """Nothing seen yet; recordings opened."""

        def sink(name: str, s: Settings) -> Sink | None:
            return None if shelf is None else shelf.recorder(name, s, force=force)

        trials = [Trial.start(p, has_poses=log.has_poses, sink=sink(p.name, p.settings)) for p in planned]
        own = planned[0].settings
        watched = [(b, None if math.isnan(b.threshold) else sink(b.name, own)) for b in baselines]
        asked = [p.name for k, p in enumerate(planned) if k == 0 or not p.same_ids]  # the others' are the first one's
        counts = {name: ThingCounts(truth.things) for name in asked}
        for name, held in counts.items():
            bench.things.setdefault(name, []).append(held)
        return LogRun(bench, log.name, truth, trials, watched, counts)

    def see(self, pair: FramePair, models: Models) -> None:
        """One pair, by all trials and baselines."""
        truth = self.truth.of(pair)
        first: Seen | None = None
        for trial in self.trials:
            seen = trial.see(pair, models)
            first = first or seen
            if not np.array_equal(seen.tracked.ids, first.tracked.ids):
                self.apart.add(trial.name)
            if truth is not None:
                self._judge(trial, seen, truth)
        assert first is not None, "a bench has a trial"
        for baseline, sink in self.baselines:
            self._see_by(baseline, sink, first, truth)
        if truth is not None:
            self.judged_pairs += 1
            self.bench.noise.add(first, truth)
            self.bench.worst.add(self.name, first, truth)

    def skip(self, item: Skipped) -> None:
        """What was left out, for the recordings."""
        for sink in self._sinks():
            sink.write(item, Moment(item.stamp_ns, item.index, 0.0))

    def _sinks(self) -> list[Sink]:
        return [s for s in (*(t.sink for t in self.trials), *(s for _, s in self.baselines)) if s is not None]

    def _see_by(self, baseline: Baseline, sink: Sink | None, seen: Seen, truth: PairTruth | None) -> None:
        value = baseline.see(seen)
        if value is None or truth is None:
            return
        counted = self.bench.score(baseline.name, "own", value, baseline.threshold, truth, seen.pair)
        if sink is not None:
            show = watched_by(sink, seen.pair)
            show(seen.pair)
            show(seen.odometry)
            show(judgement(value, baseline.threshold, truth, counted))

    def _judge(self, trial: Trial, seen: Seen, truth: PairTruth) -> None:
        motion = seen.motion
        counted = self.bench.score(trial.name, "d_M", motion.d_m, motion.tau_px, truth, seen.pair)
        if trial.plan.raw:
            self.bench.score(trial.name, "raw", motion.norm, RAW_FLAG_M, truth, seen.pair)
        if trial.name in self.counts:
            self.counts[trial.name].add(truth, seen, trial.settings.map.min_pixels)
        if trial.sink is not None:
            watched_by(trial.sink, seen.pair)(judgement(motion.d_m, motion.tau_px, truth, counted))

    def close(self, end: RunEnd) -> None:
        """Close the recordings."""
        Many(self._sinks()).close(end)

    def rank(self) -> None:
        """Rank the elements of the first trial in every way."""
        trial = self.trials[0]
        if not self.truth.things:
            return
        columns, s = trial.world.map.columns, trial.settings
        judged = self.counts[trial.name].judged(columns.ids, s.map.min_pixels)
        of_fields = _of_fields(columns, s, self.bench.withheld)
        ways: dict[str, tuple[Scores, ...]] = {name: (scores,) for name, scores in of_fields.items()}
        for other in (t for t in self.trials[1:] if t.plan.same_ids and t.name not in self.apart):
            ways[other.name] = (_on(columns, other),)
        ways |= {b.name: found for b, _ in self.baselines if (found := b.answers(columns))}
        self.bench.elements.append(ElementScores(columns, judged, _evidence(columns, s), ways))


RAW_FLAG_M = 0.02


def _evidence(columns: Elements, s: Settings) -> Float64:
    has_moved = columns.motion_class == MotionClass.MOVING
    has_moved[columns.interval_rows] = True
    return motion_evidence(has_moved, columns.o, s.map.tau_o)


def _of_fields(columns: Elements, s: Settings, withheld: MovabilityPrior | None) -> dict[str, Scores]:
    """The whole schema, and with a field taken away."""
    found = {OWN: sc.whole(columns, s)}
    if withheld is not None:
        rho = np.array([withheld(label).rho for label in columns.labels])
        found["full, prior without these names"] = sc.whole(sc.with_prior(columns, rho, s), s)
    return found | {
        "observed motion only": sc.observed_only(columns, s),
        "movability prior only": sc.prior_only(columns),
    }


def _on(columns: Elements, trial: Trial) -> Scores:
    """Another trial's answers on the first one's elements, by id; an element that it lacks comes last."""
    own = trial.world.map.columns
    place = {int(i): row for row, i in enumerate(own.ids.tolist())}
    rows = np.array([place.get(int(i), -1) for i in columns.ids.tolist()], np.int64)
    return sc.taken(sc.whole(own, trial.settings), rows)
