"""``batch``: many logs, one idempotent task a log, on this machine's cores or on a Ray cluster."""

from __future__ import annotations

import os
import time
from collections.abc import Collection, Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

from vlmm_log.api import process, versions
from vlmm_log.ask import parse
from vlmm_log.batches.content import content_digest, fingerprint
from vlmm_log.batches.folders import claimed, figures, folder_name, staged, write_figures
from vlmm_log.batches.manifest import report, write_manifest
from vlmm_log.batches.summary import write_summary
from vlmm_log.batches.tasks import RECORDINGS, Outcome, Running, State, Task, Work, failed
from vlmm_log.elements import MotionClass
from vlmm_log.knobs import written
from vlmm_log.models.weights import find_clip, find_raft
from vlmm_log.processed import Processed
from vlmm_log.protocols import Progress
from vlmm_log.readers import recognise
from vlmm_log.settings import Settings
from vlmm_log.types import InputError


@dataclass(frozen=True)
class Batch:
    """What ``batch`` leaves."""

    out: Path
    outcomes: tuple[Outcome, ...]  # in the order of the sources
    complete: bool  # False: interrupted

    def of(self, state: State) -> list[Outcome]:
        """The outcomes that are so."""
        return [o for o in self.outcomes if o.state == state]

    def report(self) -> dict[str, object]:
        """For scripts: the manifest, and where; what an earlier call finished is "skipped"."""
        return {"out": str(self.out), "complete": self.complete, **report(self.outcomes)}


def batch(
    sources: Sequence[str | Path],
    out: str | Path,
    *,
    settings: Settings | None = None,
    queries: Sequence[str] = (),
    recordings: Collection[str] = ("rrd",),
    engine: str = "local",
    workers: int | None = None,
    retries: int = 0,
    gpus: float = 0.0,
    progress: Progress | None = None,
) -> Batch:
    """Run ``process`` on many logs; what an earlier call finished is not done again.

    Each log's output is a folder ``out/NAME-HASH`` with figures.json, map.json and its ``recordings`` (run.rrd,
    run.mcap). The hash is over every byte of the source, the settings and the files that they name, the queries and the
    versions; the folder appears once it is complete. ``out/manifest.json`` says how each log stands, also while the
    call runs; ``out/summary.parquet`` has a row a log. "{source}" in a setting stands for the log's path.

    ``engine`` is "local" (``workers`` processes of one thread each; None: one a core), "ray" or "ray:ADDRESS", where a
    task takes a CPU and a share ``gpus`` of a GPU. A task whose process dies is tried ``retries`` times more. A log
    that cannot be processed is a failed outcome, and the others go on. Ctrl-C ends the call; the next one goes on with
    what is unfinished. Raises InputError where there is no log at all, or the settings, the engine or ``out`` cannot
    be used.
    """
    s = settings or Settings()
    paths = list(dict.fromkeys(Path(os.path.normpath(Path(source).absolute())) for source in sources))
    target = Path(out).absolute()
    _check(paths, s, queries, recordings)
    kept = tuple(name for name in RECORDINGS if name in recordings)
    tasks = [Task(str(path), str(target), s.to_toml(), tuple(queries), kept) for path in paths]
    outcomes = {task.source: Outcome(task.source, State.PENDING) for task in tasks}
    running = _run(tasks, engine, workers, retries, gpus)
    complete = False
    with claimed(target, paths), closing(running) as ended:
        try:
            for k, outcome in enumerate(ended, 1):
                outcomes[outcome.source] = outcome
                if k < len(tasks):
                    write_manifest(target, list(outcomes.values()))
                if progress is not None:
                    progress(k, len(tasks))
            complete = True
        except KeyboardInterrupt:
            pass  # what is finished stays
        write_manifest(target, list(outcomes.values()))
        write_summary(target, list(outcomes.values()))
    return Batch(target, tuple(outcomes.values()), complete)


def make(task: Task) -> Outcome:
    """One task: skipped where its output is whole, else made anew. What goes wrong is its outcome."""
    try:
        return _made(task)
    except Exception as e:  # noqa: BLE001  told in one line: the other logs go on
        known = isinstance(e, InputError | OSError)
        told = str(e) if known else f"internal error: {type(e).__name__}: {e}; `vlmm-log --debug process` tells more"
        return failed(task, told)


