"""What each command does, as one function: the roof that joins readers, pipeline, models and sinks."""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence
from contextlib import ExitStack, closing
from functools import partial
from importlib import metadata
from pathlib import Path

from vlmm_log.ask import Questions, parse
from vlmm_log.maps import SavedMap, save_map
from vlmm_log.models.load import load_models
from vlmm_log.pipeline.run import Tally, expected_pairs, keyframe_pairs
from vlmm_log.processed import Processed
from vlmm_log.protocols import Log, Progress, Sink
from vlmm_log.readers import opened
from vlmm_log.resuming.journal import Journal
from vlmm_log.run_outputs import RunOutputs
from vlmm_log.settings import Settings
from vlmm_log.sinks.many import Many
from vlmm_log.sinks.recorder import Recorder, Recording
from vlmm_log.sinks.summary import Summary
from vlmm_log.types import InputError, Run
from vlmm_log.version import __version__
from vlmm_log.watching import Watching, window
from vlmm_log.workers.crew import Crew
from vlmm_log.workers.worker import alone

WORKERS_A_CORE = 8  # more would only take its memory
LIBRARIES = ("numpy", "numba", "opencv-python-headless", "scipy", "rerun-sdk")


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
    resume: bool = False,
) -> Processed:
    """Run the method on every keyframe pair of a log and show each intermediate result to the sinks.

    ``source`` is a path that some reader of ``readers.READERS`` knows, or a log of your own, opened.
    With ``rrd`` a Rerun recording is written beside and renamed once complete, with ``mcap`` an MCAP file of the same
    content (``mcap_schema`` "ros2" or "foxglove"), with ``map`` a map file (.json, .parquet, .ply); existing ones are
    replaced only with ``force``. Each query is answered at every pair and over the whole map. Ctrl-C and SIGTERM end
    the run early and keep the recordings; a map file is of whole runs only. ``workers`` above 1 are processes that look
    at pairs side by side, with the same result to the bit; a script that asks for them does so below
    ``if __name__ == "__main__":``, as they import it. With ``resume`` what each pair shows is kept in NAME.journal
    beside the first output until that is complete, and a run that finds one goes on where it ended, with the same
    result; sinks of your own cannot be given then. Raises InputError where the source, the settings, a query or an
    output cannot be used, and where no pair could be processed.
    """
    s = settings or Settings()
    log, reader = opened(source, s.read)
    inputs = [Path(source)] if isinstance(source, str | Path) else []
    where = inputs[0] if inputs else log.name
    if s.ego.model == "off" and not log.has_poses:
        raise InputError(f"{where}: no poses, and ego.model = off needs them; use rigid or row_linear")
    asked, by_parser = parse(queries, s)
    expected = expected_pairs(log.count(*window(s)), s.keyframes)
    rrd_file, mcap_file, map_file = (None if name is None else Path(name) for name in (rrd, mcap, map))
    outputs = RunOutputs(rrd_file, mcap_file, map_file, mcap_schema)
    kept = outputs.journal(sinks) if resume else None
    outputs.claim(inputs, force=force, journal=kept)
    most = WORKERS_A_CORE * (os.cpu_count() or 1)
    if not 1 <= workers <= most:
        raise InputError(f"workers = {workers}: give 1 to {most}, {WORKERS_A_CORE} for each core of this machine")
    with ExitStack() as stack:
        crew = stack.enter_context(Crew(workers, s)) if workers > 1 else None  # they load while we do
        models, of_models = load_models(s)
        run = Run(log.name, reader, s.to_toml(), versions() | of_models, log.has_poses, log.world_up, tuple(log.notes))
        summary = Summary(noise_scale=s.noise.scale)
        looks = None if crew is None else crew.looks
        journal = None
        if kept is not None:
            journal = stack.enter_context(Journal(kept, run, outputs.paths, recorded=outputs.recorded))
            with closing(keyframe_pairs(log.frames(*window(s)), s, Tally())) as stream:
                journal.check(stream)  # before what an earlier run recorded is replaced
            looks = partial(journal.looks, looks or partial(alone, models, s))
        recordings = outputs.recordings(run)
        recorders = [Recorder(recordings, dense=s.log.dense)] if recordings else []
        told = None if progress is None else partial(_tell, progress, expected)
        questions = Questions(asked, models.embed, s.query, s.map, log.world_up)
        watching = Watching(log, models, s, questions, by_parser, looks, crew, next(iter(inputs), None))
        try:
            end = watching.run(Many([summary, *sinks, *recorders]), told)
        except Exception as e:
            _note_kept(e, recordings, resume=resume)
            raise
        if not end.pairs and end.complete:
            raise InputError(f"{where}: no pair of frames could be processed{_why(summary)}")
        saved = SavedMap(watching.world.map, run, end, watching.origin_ns, watching.camera)
        written = [r.written for r in recordings if r.written]
        if outputs.map is not None and end.complete:
            _save_map(outputs.map, saved, written, force=force or journal is not None)
            written.append(outputs.map)
        if journal is not None and end.complete:
            journal.remove()
    resumed = 0 if journal is None else journal.taken
    return Processed(run, end, tuple(written), summary, saved, tuple(watching.answers()), resumed)


def _note_kept(e: Exception, recordings: Sequence[Recording], *, resume: bool) -> None:
    """Add to an error what it left of the run."""
    for kept in (r.written for r in recordings if r.written):
        e.add_note(f"what was written until then is kept as {kept}{' (--resume goes on from it)' if resume else ''}")


def _save_map(path: Path, saved: SavedMap, written: Sequence[Path], *, force: bool) -> None:
    try:
        save_map(path, saved, force=force)
    except InputError as e:
        for kept in written:
            e.add_note(f"the recording is whole: {kept}")
        raise


def _tell(progress: Progress, expected: int, done: int) -> None:
    progress(done, expected)


def versions() -> dict[str, str]:
    """Of this project, Python and the libraries that decide results."""
    own = {"vlmm-log": __version__, "python": platform.python_version()}
    return own | {name: metadata.version(name) for name in LIBRARIES}


def _why(summary: Summary) -> str:
    reasons = [f"{reason} ({count}x)" for reason, count in summary.skipped.most_common(3)]
    return ": " + "; ".join(reasons) if reasons else ": fewer frames than the keyframe gap"
