"""What each command does, as one function: the roof that joins readers, pipeline, models and sinks."""

from __future__ import annotations

import platform
from collections.abc import Callable, Sequence
from contextlib import closing, nullcontext
from dataclasses import dataclass
from functools import partial
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path

from threadpoolctl import threadpool_limits

from vlmm_log.ask import Questions, parse
from vlmm_log.interrupt import Interruption
from vlmm_log.maps import MAP_SUFFIXES, SavedMap, save_map
from vlmm_log.models.load import load_models
from vlmm_log.outputs import claim
from vlmm_log.pipeline.run import Tally, World, empty_world, expected_pairs, keyframe_pairs, learn, step
from vlmm_log.protocols import Log, Models, Moment, Observe, Progress, Sink
from vlmm_log.queries import Answer
from vlmm_log.readers import opened
from vlmm_log.readers.stamps import limit_ns
from vlmm_log.settings import Settings
from vlmm_log.sinks.many import Many, watched_by
from vlmm_log.sinks.recorder import Recorder, Recording, open_recording
from vlmm_log.sinks.summary import Summary
from vlmm_log.types import Float64, FramePair, InputError, Run, RunEnd, Skipped
from vlmm_log.version import __version__
from vlmm_log.workers.crew import Crew
from vlmm_log.workers.worker import Looked

MCAP_SCHEMAS = ("ros2", "foxglove")
LIBRARIES = ("numpy", "numba", "opencv-python-headless", "scipy", "rerun-sdk")


@dataclass(frozen=True)
class Processed:
    """What ``process`` leaves: where, and the figures of the run."""

    run: Run
    end: RunEnd
    outputs: tuple[Path, ...]  # as they lie on disk: ``NAME.partial`` if the run was interrupted
    summary: Summary
    map: SavedMap
    answers: tuple[Answer, ...]  # of the queries, over the whole map


def process(
    source: str | Path | Log,
    *,
    rrd: str | Path | None = None,
    mcap: str | Path | None = None,
    mcap_schema: str = "ros2",
    map: str | Path | None = None,  # noqa: A002  the option's name
    queries: Sequence[str] = (),
    settings: Settings | None = None,
    sinks: Sequence[Sink] = (),
    force: bool = False,
    progress: Progress | None = None,
    workers: int = 1,
) -> Processed:
    """Run the method on every keyframe pair of a log and show each intermediate result to the sinks.

    ``source`` is a path that some reader of ``readers.READERS`` knows, or a log of your own, opened.
    With ``rrd`` a Rerun recording is written beside and renamed once complete, with ``mcap`` an MCAP file of the same
    content (``mcap_schema`` "ros2" or "foxglove"), with ``map`` a map file (.json, .parquet, .ply); existing ones are
    replaced only with ``force``. Each query is answered at every pair and over the
    whole map. Ctrl-C ends the run early and keeps the recordings; a map file is of whole runs only. ``workers`` above 1
    are processes that look at pairs side by side, with the same result to the bit; a script that asks for them does so
    below ``if __name__ == "__main__":``, as they import it. Raises InputError
    where the source, the settings, a query or an output cannot be used, and where no pair could be processed.
    """
    s = settings or Settings()
    log, reader = opened(source, s.read)
    inputs = [Path(source)] if isinstance(source, str | Path) else []
    where = inputs[0] if inputs else log.name
    if s.ego.model == "off" and not log.has_poses:
        raise InputError(f"{where}: no poses, and ego.model = off needs them; use rigid or row_linear")
    asked, by_parser = parse(queries, s)
    expected = expected_pairs(log.count(*_window(s)), s.keyframes)
    target, mcap_target, map_target = (None if name is None else Path(name) for name in (rrd, mcap, map))
    _check_schema(mcap_schema)
    if map_target is not None:
        _check_map_name(map_target)
    claim([path for path in (target, mcap_target, map_target) if path is not None], force=force, inputs=inputs)
    for path, suffix in ((target, ".rrd"), (mcap_target, ".mcap")):
        if path is not None and path.suffix != suffix:  # what is called otherwise is read otherwise
            raise InputError(f"{path}: a recording of this kind is called NAME{suffix}; name it so")
    if workers < 1:
        raise InputError(f"workers = {workers}: give 1 or more")
    with Crew(workers, s) if workers > 1 else nullcontext() as crew:  # they load while we do
        models, of_models = load_models(s)
        run = Run(log.name, reader, s.to_toml(), versions() | of_models, log.has_poses, log.world_up, tuple(log.notes))
        summary = Summary(noise_scale=s.noise.scale)
        recordings = _recordings(target, mcap_target, mcap_schema, run)
        recorders = [Recorder(recordings, dense=s.log.dense)] if recordings else []
        told = None if progress is None else partial(_tell, progress, expected)
        watching = _Watching(
            log, models, s, Questions(asked, models.embed, s.query, s.map, log.world_up), by_parser, crew
        )
        try:
            end = watching.run(Many([summary, *sinks, *recorders]), told)
        except Exception as e:
            for kept in (r.written for r in recordings if r.written):
                e.add_note(f"what was written until then is kept as {kept}")
            raise
    if not end.pairs and end.complete:
        raise InputError(f"{where}: no pair of frames could be processed{_why(summary)}")
    saved = SavedMap(watching.world.map, run, end, watching.origin_ns, watching.camera)
    outputs = [r.written for r in recordings if r.written]
    if map_target is not None and end.complete:
        try:
            save_map(map_target, saved, force=force)
        except InputError as e:
            for kept in outputs:
                e.add_note(f"the recording is whole: {kept}")
            raise
        outputs.append(map_target)
    return Processed(run, end, tuple(outputs), summary, saved, tuple(watching.answers()))


