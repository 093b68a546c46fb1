"""Evaluations as one page that needs nothing else: tables, charts, the worst frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np

from vlmm_log.drawing.pictures import coloured
from vlmm_log.evaluation.plots import ap_bars, reliability, sweep
from vlmm_log.evaluation.results import Evaluation, WorstFrame
from vlmm_log.evaluation.scores import QUERIES
from vlmm_log.pages.pictures import data_uri
from vlmm_log.pages.templates import rendered
from vlmm_log.types import UInt8
from vlmm_log.version import __version__

D_M_SHOWN = 8.0  # d_M as bright as it gets
COLORS = {  # of Outcome, BGR over the grey image; None: the image
    "hit": (115, 158, 0),
    "missed": (0, 94, 213),
    "not scored": (0, 159, 230),
    "false flag": (167, 121, 204),
    "no truth": (150, 150, 150),
}


@dataclass(frozen=True)
class Table:
    """Any other table, cells as they are to be read."""

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    text: str = ""
    links: Mapping[str, str] = field(default_factory=dict)


def page(title: str, evaluations: Sequence[Evaluation], tables: Sequence[Table] = ()) -> str:
    """The page as HTML; ``tables`` come first."""
    return rendered(
        "eval.html",
        {
            "title": title,
            "tables": tables,
            "sections": [_section(e) for e in evaluations],
            "queries": QUERIES,
            "version": __version__,
            "share": share,
            "number": number,
            "legend": {name: f"rgb({r},{g},{b})" for name, (b, g, r) in COLORS.items()},
        },
    )


def share(value: float | None) -> str:
    """A share in per cent; a dash where it is not known."""
    return "–" if value is None or value != value else f"{100 * value:.1f} %"


def number(value: float | None) -> str:
    """Three digits; a dash where it is not known."""
    return "–" if value is None or value != value else f"{value:.3f}"


def _section(e: Evaluation) -> dict[str, Any]:
    swept = dict.fromkeys(r.trial.partition("=")[0] for r in e.pixels if "=" in r.trial)
    charts = [(name, drawn) for name in swept if (drawn := sweep(e.pixels, name))]
    return {
        "e": e,
        "bars": ap_bars(e.pixels),
        "reliability": reliability(e.calibration),
        "sweeps": charts,
        "worst": [(w, [(name, data_uri(p)) for name, p in _pictures(w)]) for w in e.worst],
    }


def _pictures(w: WorstFrame) -> list[tuple[str, UInt8]]:
    bgr = np.ascontiguousarray(w.rgb[..., ::-1])
    grey = cv2.cvtColor(cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
    told = (0.45 * grey).astype(np.uint8)
    for k, color in enumerate(COLORS.values(), 1):
        told[w.outcome == k] = color
    return [
        ("colour", bgr),
        ("d_M", coloured(w.score, 0.0, D_M_SHOWN, cv2.COLORMAP_MAGMA)),
        ("against the truth", told),
    ]
