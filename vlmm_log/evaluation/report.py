"""Evaluations as plain values, and as JSON: the same bytes for the same run."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from vlmm_log.evaluation.results import CalibrationRow, Evaluation, ObjectRow, PixelRow
from vlmm_log.version import __version__

FORMAT, VERSION = "vlmm-log evaluation", 1
DIGITS = 6


def report(e: Evaluation) -> dict[str, Any]:
    """One evaluation. What is not known is None."""
    plain: dict[str, Any] = _plain(
        {
            "title": e.title,
            "logs": [asdict(log) for log in e.logs],
            "settings": e.settings,
            "versions": dict(e.versions),
            "pixels": [_pixel(r) for r in e.pixels],
            "objects": [_object(r) for r in e.objects],
            "things": None if e.things is None else asdict(e.things),
            "association": [asdict(a) for a in e.association],
            "calibration": [_calibration(r) for r in e.calibration],
            "static_d_m2": e.static_d_m2,
            "sigma_z": None if e.sigma_z is None else {"a_m": e.sigma_z[0], "b_per_m": e.sigma_z[1]},
            "worst": [{"log": w.source, "frame": w.index, "ap": w.ap} for w in e.worst],
        }
    )
    return plain


def to_json(evaluations: Sequence[Evaluation]) -> str:
    """The file."""
    table = {
        "format": FORMAT,
        "version": VERSION,
        "vlmm_log": __version__,
        "evaluations": [report(e) for e in evaluations],
    }
    return json.dumps(table, indent=1) + "\n"


def _pixel(r: PixelRow) -> dict[str, Any]:
    return asdict(r) | {"ap_interval": list(r.ap_interval)}


def _object(r: ObjectRow) -> dict[str, Any]:
    return {
        "name": r.name,
        "reference": r.reference,
        "ap": dict(r.ap),
        "decisions": {q: asdict(d) for q, d in r.decisions.items()},
        "macro_f1": r.macro_f1,
    }


def _calibration(r: CalibrationRow) -> dict[str, Any]:
    return {"name": r.name, "unit": r.unit, "ece": r.ece, "count": r.count, "bins": asdict(r.reliability)}


def _plain(value: Any) -> Any:
    """Rounded, without NaN: so that JSON holds it."""
    match value:
        case float():
            return round(value, DIGITS) if math.isfinite(value) else None
        case Mapping():
            return {str(k): _plain(v) for k, v in value.items()}
        case list() | tuple():
            return [_plain(v) for v in value]
        case _:
            return value
