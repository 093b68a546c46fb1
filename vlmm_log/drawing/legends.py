"""What colours mean: text, swatches and bars, in pixels."""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np

from vlmm_log.drawing.pictures import COLORMAPS, UNKNOWN
from vlmm_log.sinks.pair_entries import Range
from vlmm_log.types import UInt8

FONT, SCALE = cv2.FONT_HERSHEY_SIMPLEX, 0.45
LINE = 20  # px of a line of text
INK, DIM, PAPER = (235, 235, 235), (170, 170, 170), (18, 18, 18)  # BGR
SWATCH = 12  # px
Named = tuple[str, tuple[int, ...]]
"""A name and its RGB colour."""


def text_width(text: str) -> int:
    """Pixels that a text takes."""
    return int(cv2.getTextSize(text, FONT, SCALE, 1)[0][0])


def fitted(text: str, width: int) -> str:
    """As much of a text as fits."""
    if text_width(text) <= width:
        return text
    while text and text_width(f"{text}...") > width:
        text = text[:-1]
    return f"{text}..."


def write(on: UInt8, text: str, x: int, y: int, color: tuple[int, int, int] = INK) -> None:
    """Text whose line begins at a pixel (left, top)."""
    cv2.putText(on, text, (x, y + LINE - 6), FONT, SCALE, color, 1, cv2.LINE_AA)


def swatches(named: Iterable[Named], width: int) -> UInt8:
    """Squares of colour and their names, in as many lines as they take."""
    placed: list[tuple[int, int, str, tuple[int, ...]]] = []
    x = y = 0
    for name, color in named:
        wide = SWATCH + 5 + text_width(name) + 12
        if x and x + wide > width:
            x, y = 0, y + LINE
        placed.append((x, y, name, color))
        x += wide
    strip = np.full((y + LINE, width, 3), PAPER, np.uint8)
    for left, top, name, color in placed:
        strip[top + 4 : top + 4 + SWATCH, left : left + SWATCH] = color[::-1]
        write(strip, name, left + SWATCH + 5, top)
    return strip


def bar(look: Range, unit: str, absent: str, width: int) -> UInt8:
    """A colour map from its lowest to its highest number, and the grey of what has none."""
    low, high, colors = look
    strip = np.full((LINE, width, 3), PAPER, np.uint8)
    first, last = f"{low:g}", f"{high:g}{unit}"
    x = text_width(first) + 5
    rest = text_width(last) + 17 + SWATCH + 5 + text_width(absent)
    wide = max(min(width - x - rest, 240), 16)
    write(strip, first, 0, 0)
    ramp = cv2.applyColorMap(np.linspace(0, 255, wide).astype(np.uint8)[None], COLORMAPS[colors])
    strip[4 : 4 + SWATCH, x : x + wide] = ramp
    x += wide + 5
    write(strip, last, x, 0)
    x += text_width(last) + 12
    strip[4 : 4 + SWATCH, x : x + SWATCH] = UNKNOWN
    write(strip, absent, x + SWATCH + 5, 0)
    return strip
