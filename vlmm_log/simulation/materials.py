"""What surfaces look like: two colours, a pattern of them, and grain. Drawn at random within what is usual."""

from __future__ import annotations

import colorsys
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

Pattern = Literal["plain", "stripes", "checks", "print", "wood", "tiles", "clouds"]
PATTERNS: tuple[Pattern, ...] = get_args(Pattern)  # the kernels know them by their place
Colour = tuple[float, float, float]  # 0 to 1


@dataclass(frozen=True)
class Material:
    """Of one piece of a thing; its texture is fixed to the piece, so it moves along."""

    colour: Colour
    second: Colour
    pattern: Pattern = "plain"
    scale: float = 0.1  # m, of the pattern's period
    grain: float = 0.2  # contrast of the noise
    coarse: float = 0.3  # m, longest wave of the noise
    shift: Colour = (0.0, 0.0, 0.0)  # m, where in the noise the piece lies


def hsv(hue: float, saturation: float, value: float) -> Colour:
    """A colour; the hue goes round."""
    return colorsys.hsv_to_rgb(hue % 1.0, saturation, value)


def _place(rng: np.random.Generator) -> Colour:
    x, y, z = rng.uniform(0.0, 20.0, 3)
    return float(x), float(y), float(z)


def plaster(rng: np.random.Generator, hue: float = 0.1) -> Material:
    """A painted wall or ceiling with blotches."""
    u = rng.uniform(-1, 1, 3)
    light = hsv(hue + 0.05 * u[0], 0.18 + 0.08 * u[1], 0.74 + 0.06 * u[2])
    dark = hsv(hue + 0.03, 0.25, 0.6)
    return Material(light, dark, "clouds", 0.22, 0.2, 0.35, _place(rng))


def wallpaper(rng: np.random.Generator, hue: float) -> Material:
    """Stripes under blotches of grain."""
    u = rng.uniform(-1, 1, 2)
    light, dark = hsv(hue + 0.03 * u[0], 0.25, 0.78), hsv(hue + 0.03 * u[1], 0.35, 0.56)
    return Material(light, dark, "stripes", float(rng.uniform(0.16, 0.26)), 0.22, 0.25, _place(rng))


def tiles(rng: np.random.Generator, hue: float, scale: float) -> Material:
    """Square tiles with joints."""
    return Material(hsv(hue, 0.22, 0.72), hsv(hue, 0.3, 0.36), "tiles", scale, 0.24, 0.2, _place(rng))


def wood(rng: np.random.Generator, value: float = 0.55) -> Material:
    """Light or dark wood."""
    u = rng.uniform(-1, 1, 3)
    hue = 0.075 + 0.02 * u[0]
    light, dark = hsv(hue, 0.5 + 0.1 * u[1], value + 0.06 * u[2]), hsv(hue, 0.6, 0.62 * value)
    return Material(light, dark, "wood", float(rng.uniform(0.05, 0.09)), 0.2, 0.15, _place(rng))


def lacquer(rng: np.random.Generator, value: float = 0.75) -> Material:
    """A painted surface of any hue, little saturated."""
    u = rng.uniform(0, 1, 2)
    return Material(hsv(u[0], 0.2, value), hsv(u[0] + 0.1, 0.3, 0.7 * value), "clouds", 0.12, 0.2, 0.15, _place(rng))


def paint(rng: np.random.Generator) -> Material:
    """A vivid colour with a print of another one."""
    u = rng.uniform(0, 1, 4)
    first = hsv(u[0], 0.5 + 0.35 * u[1], 0.55 + 0.35 * u[2])
    second = hsv(u[0] + 0.25 + 0.5 * u[3], 0.5, 0.85 if u[2] < 0.5 else 0.4)
    return Material(first, second, "print", float(rng.uniform(0.03, 0.07)), 0.22, 0.08, _place(rng))


def glaze(rng: np.random.Generator) -> Material:
    """China: light, with rings or dots of a colour."""
    u = rng.uniform(0, 1, 3)
    pattern: Pattern = "stripes" if u[2] < 0.4 else "print"
    return Material(hsv(u[0], 0.12, 0.86), hsv(u[1], 0.65, 0.6), pattern, 0.04, 0.18, 0.06, _place(rng))


def fabric(rng: np.random.Generator) -> Material:
    """Cloth: checks, stripes or a print."""
    u = rng.uniform(0, 1, 3)
    choices: tuple[Pattern, ...] = ("checks", "stripes", "print")
    pattern = choices[int(rng.integers(3))]
    first, second = hsv(u[0], 0.45, 0.4 + 0.35 * u[1]), hsv(u[0] + 0.12 * u[2], 0.4, 0.85 if u[1] < 0.5 else 0.35)
    return Material(first, second, pattern, float(rng.uniform(0.05, 0.11)), 0.25, 0.1, _place(rng))


def metal(rng: np.random.Generator, value: float = 0.62) -> Material:
    """Brushed and spotted."""
    return Material(hsv(0.6, 0.06, value), hsv(0.58, 0.1, 0.65 * value), "clouds", 0.05, 0.22, 0.06, _place(rng))


def plastic(rng: np.random.Generator, value: float = 0.2) -> Material:
    """Dark or light plastic with marks."""
    hue = float(rng.uniform())
    second = 0.75 if value < 0.4 else 0.35
    return Material(hsv(hue, 0.15, value), hsv(hue, 0.2, second * value + 0.12), "clouds", 0.04, 0.3, 0.06, _place(rng))


def plain(rng: np.random.Generator, hue: float, saturation: float, value: float) -> Material:
    """One colour with grain and darker spots of it."""
    first = hsv(hue + 0.02 * float(rng.uniform(-1, 1)), saturation, value)
    return Material(first, hsv(hue, saturation, 0.65 * value), "clouds", 0.03, 0.22, 0.05, _place(rng))


def picture(rng: np.random.Generator) -> Material:
    """A painting, a poster, a view: large blotches of two hues."""
    u = rng.uniform(0, 1, 2)
    return Material(
        hsv(u[0], 0.55, 0.75), hsv(u[0] + 0.3 + 0.3 * u[1], 0.6, 0.45), "print", 0.12, 0.35, 0.12, _place(rng)
    )


def outdoors(rng: np.random.Generator) -> Material:
    """What a window shows: sky and leaves."""
    u = rng.uniform(0, 1, 2)
    return Material(hsv(0.57, 0.3, 0.92), hsv(0.28 + 0.08 * u[0], 0.5, 0.55), "print", 0.16, 0.25, 0.12, _place(rng))


def printed(rng: np.random.Generator) -> Material:
    """Rows of something on paper: a screen, a keyboard, a newspaper."""
    return Material(hsv(0.12, 0.08, 0.86), hsv(0.6, 0.3, 0.28), "checks", 0.025, 0.25, 0.05, _place(rng))
