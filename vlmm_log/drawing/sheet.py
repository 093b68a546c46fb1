"""A sheet: a caption and panels under it, each with its title and what its colours mean."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vlmm_log.drawing.panels import Panel, Size, Values
from vlmm_log.sinks.legend import DIM, LINE, PAPER, fitted, write
from vlmm_log.types import UInt8

WIDTH = 1280  # px
GAP = 6
CAPTION = LINE + GAP


@dataclass(frozen=True, eq=False)
class Sheet:
    """Where everything goes: equal for all frames of a recording."""

    blank: UInt8  # (H, W, 3) BGR, with titles and legends
    panels: tuple[Panel, ...]
    places: tuple[tuple[int, int], ...]  # left, top px of each panel's picture
    size: Size  # of each picture


def laid_out(panels: Sequence[Panel], aspect: float) -> Sheet:
    """A sheet of panels for images of a width over height, 1280 px wide."""
    columns = min(len(panels), 3) if len(panels) != 4 else 2
    width = (WIDTH - GAP * (columns + 1)) // columns
    height = max(round(width / aspect), LINE)
    legends = [None if p.legend is None else p.legend(width) for p in panels]
    rows = [range(k, min(k + columns, len(panels))) for k in range(0, len(panels), columns)]
    below = [max((len(legend) for k in row if (legend := legends[k]) is not None), default=0) for row in rows]
    tall = CAPTION + sum(LINE + height + GAP + legend for legend in below)
    blank = np.full((2 * math.ceil(tall / 2), WIDTH, 3), PAPER, np.uint8)  # videos have even sides
    places, top = [], CAPTION
    for row, legend_height in zip(rows, below, strict=True):
        for column, k in enumerate(row):
            left = GAP + column * (width + GAP)
            write(blank, fitted(panels[k].title, width), left, top)
            places.append((left, top + LINE))
            legend = legends[k]
            if legend is not None:
                y = top + LINE + height + 2
                blank[y : y + len(legend), left : left + width] = legend[: len(blank) - y]
        top += LINE + height + legend_height + GAP
    return Sheet(blank, tuple(panels), tuple(places), (width, height))


def drawn(sheet: Sheet, values: Values, caption: str) -> tuple[UInt8, tuple[Panel, ...]]:
    """(H, W, 3) BGR of a frame, and the panels that have nothing to show at it."""
    pixels, empty = sheet.blank.copy(), []
    write(pixels, fitted(caption, WIDTH - 2 * GAP), GAP, GAP // 2)
    width, height = sheet.size
    for panel, (left, top) in zip(sheet.panels, sheet.places, strict=True):
        shown = panel.draw(values, sheet.size)
        if shown is None:
            empty.append(panel)
            write(pixels, "nothing at this frame", left + GAP, top + height // 2 - LINE, DIM)
        else:
            pixels[top : top + height, left : left + width] = shown
    return pixels, tuple(empty)
