"""A run: the log fed to the pipeline and every result to the sink."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from threadpoolctl import threadpool_limits

from vlmm_log.ask import Questions
from vlmm_log.interrupt import Interruption
from vlmm_log.pipeline.run import Tally, World, empty_world, keyframe_pairs, learn, step
from vlmm_log.protocols import Log, Models, Moment, Observe, Sink
from vlmm_log.queries import Answer
from vlmm_log.readers.lasting import lasting
from vlmm_log.readers.stamps import limit_ns
from vlmm_log.settings import Settings
from vlmm_log.sinks.many import Many, watched_by
from vlmm_log.types import Float64, FramePair, RunEnd, Skipped
from vlmm_log.workers.crew import Crew
from vlmm_log.workers.worker import Looked, Looks


def window(s: Settings) -> tuple[int, int]:
    """Start and stop, ns from the first frame."""
    return limit_ns(s.read.start_s), limit_ns(s.read.stop_s)


@dataclass
class Watching:
    """A run: the log fed to the pipeline and every result to the sink, until the end or Ctrl-C."""

    log: Log
    models: Models
    s: Settings
    questions: Questions
    told: tuple[str, ...]  # by the query parser
    looks: Looks | None = None  # who looks at pairs, if others do
    crew: Crew | None = None  # of them, processes that cache features
    source: Path | None = None  # where the log lies
    origin_ns: int = 0  # stamp of the first pair

    def __post_init__(self) -> None:
        self.world = empty_world(self.s, has_poses=self.log.has_poses)
        self.tally = Tally()
        self.done = 0

    @property
    def camera(self) -> Float64 | None:
        """Pose of the last pair's first frame."""
        return None if self.world.odometry is None else self.world.odometry.T_world_first

    def answers(self) -> list[Answer]:
        """What the queries find in the map so far."""
        return self.questions.answers(self.world.map.columns, self.camera, self.origin_ns)

    def run(self, sink: Many, tell: Callable[[int], None] | None) -> RunEnd:
        """All pairs."""
        complete = False
        failure: BaseException | None = None
        frames = lasting(self.source, self.log.frames(*window(self.s)))
        try:
            with (
                threadpool_limits(1, user_api="blas"),  # no sum depends on how many cores there are
                Interruption() as interruption,
                closing(keyframe_pairs(frames, self.s, self.tally)) as stream,
            ):
                for item in stream if self.looks is None else self.looks(stream, sink.made):
                    if interruption.asked:
                        break
                    if isinstance(item, Skipped):
                        sink.write(item, Moment(item.stamp_ns, item.index, 0.0))
                        continue
                    if isinstance(item, FramePair):
                        self.pair(item, sink)
                    else:
                        self.looked(*item, sink)
                    if tell is not None:
                        tell(self.done)
                else:
                    complete = True
                    self._hear_out()
        except KeyboardInterrupt:
            pass  # what was written stays, and is marked as incomplete
        except BaseException as e:
            failure = e
            raise
        finally:
            told = (*self.told, *(report() for report in self.models.reports))
            end = RunEnd(complete, self.tally.input_hash(), self.tally.frames, self.done, told)
            _close(sink, end, failure)
        return end

    def pair(self, pair: FramePair, sink: Sink) -> None:
        """One pair, and what the queries find after it."""
        observe = watched_by(sink, pair)
        self._learned(pair, step(observe(pair), self.world, self.models, self.s, observe), observe)

    def looked(self, pair: FramePair, by_worker: Looked, sink: Many) -> None:
        """The same of a pair that a worker looked at."""
        first = pair.first
        watched_by(sink, pair)(pair)
        for made, elapsed_ms in by_worker.made:
            sink.take(made, Moment(first.stamp_ns, first.index, elapsed_ms))
        observe = watched_by(sink, pair)
        self._learned(pair, learn(pair, by_worker.look, self.world, self.models, self.s, observe), observe)

    def _learned(self, pair: FramePair, world: World, observe: Observe) -> None:
        if not self.done:
            self.origin_ns = pair.first.stamp_ns
        self.world = world
        for found in self.answers():
            observe(found)
        self.done += 1

    def _hear_out(self) -> None:
        """What workers used of the feature cache is part of what ours has to tell."""
        cache = getattr(self.models.embed, "cache", None)
        if self.crew is not None and cache is not None:
            for used in self.crew.used():
                cache.add(used)


def _close(sink: Sink, end: RunEnd, failure: BaseException | None) -> None:
    """Close the sink; where the run failed already, that is the error to tell."""
    try:
        sink.close(end)
    except Exception as e:
        if failure is None:
            raise
        if str(e) != str(failure):
            failure.add_note(f"then: {e}")
