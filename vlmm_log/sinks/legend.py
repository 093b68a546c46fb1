"""What colours mean: text, swatches and bars, in pixels."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import cv2
import numpy as np

from vlmm_log.elements import CLASS_COLORS
from vlmm_log.sinks.map_entries import HIT_COLOR
from vlmm_log.sinks.pair_entries import IMAGE, LOOKS, MOVED, Range
from vlmm_log.sinks.views import VALIDITY_COLORS, flow_color
from vlmm_log.types import UInt8

COLORMAPS = {"viridis": cv2.COLORMAP_VIRIDIS, "magma": cv2.COLORMAP_MAGMA}
UNKNOWN = 96  # grey of a pixel without a number: neither end of a colour map
FONT, SCALE = cv2.FONT_HERSHEY_SIMPLEX, 0.45
LINE = 20  # px of a line of text
INK, DIM, PAPER = (235, 235, 235), (170, 170, 170), (18, 18, 18)  # BGR
SWATCH = 12  # px
Named = tuple[str, tuple[int, ...]]
"""A name and its RGB colour."""
REASONS: Sequence[Named] = [(v.name.lower().replace("_", " "), color) for v, color in VALIDITY_COLORS.items()]
CLASSES: Sequence[Named] = [(kind.name.lower().replace("_", " "), color) for kind, color in CLASS_COLORS.items()]
DIRECTIONS = {"right": (1, 0), "down": (0, 1), "left": (-1, 0), "up": (0, -1), "still": (0, 0)}
LEGEND = "legend"  # the viewer's: an entity beside the run's
VIEWER = (640, 7 * LINE)  # px of the viewer's legend


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


def directions(width: int) -> UInt8:
    """The hues of flow."""
    shown = {name: flow_color(np.full((8, 8, 2), uv, np.float32))[0, 0] for name, uv in DIRECTIONS.items()}
    return swatches([(name, tuple(color.tolist())) for name, color in shown.items()], width)


def viewer_legend() -> UInt8:
    """What the colours of a recording's views mean, (H, W, 3) RGB."""
    width, height = VIEWER
    whole, top, left = np.full((height, width, 3), PAPER, np.uint8), 0, 70
    for name, strip in (
        ("d_M", bar(LOOKS[f"{IMAGE}/residual/d_m"], " sigmas", width - left)),
        ("validity", swatches(REASONS, width - left)),
        ("class", swatches([*CLASSES, ("answer to a query", HIT_COLOR)], width - left)),
        ("arrows", swatches([("where flagged pixels went against the static world", MOVED)], width - left)),
        ("flow", directions(width - left)),
        ("depth", bar(LOOKS[f"{IMAGE}/depth"], " m", width - left)),
    ):
        write(whole, name, 0, top, DIM)
        whole[top : top + len(strip), left:] = strip
        top += len(strip)
    return np.ascontiguousarray(whole[..., ::-1])


def bar(look: Range, unit: str, width: int, absent: str = "") -> UInt8:
    """A colour map from its lowest to its highest number; and the grey of what has none, if that has a name."""
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
    if absent:
        x += text_width(last) + 12
        strip[4 : 4 + SWATCH, x : x + SWATCH] = UNKNOWN
        write(strip, absent, x + SWATCH + 5, 0)
    return strip
