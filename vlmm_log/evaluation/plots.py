"""Charts of evaluations."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from vlmm_log.evaluation.results import CalibrationRow, PixelRow
from vlmm_log.pages.charts import BLUE, GREEN, ORANGE, VERMILION, figure, plain, svg

COLORS = (VERMILION, BLUE, GREEN, ORANGE)


def ap_bars(rows: Sequence[PixelRow]) -> str | None:
    """Full-frame average precision with its interval, a bar a row; the prevalence as a line. None without rows."""
    shown = [r for r in rows if r.ap == r.ap]
    if not shown:
        return None
    drawn = figure(11.0, 0.9 + 0.27 * len(shown))
    axes = drawn.subplots()
    at = np.arange(len(shown))
    ap = np.array([r.ap for r in shown])
    low, high = (np.array([r.ap_interval[k] for r in shown]) for k in (0, 1))
    error = np.nan_to_num(np.stack([ap - low, high - ap])).clip(0)
    colors = [BLUE if r.score == "d_M" else "#b8c4d0" for r in shown]
    axes.barh(at, ap, xerr=error, color=colors, height=0.72, error_kw={"elinewidth": 1, "ecolor": "#1c2733"})
    axes.axvline(shown[0].prevalence, color=VERMILION, linewidth=1, linestyle="--")
    axes.set_yticks(at, [plain(f"{r.trial}, {r.score}") for r in shown], fontsize=8)
    axes.invert_yaxis()
    axes.set_xlim(0, 1)
    axes.set_xlabel("full-frame average precision, 95 % interval over frames; dashed: prevalence", fontsize=8)
    axes.tick_params(axis="x", labelsize=8)
    return svg(drawn)


def reliability(rows: Sequence[CalibrationRow]) -> str | None:
    """Confidence against frequency, one panel a row that holds anything; circles as large as what they hold."""
    shown = [row for row in rows if row.count]
    if not shown:
        return None
    drawn = figure(2.75 * len(shown), 2.9)
    for axes, row in zip(np.atleast_1d(drawn.subplots(1, len(shown))), shown, strict=True):
        r = row.reliability
        held = [(c, f, w) for c, f, w in zip(r.confidence, r.frequency, r.weight, strict=True) if w > 0]
        c, f, w = (np.array(x) for x in zip(*held, strict=True))
        axes.plot([0, 1], [0, 1], color="#b8c4d0", linewidth=1)
        axes.plot(c, f, color=BLUE, linewidth=1)
        axes.scatter(c, f, s=12 + 160 * np.sqrt(w), color=BLUE, alpha=0.55, linewidths=0)
        axes.set_title(f"{plain(row.name)}\n{row.unit}, ECE {row.ece:.3f}", fontsize=8)
        axes.set_xlim(-0.03, 1.03)
        axes.set_ylim(-0.03, 1.03)
        axes.tick_params(labelsize=7)
        axes.set_xlabel("confidence", fontsize=7)
        axes.set_ylabel("how often right", fontsize=7)
    return svg(drawn)


def sweep(rows: Sequence[PixelRow], name: str) -> str | None:
    """Average precision against a swept setting's value; None for fewer than two numbers."""
    points = sorted((at, r.ap) for r in rows if r.score == "d_M" and (at := _value_of(r, name)) is not None)
    if len(points) < 2:
        return None
    x, y = zip(*points, strict=True)
    drawn = figure(5.0, 2.6)
    axes = drawn.subplots()
    axes.plot(x, y, "o-", color=BLUE, linewidth=1.2, markersize=4)
    axes.set_xlabel(name, fontsize=8)
    axes.set_ylabel("full-frame AP", fontsize=8)
    axes.tick_params(labelsize=7)
    return svg(drawn)


def _value_of(row: PixelRow, name: str) -> float | None:
    """The number that a row's trial sets a setting to; None where it is none."""
    setting, _, text = row.trial.partition("=")
    try:
        value = float(text)
    except ValueError:
        return None
    return value if setting == name and math.isfinite(value) else None
