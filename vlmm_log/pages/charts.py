"""Charts as SVG texts, the same bytes each time. matplotlib is imported where it is needed."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BLUE, VERMILION, ORANGE, GREEN = "#0072b2", "#d55e00", "#e69f00", "#009e73"
"""Told apart also by the colour-blind (Okabe and Ito)."""


def figure(width: float, height: float) -> Figure:
    """An empty figure, inches."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def plain(text: str) -> str:
    """A label that reads as the text: what stands between dollar signs is no formula."""
    return text.replace("$", r"\$")


def svg(drawn: Figure) -> str:
    """The figure as an SVG element."""
    import matplotlib

    out = io.StringIO()
    with matplotlib.rc_context({"svg.hashsalt": "vlmm-log", "svg.fonttype": "none"}):  # no random ids
        drawn.savefig(out, format="svg", metadata={"Date": None})
    text = out.getvalue()
    return text[text.index("<svg") :]
