"""What each command does, as one function: the roof that joins readers, pipeline, models and sinks."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING

from vlmm_log.interrupt import Interruption
from vlmm_log.pipeline.run import Models, Tally, expected_pairs, keyframe_pairs, step
from vlmm_log.protocols import Log, Moment, Progress, Sink
from vlmm_log.readers import recognise
from vlmm_log.readers.stamps import limit_ns
from vlmm_log.settings import FlowSettings, Settings
from vlmm_log.sinks.many import Many, watched_by
from vlmm_log.sinks.summary import Summary
from vlmm_log.types import InputError, Run, RunEnd, Skipped
from vlmm_log.version import __version__

if TYPE_CHECKING:
    from vlmm_log.sinks.rerun import Rerun

LIBRARIES = ("numpy", "numba", "opencv-python-headless", "scipy", "rerun-sdk")


@dataclass(frozen=True)
class Processed:
    """What ``process`` leaves: where, and the figures of the run."""

    run: Run
    end: RunEnd
    outputs: tuple[Path, ...]  # as they lie on disk: ``NAME.partial`` if the run was interrupted
    summary: Summary


def process(
    source: str | Path,
    *,
    rrd: str | Path | None = None,
    settings: Settings | None = None,
    sinks: Sequence[Sink] = (),
    force: bool = False,
    progress: Progress | None = None,
) -> Processed:
    """Run the method on every keyframe pair of a log and show each intermediate result to the sinks.

    With ``rrd`` a Rerun recording is written beside and renamed once complete; an existing one is replaced
    only with ``force``. Ctrl-C ends the run early and keeps what was written. Raises InputError where the
    source, the settings or the output cannot be used, and where no pair could be processed.
    """
    s = settings or Settings()
    source = Path(source)
    reader = recognise(source)
    log = reader.open(source, s.read)
    if s.ego.model == "off" and not log.has_poses:
        raise InputError(f"{source}: no poses, and ego.model = off needs them; use rigid or row_linear")
    expected = expected_pairs(log.count(*_window(s)), s.keyframes)
    target = None if rrd is None else _free(Path(rrd), force)
    models, versions = load_models(s)
    run = Run(log.name, reader.name, s.to_toml(), versions, log.has_poses, log.world_up, tuple(log.notes))
    summary = Summary(noise_scale=s.noise.scale)
    recordings = [] if target is None else [_recording(target, run, s)]
    told = None if progress is None else partial(_tell, progress, expected)
    try:
        end = _watch(log, models, s, Many([summary, *sinks, *recordings]), told)
    except Exception as e:
        for kept in (r.written for r in recordings if r.written):
            e.add_note(f"what was written until then is kept as {kept}")
        raise
    if not end.pairs and end.complete:
        raise InputError(f"{source}: no pair of frames could be processed{_why(summary)}")
    return Processed(run, end, tuple(r.written for r in recordings if r.written), summary)


def _recording(path: Path, run: Run, s: Settings) -> Rerun:
    from vlmm_log.sinks.rerun import Rerun

    return Rerun(path, run, recording_id=recording_id(run), dense=s.log.dense)


def _tell(progress: Progress, expected: int, done: int) -> None:
    progress(done, expected)


def load_models(s: Settings) -> tuple[Models, dict[str, str]]:
    """The models that the settings name, and the versions of all that decides the result.

    Raises InputError where a package or weights are missing.
    """
    versions = {"vlmm-log": __version__, "python": platform.python_version()}
    versions |= {name: metadata.version(name) for name in LIBRARIES}
    if s.flow.estimator == "dis":
        from vlmm_log.models.dis import Dis

        return Models(Dis(s.flow)), versions
    return _raft(s.flow, versions)


def _raft(s: FlowSettings, versions: dict[str, str]) -> tuple[Models, dict[str, str]]:
    from vlmm_log.models.weights import find_raft

    find_raft(s.weights)  # before torch, whose import takes seconds
    from vlmm_log.models.raft import Raft

    raft = Raft(s)
    extra = {name: metadata.version(name) for name in ("torch", "torchvision")}
    return Models(raft), versions | extra | {"weights": raft.fingerprint}


def recording_id(run: Run) -> str:
    """The same for the same source, settings and versions, so that equal runs give equal recordings."""
    text = "\n".join([run.source, *run.notes, run.settings, *(f"{k} {v}" for k, v in sorted(run.versions.items()))])
    return f"{run.source}-{hashlib.sha256(text.encode()).hexdigest()[:12]}"


def _window(s: Settings) -> tuple[int, int]:
    """Start and stop, ns from the first frame."""
    return limit_ns(s.read.start_s), limit_ns(s.read.stop_s)


def _watch(log: Log, models: Models, s: Settings, sink: Sink, tell: Callable[[int], None] | None) -> RunEnd:
    """Feed the log to the pipeline and every result to the sink, until the end or Ctrl-C."""
    tally = Tally()
    done, complete = 0, False
    failure: BaseException | None = None
    try:
        with Interruption() as interruption, closing(keyframe_pairs(log.frames(*_window(s)), s, tally)) as stream:
            for item in stream:
                if interruption.asked:
                    break
                if isinstance(item, Skipped):
                    sink.write(item, Moment(item.stamp_ns, item.index, 0.0))
                    continue
                observe = watched_by(sink, item)
                step(observe(item), models, s, observe)
                done += 1
                if tell is not None:
                    tell(done)
            else:
                complete = True
    except KeyboardInterrupt:
        pass  # what was written stays, and is marked as incomplete
    except BaseException as e:
        failure = e
        raise
    finally:
        end = RunEnd(complete, tally.input_hash(), tally.frames, done)
        _close(sink, end, failure)
    return end


def _close(sink: Sink, end: RunEnd, failure: BaseException | None) -> None:
    """Close the sink; where the run failed already, that is the error to tell."""
    try:
        sink.close(end)
    except Exception as e:
        if failure is None:
            raise
        failure.add_note(f"then: {e}")


def _free(path: Path, force: bool) -> Path:
    if path.is_dir():
        raise InputError(f"{path}: is a folder; name a file, for example {path / 'out.rrd'}")
    for taken in (path, path.with_name(path.name + ".partial")):  # the latter is left of an interrupted run
        if taken.exists() and not force:
            raise InputError(f"{taken}: exists; give --force to replace it")
    return path


def _why(summary: Summary) -> str:
    reasons = [f"{reason} ({count}x)" for reason, count in summary.skipped.most_common(3)]
    return ": " + "; ".join(reasons) if reasons else ": fewer frames than the keyframe gap"
