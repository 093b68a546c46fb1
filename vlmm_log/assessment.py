"""``eval``: the method, its variants and other ways, on logs of which the truth is known."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from vlmm_log.api import versions
from vlmm_log.elements import Movability
from vlmm_log.evaluation import summary
from vlmm_log.evaluation.baselines.listed import all_baselines
from vlmm_log.evaluation.bench import Bench, LogRun
from vlmm_log.evaluation.plans import Comparison, plans
from vlmm_log.evaluation.report import to_json
from vlmm_log.evaluation.results import Evaluated, Evaluation
from vlmm_log.evaluation.shelf import Shelf
from vlmm_log.evaluation.trial import FlowOnce, Plan, SegmentsOnce
from vlmm_log.evaluation.truth import MotionMasks, People, SimulatedTruth, Truth
from vlmm_log.models.curves import load_curves
from vlmm_log.models.load import load_models
from vlmm_log.models.prior import TablePrior, normal, read_table
from vlmm_log.outputs import claim, replacing
from vlmm_log.pipeline.run import Tally, expected_pairs, keyframe_pairs
from vlmm_log.protocols import Embedder, Log, Models, Progress
from vlmm_log.readers import opened
from vlmm_log.readers.lasting import lasting
from vlmm_log.readers.stamps import limit_ns
from vlmm_log.settings import Settings
from vlmm_log.types import InputError, RunEnd, Skipped

PERSON = "person"  # --truth person: the paper's proxy
NOTHING_ELSE = Comparison()


def evaluate(
    sources: str | Path | Sequence[str | Path],
    *,
    truth: str | Path | None = None,
    settings: Settings | None = None,
    compare: Comparison = NOTHING_ELSE,
    segmenter: str | None = None,
    calibration: str | Path | None = None,
    calibrate: str | Path | None = None,
    json: str | Path | None = None,
    html: str | Path | None = None,
    recordings: str | Path | None = None,
    title: str = "",
    force: bool = False,
    progress: Progress | None = None,
) -> Evaluation:
    """Judge the method, and what it is compared with, on logs of which the truth is known.

    ``truth`` is a folder (a simulated scene's, or masks by frame index: 0 static, 128 ignored, 255 moving; of several
    logs: a folder that holds one for each, by the log's name), or "person"; without it each log's own ``truth`` is
    taken. Where a truth has masks, they are taken, unless ``segmenter`` names another one (as
    ``objects.segmenter`` does) or the settings name another one than ``geometric``.

    ``calibrate`` writes the probabilities fitted on these logs, ``calibration`` judges those of such a file, ``json``
    and ``html`` write the report, ``recordings`` names a folder for a Rerun recording of each trial, and of each
    baseline that scores pixels.
    Raises InputError where a log, a truth, a setting or an output cannot be used.
    """
    s = settings or Settings()
    paths = [Path(source) for source in ([sources] if isinstance(sources, str | Path) else sources)]
    if not paths:
        raise InputError("eval: no log; name one or more")
    outputs = [Path(path) for path in (calibrate, json, html) if path is not None]
    claim(outputs, force=force, inputs=paths)
    folder = None if recordings is None else Path(recordings)
    _check_shelf(folder, force)
    if segmenter is not None:
        s = replace(s, objects=replace(s.objects, segmenter=segmenter))
    judged_by = load_curves(s if calibration is None else _calibrated(s, Path(calibration)))[0]
    sequences = [opened(path, s.read) for path in paths]
    truths = [None if str(truth) == PERSON else _truth(path, truth, len(paths)) for path in paths]
    places = _places(folder, paths)
    bench, logs = Bench(), []
    used: dict[str, str] = {}
    references: dict[str, str] = {}
    for k, (path, (log, reader), listed) in enumerate(zip(paths, sequences, truths, strict=True)):
        told = None if progress is None else partial(_tell, progress, k, len(paths))
        own = s if segmenter is not None else _with_true_masks(s, listed)
        models, of_models = load_models(own)
        of_run = versions() | of_models
        used |= of_run
        models = replace(
            models, flow=FlowOnce(models.flow), segment=SegmentsOnce(models.segment), calibration=None
        )  # curves hold for one trial's settings alone
        bench.withheld = _OthersPrior(models.embed)
        baselines = all_baselines(own, models) if compare.baselines else []
        references |= {b.name: b.reference for b in baselines}
        planned = _planned(path, log, own, compare)
        shelf = None if folder is None else Shelf(places[k], log, reader, of_run)
        run = LogRun.start(bench, log, listed or People(models.segment), planned, baselines, shelf, force)
        logs.append(_through(path, log, own, models, run, told))
    if not bench.pixels:
        raise InputError(f"{paths[0]}: {_why_nothing(logs, truth)}")
    done = summary.evaluation(bench, title or ", ".join(e.name for e in logs), logs, s, used, references, judged_by)
    _write(done, calibrate, json, html, force)
    return done


def _write(
    done: Evaluation, calibrate: str | Path | None, json: str | Path | None, html: str | Path | None, force: bool
) -> None:
    from vlmm_log.evaluation.page import page

    texts: dict[Path, str] = {}
    if calibrate is not None and done.fitted is not None:
        texts[Path(calibrate)] = done.fitted.to_json()
    if json is not None:
        texts[Path(json)] = to_json([done])
    if html is not None:
        texts[Path(html)] = page(f"Evaluation: {done.title}", [done])
    if texts:
        with replacing(*texts, force=force) as partials:
            for partial_path, text in zip(partials, texts.values(), strict=True):
                partial_path.write_text(text, "utf-8")
    if calibrate is not None and done.fitted is None:
        also = f"; the rest is written: {', '.join(str(path) for path in texts)}" if texts else ""
        raise InputError(f"{calibrate}: nothing to fit: no moving pixel was scored, or no static one{also}")


def _check_shelf(folder: Path | None, force: bool) -> None:
    """Refuse before a long run what could not be written in it."""
    if folder is None:
        return
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is a file; name a folder for the recordings")
    if not force and folder.is_dir() and next(folder.rglob("*.rrd"), None) is not None:
        raise InputError(f"{folder}: holds recordings; give --force to replace them, or name another folder")


def _places(folder: Path | None, paths: Sequence[Path]) -> list[Path]:
    """Where each log's recordings go: of several logs, a folder each, numbered where names are alike."""
    if folder is None or len(paths) == 1:
        return [folder or Path()] * len(paths)
    names = [path.resolve().name for path in paths]
    return [folder / (f"{name}_{k}" if names.count(name) > 1 else name) for k, name in enumerate(names, 1)]


def _planned(path: Path, log: Log, s: Settings, compare: Comparison) -> list[Plan]:
    """What is compared on a log. Without poses, what needs them is left out. Raises InputError where all of it does."""
    planned = plans(s, compare)
    if log.has_poses:
        return planned
    if s.ego.model == "off" or compare.pose_noise is not None:
        raise InputError(f"{path}: no poses, and ego.model = off and --pose-noise need them; leave these out")
    return [plan for plan in planned if plan.settings.ego.model != "off"]


def _why_nothing(logs: Sequence[Evaluated], truth: str | Path | None) -> str:
    if not any(log.pairs for log in logs):
        counts = Counter[str]()
        for log in logs:
            counts.update(log.skipped)
        reasons = "; ".join(f"{reason} ({n}x)" for reason, n in counts.most_common(3))
        return f"no pair of frames could be processed: {reasons or 'fewer frames than the keyframe gap'}"
    if str(truth) == PERSON:
        return "nobody was found in it; give --segmenter yolo:FILE.onnx, or masks:FOLDER with a label 'person'"
    return "no pair of it has a truth; see --truth"


def _calibrated(s: Settings, file: Path) -> Settings:
    return replace(s, calibration=replace(s.calibration, file=str(file)))


def _with_true_masks(s: Settings, truth: Truth | None) -> Settings:
    """True masks where the truth has them and no other were asked for."""
    if not isinstance(truth, SimulatedTruth) or s.objects.segmenter != "geometric":
        return s
    return replace(s, objects=replace(s.objects, segmenter=f"masks:{truth.folder / 'instances'}"))


def _truth(log: Path, truth: str | Path | None, logs: int) -> Truth:
    """A log's truth. Raises InputError where there is none."""
    folder = _truth_folder(log, truth, logs)
    simulated = next((f for f in (folder, folder / "truth") if (f / "truth.json").is_file()), None)
    if simulated is not None:
        return SimulatedTruth(simulated)
    if truth is None and not any(folder.glob("[0-9]*.png")):
        raise InputError(
            f"{log}: no truth in it; give --truth FOLDER (0 static, 128 ignored, 255 moving) or --truth person"
        )
    return MotionMasks(folder)


def _truth_folder(log: Path, truth: str | Path | None, logs: int) -> Path:
    if truth is None:
        return log / "truth"
    named = Path(truth) / log.resolve().name
    if named.is_dir():
        return named
    if logs > 1:
        raise InputError(f"{named}: no such folder; of several logs, --truth is a folder that holds one for each")
    return Path(truth)


@dataclass(frozen=True)
class _OthersPrior:
    """A table prior that must do without the name it is asked for: open vocabulary put to the test."""

    embed: Embedder

    def __call__(self, label: str) -> Movability:
        """From similar names alone."""
        rest = {name: m for name, m in read_table().items() if name != normal(label)}
        return TablePrior(self.embed, rest)(label)


def _through(
    path: Path, log: Log, s: Settings, models: Models, run: LogRun, tell: Callable[[int, int], None] | None
) -> Evaluated:
    """One log, from its first pair to its last."""
    window = limit_ns(s.read.start_s), limit_ns(s.read.stop_s)
    expected = expected_pairs(log.count(*window), s.keyframes)
    tally, skipped, pairs = Tally(), Counter[str](), 0
    complete = False
    try:
        with closing(keyframe_pairs(lasting(path, log.frames(*window)), s, tally)) as stream:
            for item in stream:
                if isinstance(item, Skipped):
                    skipped[item.reason] += 1
                    run.skip(item)
                    continue
                run.see(item, models)
                pairs += 1
                if tell is not None:
                    tell(pairs, expected)
        complete = True
    finally:
        run.close(RunEnd(complete, tally.input_hash(), tally.frames, pairs))
    run.rank()
    counts = dict(sorted(skipped.items()))
    return Evaluated(log.name, run.truth.name, tally.input_hash(), tally.frames, pairs, run.judged_pairs, counts)


def _tell(progress: Progress, log: int, logs: int, done: int, expected: int) -> None:
    progress(log * expected + done, logs * expected)
