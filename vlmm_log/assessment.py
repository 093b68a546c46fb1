"""``eval``: the method, its variants and other ways, on logs of which the truth is known."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from vlmm_log import se3
from vlmm_log.api import versions
from vlmm_log.calibration import Calibration
from vlmm_log.elements import Movability
from vlmm_log.evaluation import summary
from vlmm_log.evaluation.baselines.dewan import DewanStyle
from vlmm_log.evaluation.baselines.displacement import NoUncertainty, RawDisplacement
from vlmm_log.evaluation.baselines.khronos import KhronosStyle
from vlmm_log.evaluation.baselines.protocol import Baseline
from vlmm_log.evaluation.baselines.semantic import (
    ConceptGraphsStyle,
    DualMapStyle,
    SemanticOnly,
    VlMapsStyle,
    VoxelandStyle,
)
from vlmm_log.evaluation.bench import Bench, LogRun
from vlmm_log.evaluation.results import Evaluated, Evaluation
from vlmm_log.evaluation.trial import FlowOnce, Plan, SegmentsOnce, Trial, WithoutIdentities
from vlmm_log.evaluation.truth import MotionMasks, People, Simulated, Truth
from vlmm_log.evaluation.variants import profiles, swept, without_levers
from vlmm_log.models.load import load_models
from vlmm_log.models.prior import TablePrior, normal, read_table
from vlmm_log.pipeline.run import Tally, expected_pairs, keyframe_pairs
from vlmm_log.protocols import Embedder, Models, Progress
from vlmm_log.readers import opened
from vlmm_log.readers.stamps import limit_ns
from vlmm_log.settings import Settings
from vlmm_log.types import Frame, FramePair, InputError, Skipped

PERSON = "person"  # --truth person: the paper's proxy
EGO_OFF = ("ego.model=off",)


@dataclass(frozen=True)
class Comparison:
    """What is compared beside the settings as asked."""

    profiles: bool = False
    levers: bool = False
    baselines: bool = False
    association: bool = False
    sweeps: tuple[tuple[str, tuple[str, ...]], ...] = ()  # setting, values
    pose_noise: tuple[float, float] | None = None  # degrees, cm


NOTHING_ELSE = Comparison()


def evaluate(
    sources: Sequence[str | Path],
    *,
    truth: str | Path | None = None,
    settings: Settings | None = None,
    compare: Comparison = NOTHING_ELSE,
    calibration: Calibration | None = None,
    title: str = "",
    progress: Progress | None = None,
) -> Evaluation:
    """Judge the method, and what it is compared with, on logs of which the truth is known.

    ``truth`` is a folder (a simulated scene's, or masks by frame index: 0 static, 128 ignored, 255 moving) or "person";
    without it each log's own ``truth`` folder is taken. Where truth has masks, they are the segmenter's unless another
    one than ``geometric`` is set. Raises InputError where a log, a truth or a setting cannot be used.
    """
    s = settings or Settings()
    if not sources:
        raise InputError("eval: no log; name one or more")
    bench, logs = Bench(), []
    found: dict[str, str] = {}
    plans: list[Plan] = []
    references: dict[str, str] = {}
    for k, source in enumerate(map(Path, sources)):
        own = _settings_for(source, s, truth)
        models, of_models = load_models(own)
        found |= versions() | of_models
        models = replace(models, flow=FlowOnce(models.flow), segment=SegmentsOnce(models.segment))
        bench.withheld = _OthersPrior(models.embed)
        plans = _plans(own, compare)
        baselines = _baselines(own, models) if compare.baselines else []
        references |= {b.name: b.reference for b in baselines}
        told = None if progress is None else partial(_tell, progress, k, len(sources))
        judge = _truth(source, truth, models)
        logs.append(_run(source, own, models, bench, plans, judge, baselines, told))
    if not bench.pixels:
        raise InputError(f"{sources[0]}: no pair of it has a truth; see --truth")
    return summary.evaluation(bench, title or ", ".join(e.name for e in logs), logs, s, found, references, calibration)


def _settings_for(source: Path, s: Settings, truth: str | Path | None) -> Settings:
    """True masks where the truth has them and no other were asked for."""
    folder = _simulated(source, truth)
    if folder is None or s.objects.segmenter != "geometric":
        return s
    return replace(s, objects=replace(s.objects, segmenter=f"masks:{folder / 'instances'}"))


def _simulated(source: Path, truth: str | Path | None) -> Path | None:
    for folder in (source / "truth",) if truth is None else (Path(truth), Path(truth) / "truth"):
        if (folder / "truth.json").is_file():
            return folder
    return None


def _truth(source: Path, truth: str | Path | None, models: Models) -> Truth:
    folder = _simulated(source, truth)
    if folder is not None:
        return Simulated(folder)
    if truth is None:
        raise InputError(
            f"{source}: no truth in it; give --truth FOLDER (0 static, 128 ignored, 255 moving) or --truth person"
        )
    return People(models.segment) if str(truth) == PERSON else MotionMasks(Path(truth))


def _plans(s: Settings, compare: Comparison) -> list[Plan]:
    """All trials: the settings as asked first."""
    of_profiles = profiles(s)
    name = s.profile if s == of_profiles[s.profile] else "as set"
    plans = [Plan(name, s)]
    if compare.profiles:
        plans += [Plan(n, p) for n, p in of_profiles.items() if n != name]
        plans.append(Plan("paper, ego off", of_profiles["paper"].changed(EGO_OFF)))
    if compare.levers:
        plans += [Plan(n, p) for n, p in without_levers(s).items()]
    for setting, values in compare.sweeps:
        plans += [Plan(n, p) for n, p in swept(s, setting, values).items()]
    if compare.pose_noise is not None:
        deg, cm = compare.pose_noise
        disturb = partial(_disturbed, float(np.deg2rad(deg)), cm / 100.0, s.seed)
        told = f"poses off by {deg:g} deg, {cm:g} cm"
        off = s.changed(EGO_OFF)
        plans += [Plan("ego off", off), Plan(f"{name}, {told}", s, disturb), Plan(f"ego off, {told}", off, disturb)]
    if compare.association:
        plans.append(Plan("identities withheld", s, _withheld, same_ids=False))
    return plans


def _disturbed(
    sigma_rad: float, sigma_m: float, seed: int, pair: FramePair, models: Models
) -> tuple[FramePair, Models]:
    """Poses with Gaussian errors, each frame's own. Both ends of a pair have one."""

    def moved(frame: Frame) -> Frame:
        if frame.T_world_cam is None:
            return frame
        draw = np.random.default_rng([seed, 7, frame.index]).standard_normal(6)
        axis = draw[:3] / np.linalg.norm(draw[:3]) * sigma_rad  # the whole angle, and the whole offset, about an axis
        offset = draw[3:] / np.linalg.norm(draw[3:]) * sigma_m
        return replace(frame, T_world_cam=frame.T_world_cam @ se3.exp(np.concatenate([axis, offset])))

    return FramePair(moved(pair.first), moved(pair.second)), models


def _withheld(pair: FramePair, models: Models) -> tuple[FramePair, Models]:
    return pair, replace(models, segment=WithoutIdentities(models.segment))


@dataclass(frozen=True)
class _OthersPrior:
    """A table prior that must do without the name it is asked for: open vocabulary put to the test."""

    embed: Embedder

    def __call__(self, label: str) -> Movability:
        """From similar names alone."""
        rest = {name: m for name, m in read_table().items() if name != normal(label)}
        return TablePrior(self.embed, rest)(label)


def _baselines(s: Settings, models: Models) -> list[Baseline]:
    embedder = s.objects.embedder.partition(":")[0]
    return [
        RawDisplacement(),
        NoUncertainty(s, models.prior),
        SemanticOnly(models.embed, embedder),
        VlMapsStyle(models.embed),
        ConceptGraphsStyle(models.embed),
        DualMapStyle(models.embed),
        VoxelandStyle(models.prior),
        DewanStyle(models.prior),
        KhronosStyle(),
    ]


def _run(
    source: Path,
    s: Settings,
    models: Models,
    bench: Bench,
    plans: Sequence[Plan],
    truth: Truth,
    baselines: Sequence[Baseline],
    tell: Callable[[int, int], None] | None,
) -> Evaluated:
    """One log, from its first pair to its last."""
    log, _ = opened(source, s.read)
    trials = [Trial.start(plan, has_poses=log.has_poses) for plan in plans]
    run = LogRun(bench, log.name, truth, trials, baselines)
    window = limit_ns(s.read.start_s), limit_ns(s.read.stop_s)
    expected = expected_pairs(log.count(*window), s.keyframes)
    tally, skipped, pairs = Tally(), Counter[str](), 0
    with closing(keyframe_pairs(log.frames(*window), s, tally)) as stream:
        for item in stream:
            if isinstance(item, Skipped):
                skipped[item.reason] += 1
                continue
            run.see(item, models)
            pairs += 1
            if tell is not None:
                tell(pairs, expected)
    run.finish()
    return Evaluated(
        log.name, truth.name, tally.input_hash(), tally.frames, pairs, run.judged_pairs, dict(sorted(skipped.items()))
    )


def _tell(progress: Progress, log: int, logs: int, done: int, expected: int) -> None:
    progress(log * expected + done, logs * expected)