def _made(task: Task) -> Outcome:
    began = time.perf_counter()
    source = Path(task.source)
    s = settings_of(task)
    parts = _parts(task, s, recognise(source).name)
    whole = fingerprint(parts)
    folder = Path(task.out) / folder_name(source.name, whole)
    found = figures(folder, whole)
    if found is not None:
        return Outcome(task.source, State.SKIPPED, "", folder.name, whole, found["seconds"], found["row"])
    with staged(folder) as staging:
        names = {name: staging / f"run.{name}" for name in task.recordings}
        map_file = staging / "map.json"
        done = process(source, map=map_file, queries=task.queries, settings=s, **names)  # type: ignore[arg-type]
        if not done.end.complete:
            raise InputError(f"{source}: interrupted")
        seconds = round(time.perf_counter() - began, 3)
        closing_report = done.report() | {"outputs": sorted(path.name for path in done.outputs)}
        told = {"hash": whole, "made_of": parts, "seconds": seconds, "row": _row(done), "report": closing_report}
        write_figures(staging, told)
    return Outcome(task.source, State.DONE, "", folder.name, whole, seconds, _row(done))


def settings_of(task: Task) -> Settings:
    """The task's settings, with the log's own path in place of "{source}"."""
    return Settings.from_toml(task.settings.replace("{source}", written(task.source)[1:-1]), task.source)


def _parts(task: Task, s: Settings, reader: str) -> dict[str, str]:
    """All that decides what a task's output holds; of files, their content."""
    known = versions() | dict(_model_versions(s))
    parts = {f"version of {name}": version for name, version in known.items()}
    parts |= {f"content of {name}": content_digest(path) for name, path in _named_files(s)}
    return parts | {
        "source": Path(task.source).name,
        "content": content_digest(Path(task.source)),
        "reader": reader,
        "settings": fingerprint({"toml": task.settings}),
        "queries": "\n".join(task.queries),
        "recordings": " ".join(task.recordings),
    }


def _named_files(s: Settings) -> Iterator[tuple[str, Path]]:
    """Files and folders that settings name: weights, masks, intrinsics, a calibration."""
    if s.flow.estimator == "raft":
        yield "flow.weights", find_raft(s.flow.weights)
    embedder, _, weights = s.objects.embedder.partition(":")
    if embedder in ("clip", "maskclip"):
        yield "objects.embedder", find_clip(weights)
    segmenter = s.objects.segmenter.partition(":")[2]
    named = {"read.intrinsics": s.read.intrinsics, "objects.segmenter": segmenter}
    named |= {"objects.yolo_names": s.objects.yolo_names, "calibration.file": s.calibration.file}
    yield from ((name, Path(value)) for name, value in named.items() if value and Path(value).exists())


def _model_versions(s: Settings) -> Iterator[tuple[str, str]]:
    """Of the libraries that the models named run on, those that are there."""
    names = ["scikit-learn"]
    if s.flow.estimator == "raft" or s.objects.embedder.startswith(("clip", "maskclip")):
        names += ["torch", "torchvision"]
    if s.objects.segmenter.startswith("yolo"):
        names += ["onnxruntime"]
    for name in names:
        with suppress(metadata.PackageNotFoundError):
            yield name, metadata.version(name)


def _row(done: Processed) -> dict[str, object]:
    """The closing figures, flat."""
    elements = [done.map.world.elements[i] for i in sorted(done.map.world.elements)]
    moved = [e for e in elements if len(e.intervals)]
    classes = {c.name.lower(): sum(e.motion_class == c for e in elements) for c in MotionClass}
    return {
        "reader": done.run.reader,
        "input_hash": done.end.input_hash,
        "frames": done.end.frames,
        **done.summary.figures(),
        "elements": len(elements),
        **classes,
        "seen_to_move": len(moved),
        "movers": [f"{e.id} {e.label}".strip() for e in moved],
    }


def _run(tasks: Sequence[Task], engine: str, workers: int | None, retries: int, gpus: float) -> Running:
    """The outcomes as they end; nothing starts before the first is asked for."""
    kind, _, address = engine.partition(":")
    work: Work = make
    if kind == "ray":
        from vlmm_log.batches.cluster import run_ray

        return run_ray(tasks, work, address=address, workers=workers, retries=retries, gpus=gpus)
    if engine != "local":
        raise InputError(f"engine {engine!r}: no such engine; there are local, ray and ray:ADDRESS")
    if gpus:
        raise InputError("gpus: a share of a GPU is for engine ray; local workers share the GPU as it is")
    from vlmm_log.batches.local import run_local

    return run_local(tasks, work, workers=workers or os.cpu_count() or 1, retries=retries)


def _check(paths: Sequence[Path], s: Settings, queries: Sequence[str], recordings: Collection[str]) -> None:
    """Refuse at once what would fail for every log."""
    if not paths:
        raise InputError("no logs: name one at least")
    if not any(path.exists() for path in paths):
        raise InputError(f"{', '.join(map(str, paths[:5]))}: no such file or folder; name a log that there is")
    unknown = [name for name in recordings if name not in RECORDINGS]
    if unknown:
        raise InputError(f"recordings {unknown[0]!r}: no such kind; there are {', '.join(RECORDINGS)}")
    if not s.query.parser.startswith("llm:"):  # an endpoint is asked by each log, and paid for
        parse(queries, s)
    for _ in _named_files(s):
        pass  # weights that are missing are missed now