def _recordings(rrd: Path | None, mcap: Path | None, mcap_schema: str, run: Run) -> list[Recording]:
    recordings = []
    if rrd is not None:
        from vlmm_log.sinks.rerun import RerunFile

        recordings.append(open_recording(rrd, lambda path: RerunFile(path, run)))
    if mcap is not None:
        from vlmm_log.sinks.mcap import McapFile, load_dialect

        recordings.append(open_recording(mcap, lambda path: McapFile(path, run, load_dialect(mcap_schema))))
    return recordings


def _check_schema(name: str) -> None:
    if name not in MCAP_SCHEMAS:
        raise InputError(f"mcap_schema {name!r}: no such schemas; there are {', '.join(MCAP_SCHEMAS)}")
    if name == "foxglove" and find_spec("foxglove") is None:
        raise InputError("mcap_schema 'foxglove' needs foxglove-sdk: pip install 'vlmm-log[foxglove]'; or take ros2")


def _tell(progress: Progress, expected: int, done: int) -> None:
    progress(done, expected)


def versions() -> dict[str, str]:
    """Of this project, Python and the libraries that decide results."""
    own = {"vlmm-log": __version__, "python": platform.python_version()}
    return own | {name: metadata.version(name) for name in LIBRARIES}


def _window(s: Settings) -> tuple[int, int]:
    """Start and stop, ns from the first frame."""
    return limit_ns(s.read.start_s), limit_ns(s.read.stop_s)


@dataclass
class _Watching:
    """A run: the log fed to the pipeline and every result to the sink, until the end or Ctrl-C."""

    log: Log
    models: Models
    s: Settings
    questions: Questions
    told: tuple[str, ...]  # by the query parser
    crew: Crew | None = None  # who looks at pairs, if others do
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
        frames = self.log.frames(*_window(self.s))
        try:
            with (
                threadpool_limits(1, user_api="blas"),  # no sum depends on how many cores there are
                Interruption() as interruption,
                closing(keyframe_pairs(frames, self.s, self.tally)) as stream,
            ):
                for item in stream if self.crew is None else self.crew.looks(stream, sink.made):
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
        failure.add_note(f"then: {e}")


def _check_map_name(path: Path) -> None:
    if path.suffix.lower() not in MAP_SUFFIXES:
        raise InputError(f"{path}: a map is written as {', '.join(MAP_SUFFIXES)}; name it so")
    if path.suffix.lower() == ".ply" and find_spec("open3d") is None:
        raise InputError(f"{path}: a PLY needs Open3D: pip install 'vlmm-log[sim]'; or name a .json or .parquet")


def _why(summary: Summary) -> str:
    reasons = [f"{reason} ({count}x)" for reason, count in summary.skipped.most_common(3)]
    return ": " + "; ".join(reasons) if reasons else ": fewer frames than the keyframe gap"
