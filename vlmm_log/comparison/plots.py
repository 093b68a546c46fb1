"""Plots of a difference, as SVG texts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from vlmm_log.comparison.difference import Difference
from vlmm_log.comparison.words import HISTORY
from vlmm_log.entries import Scalar
from vlmm_log.pages.charts import BLUE, VERMILION, figure, plain, svg
from vlmm_log.recording import Recording

CURVES = ("flagged_share", "median_d_m", "inlier_share", "valid_share")
MOST = 30  # entities


def where_and_when(d: Difference) -> str | None:
    """Entities against frames: how far apart, each entity up to its own largest distance; None where nothing is."""
    shown = [e for e in d.entities if e.stage and not HISTORY.fullmatch(e.entity)][:MOST]
    frames = sorted({f.at.index for e in shown for f in e.frames if f.at.index is not None})
    frames = sorted({*frames, *(p.index for e in shown for p in (*e.only_a, *e.only_b) if p.index is not None)})
    if not shown or not frames:
        return None
    span = np.arange(frames[0], frames[-1] + 1)
    shares = np.zeros((len(shown), len(span)))
    for row, e in enumerate(shown):
        largest = max((f.badness[0] for f in e.frames), default=0.0)
        for f in e.frames:
            if f.at.index is not None:
                share = f.badness[0] / largest if largest else f.share
                shares[row, f.at.index - span[0]] = max(share, 0.05)  # one pixel is to be seen, too
        for p in (*e.only_a, *e.only_b):
            if p.index is not None:
                shares[row, p.index - span[0]] = 1.0
    drawn = figure(11.0, 0.9 + 0.24 * len(shown))
    axes = drawn.subplots()
    edges = (span[0] - 0.5, span[-1] + 0.5, len(shown) - 0.5, -0.5)
    image = axes.imshow(shares, aspect="auto", extent=edges, cmap="magma_r", vmin=0, vmax=1, interpolation="nearest")
    names = [plain(e.entity.replace("world/camera/image/", "").replace("world/", "")) for e in shown]
    axes.set_yticks(range(len(shown)), names, fontsize=8)
    axes.set_xlabel("frame", fontsize=8)
    axes.tick_params(axis="x", labelsize=8)
    drawn.colorbar(image, ax=axes, pad=0.01).ax.tick_params(labelsize=7)
    return svg(drawn)


def curves(recordings: tuple[Recording, Recording]) -> str | None:
    """Figures of every pair in A and B."""
    values = [_scalars(recording) for recording in recordings]
    names = [name for name in CURVES if all(name in v for v in values)]
    if not names:
        return None
    drawn = figure(11.0, 1.3 * len(names) + 0.4)
    for axes, name in zip(np.atleast_1d(drawn.subplots(len(names), 1, sharex=True)), names, strict=True):
        for v, label, color, style in zip(values, "AB", (BLUE, VERMILION), ("-", "--"), strict=True):
            x, y = zip(*v[name], strict=True)
            axes.plot(x, y, style, label=label, color=color, linewidth=1.2)
        axes.set_ylabel(name, fontsize=8)
        axes.tick_params(labelsize=7)
        axes.legend(fontsize=7, loc="upper right")
    axes.set_xlabel("frame", fontsize=8)
    return svg(drawn)


def _scalars(recording: Recording) -> Mapping[str, Sequence[tuple[int, float]]]:
    found: dict[str, list[tuple[int, float]]] = {}
    for e in recording.entries([f"stats/{name}" for name in CURVES]):
        if isinstance(e.value, Scalar) and e.index is not None:
            found.setdefault(e.entity.removeprefix("stats/"), []).append((e.index, e.value.value))
    return found
