"""From a bench's counts to rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from vlmm_log.calibration import Calibration, deciding
from vlmm_log.evaluation import metrics as m
from vlmm_log.evaluation.bench import Bench, ElementScores
from vlmm_log.evaluation.counts import Summed, bin_floor
from vlmm_log.evaluation.isotonic import element_curve, pixel_curve
from vlmm_log.evaluation.results import Association, CalibrationRow, Evaluated, Evaluation, ObjectRow, PixelRow, Things
from vlmm_log.evaluation.scores import QUERIES, Scores, query_truth, taken, true_class
from vlmm_log.settings import Settings
from vlmm_log.types import Float64


def evaluation(
    bench: Bench,
    title: str,
    logs: Sequence[Evaluated],
    s: Settings,
    versions: Mapping[str, str],
    references: Mapping[str, str],
    calibration: Calibration | None,
) -> Evaluation:
    """All rows of a bench that has judged something."""
    rng = np.random.default_rng(s.seed)
    first = next(iter(bench.pixels.values())).counts.summed()
    return Evaluation(
        title,
        tuple(logs),
        s.to_toml(),
        versions,
        pixel_rows(bench, rng),
        object_rows(bench, references, rng),
        things(bench),
        associations(bench),
        calibration_rows(bench, calibration),
        fitted_calibration(bench, logs, s),
        static_d_m2(first),
        bench.noise.model(s.noise.sigma_z_z0),
        tuple(bench.worst.frames),
    )


def fitted_calibration(bench: Bench, logs: Sequence[Evaluated], s: Settings) -> Calibration | None:
    """Curves of the first trial; None where the truth has but one kind of pixels."""
    first = next(iter(bench.pixels.values())).counts.summed()
    pixel = pixel_curve(first)
    if pixel is None:
        return None
    element = element_curve(evidence(bench.elements), found(bench.elements)[0]) if bench.elements else None
    return Calibration(
        pixel,
        element,
        deciding(s),
        tuple(f"{log.name} {log.input_hash[:16]}" for log in logs),
        static_d_m2(first),
        bench.noise.model(s.noise.sigma_z_z0),
    )


def pixel_rows(bench: Bench, rng: np.random.Generator) -> tuple[PixelRow, ...]:
    """One row a score; the first one's recall is what far flags are compared at."""
    summed = {key: held.counts.summed() for key, held in bench.pixels.items()}
    recall = next(iter(summed.values())).recall if summed else float("nan")
    rows = []
    for (trial, score), s in summed.items():
        held = bench.pixels[trial, score]
        low, high = m.interval(held.counts, m.full_frame_ap, rng)
        rows.append(
            PixelRow(
                trial, score, m.full_frame_ap(s), (low, high), m.scored_ap(s), s.coverage, s.prevalence, s.recall,
                s.precision, s.static_flags, s.far_flags, s.far_flags_at(recall), held.threshold, s.pixels,
                len(held.counts.frames),
            )
        )  # fmt: skip
    return tuple(rows)


def object_rows(bench: Bench, references: Mapping[str, str], rng: np.random.Generator) -> tuple[ObjectRow, ...]:
    """One row a way, over the elements of all logs; and chance."""
    if not bench.elements:
        return ()
    moved, movability = _truth(bench.elements)
    truth, classes = query_truth(moved, movability), true_class(moved, movability)
    names = [name for name in bench.elements[0].ways if all(name in e.ways for e in bench.elements)]
    rows = [_object_row(name, references.get(name, ""), bench.elements, truth, classes) for name in names]
    chance = {
        q: float(np.mean([m.element_average_precision(yes, rng.random(yes.size)) for _ in range(200)]))
        for q, yes in truth.items()
    }
    return (*rows, ObjectRow("random", "mean of 200 random orders", chance, {}, float("nan")))


def things(bench: Bench) -> Things | None:
    """What there was to find; None where no truth had things."""
    if not bench.elements:
        return None
    moved, movability = _truth(bench.elements)
    rows = np.concatenate([e.judged.rows for e in bench.elements])
    share = {q: float(yes.mean()) for q, yes in query_truth(moved, movability).items()}
    return Things(int((rows >= 0).sum()), int((rows < 0).sum()), share)


def associations(bench: Bench) -> tuple[Association, ...]:
    """Identities of the trials that are asked about them: means over logs, weighed by what was seen."""
    rows = []
    for name, counted in bench.things.items():
        seen = [c for c in counted if c.true_seen]
        if seen:
            weight = [c.true_seen + c.found_seen for c in seen]
            elements = sum(len({e for e, _ in c.overlap}) for c in seen)
            score = float(np.average([c.idf1 for c in seen], weights=weight))
            rows.append(Association(name, score, elements, sum(len(c.most_pixels) for c in seen)))
    return tuple(rows)


def calibration_rows(bench: Bench, calibration: Calibration | None) -> tuple[CalibrationRow, ...]:
    """Of the first trial: as it is, and by a calibration that was fitted elsewhere."""
    if not bench.pixels:
        return ()
    s = next(iter(bench.pixels.values())).counts.summed()
    d_m = bin_floor(s.at).astype(np.float64)
    raw = {"1 - p_stat": 1.0 - chdtrc(3, d_m**2)}
    if calibration is not None:
        raw["calibrated"] = calibration.pixel(d_m).astype(np.float64)
    moving, static = s.moving.astype(np.float64), s.static.astype(np.float64)
    count = int(s.moving.sum() + s.static.sum())
    rows = [CalibrationRow(n, "pixel", m.reliability(p, moving, static), count) for n, p in raw.items()]
    return (*rows, *_of_elements(bench.elements, calibration)) if bench.elements else tuple(rows)


def _of_elements(logs: Sequence[ElementScores], calibration: Calibration | None) -> list[CalibrationRow]:
    moved, right = found(logs)
    probabilities = {
        "kappa, of having moved": (joined(logs, "kappa"), moved),
        "c, of the class": (joined(logs, "confidence"), right),
    }
    if calibration is not None and calibration.element is not None:
        p = calibration.element(evidence(logs)).astype(np.float64)
        probabilities["calibrated, of having moved"] = (p, moved)
    return [
        CalibrationRow(name, "element", m.reliability(p, yes.astype(np.float64), (~yes).astype(np.float64)), yes.size)
        for name, (p, yes) in probabilities.items()
    ]


def found(logs: Sequence[ElementScores]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Of the elements of all logs, missed things left out: which have moved in truth, and whose class is right."""
    there = np.concatenate([e.judged.rows for e in logs]) >= 0
    moved, movability = _truth(logs)
    said = np.concatenate([e.columns.motion_class for e in logs])
    return moved[there], said == true_class(moved[there], movability[there])


def evidence(logs: Sequence[ElementScores]) -> Float64:
    """(n,) of having moved, of the elements of all logs."""
    return np.concatenate([e.evidence for e in logs])


def joined(logs: Sequence[ElementScores], column: str) -> Float64:
    """(n,) a column of the elements of all logs."""
    return np.concatenate([getattr(e.columns, column) for e in logs]).astype(np.float64)


def static_d_m2(s: Summed) -> float:
    """Median of d_M^2 over static pixels."""
    if not s.static.sum():
        return float("nan")
    middle = int(np.searchsorted(np.cumsum(s.static), s.static.sum() / 2))
    return float(bin_floor(s.at[middle : middle + 1])[0]) ** 2


def _truth(logs: Sequence[ElementScores]) -> tuple[NDArray[np.bool_], Float64]:
    """What is true of all elements and missed things: moved, movability."""
    return (
        np.concatenate([e.judged.moved for e in logs]),
        np.concatenate([e.judged.movability for e in logs]),
    )


def _object_row(
    name: str,
    reference: str,
    logs: Sequence[ElementScores],
    truth: dict[str, NDArray[np.bool_]],
    classes: NDArray[np.uint8],
) -> ObjectRow:
    candidates = [_over_logs(logs, name, k) for k in range(len(logs[0].ways[name]))]
    ap = {q: max(m.element_average_precision(truth[q], c.of(q)) for c in candidates) for q in QUERIES}
    first = candidates[0]
    named = first.named or {}
    decisions = {q: m.decision(truth[q], yes) for q, yes in named.items()}
    f1 = float("nan") if first.motion_class is None else m.macro_f1(classes.tolist(), first.motion_class.tolist(), 3)
    return ObjectRow(name, reference, ap, decisions, f1)


def _over_logs(logs: Sequence[ElementScores], name: str, candidate: int) -> Scores:
    """One candidate over all logs; a thing that became no element comes last and is never named."""
    parts = [taken(e.ways[name][candidate], e.judged.rows) for e in logs]
    named = [p.named for p in parts]
    y = [p.motion_class for p in parts]
    moving, movable, static = (np.concatenate([p.of(q) for p in parts]) for q in QUERIES)
    return Scores(
        moving,
        movable,
        static,
        None if any(n is None for n in named) else {q: np.concatenate([n[q] for n in named if n]) for q in QUERIES},
        None if any(c is None for c in y) else np.concatenate([c for c in y if c is not None]),
    )
