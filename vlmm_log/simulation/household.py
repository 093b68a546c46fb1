"""What lies and stands about. Each function draws one at random; sizes in metres."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from vlmm_log.simulation import materials as m
from vlmm_log.simulation.meshes import Mesh, box, cushion, cylinder, lathe, moved, sphere, tube
from vlmm_log.simulation.shapes import Shape, assembled, put, shift, solid, turn
from vlmm_log.simulation.tableware import TABLEWARE

Rng = np.random.Generator


def _scale(rng: Rng, spread: float = 0.1) -> float:
    return float(rng.uniform(1 - spread, 1 + spread))


def book(rng: Rng) -> Shape:
    """Lying; pages between covers."""
    w, d, h = 0.16 * _scale(rng), 0.23 * _scale(rng), 0.035 * _scale(rng, 0.3)
    cover = m.paint(rng)
    pages = solid(box(w - 0.008, d - 0.012, h - 0.008), m.printed(rng), 0.004, 0, 0.004)
    covers = [solid(box(w, d, 0.004), cover, 0, 0, z) for z in (0.0, h - 0.004)]
    return assembled(pages, *covers, solid(box(0.004, d, h), cover, -w / 2 + 0.002, 0, 0))


def carton(rng: Rng) -> Shape:
    """A box of paper."""
    w, d, h = (float(x) for x in rng.uniform(0.85, 1.15, 3) * (0.22, 0.17, 0.15))
    return solid(box(w, d, h), m.paint(rng)) + solid(box(w + 0.002, 0.04, h + 0.002), m.plain(rng, 0.1, 0.4, 0.75))


def tissue_box(rng: Rng) -> Shape:
    """With a tissue that looks out."""
    return solid(box(0.22, 0.12, 0.085), m.fabric(rng)) + solid(
        cushion(0.09, 0.05, 0.06, 0.9), m.plain(rng, 0.6, 0.04, 0.9), 0, 0, 0.06
    )


def candle(rng: Rng) -> Shape:
    """On a saucer."""
    return solid(cylinder(0.038, 0.13 * _scale(rng)), m.paint(rng)) + solid(cylinder(0.06, 0.012), m.metal(rng))


def statue(rng: Rng) -> Shape:
    """A figure on a plinth."""
    profile = [
        (0, 0.04),
        (0.05, 0.04),
        (0.035, 0.13),
        (0.055, 0.2),
        (0.02, 0.25),
        (0.035, 0.29),
        (0.02, 0.325),
        (0, 0.33),
    ]
    return solid(lathe(profile), m.metal(rng, 0.5)) + solid(box(0.13, 0.13, 0.04), m.wood(rng, 0.35))


def pillow(rng: Rng) -> Shape:
    """Soft."""
    return solid(cushion(0.45 * _scale(rng), 0.34, 0.15), m.fabric(rng))


def teddy_bear(rng: Rng) -> Shape:
    """Sitting."""
    fur = m.plain(rng, 0.07, 0.55, 0.55)
    balls = [(0.085, 0.0, 0.0, 0.0), (0.065, 0.0, -0.01, 0.14)]
    balls += [(0.026, s * 0.05, 0.0, 0.235) for s in (-1, 1)] + [(0.036, s * 0.085, -0.05, 0.08) for s in (-1, 1)]
    balls += [(0.042, s * 0.06, -0.1, 0.0) for s in (-1, 1)]
    body = assembled(*(solid(sphere(r, 20), fur, x, y, z) for r, x, y, z in balls))
    return body + solid(sphere(0.028, 16), m.plain(rng, 0.1, 0.3, 0.8), 0, -0.065, 0.165)


def ball(rng: Rng, radius: float) -> Shape:
    """Its centre is the origin."""
    r = radius * _scale(rng, 0.05)
    skin = m.Material(m.hsv(0.06, 0.8, 0.75), m.hsv(float(rng.uniform()), 0.5, 0.25), "stripes", 0.09, 0.25, 0.06)
    return solid(sphere(r, 40), skin, 0, 0, -r)


def dumbbell(rng: Rng) -> Shape:
    """Lying."""
    ends = [solid(put_on_side(cylinder(0.065, 0.07), x), m.plastic(rng, 0.25)) for x in (-0.14, 0.07)]
    return assembled(*ends, solid(tube([[-0.08, 0, 0.065], [0.08, 0, 0.065]], 0.017), m.metal(rng)))


def put_on_side(mesh: Mesh, x: float) -> Mesh:
    """A round solid with its axis along x, on the floor."""
    radius = float(mesh.vertices[:, 0].max())
    return moved(mesh, shift(x, 0, radius) @ turn("y", np.pi / 2))


def boots(rng: Rng) -> Shape:
    """A pair."""
    leather = m.wood(rng, 0.4)
    one = solid(cushion(0.1, 0.28, 0.11, 0.7), leather, 0, 0, 0) + solid(cylinder(0.055, 0.26), leather, 0, 0.07, 0.04)
    return put(one, shift(-0.07, 0)) + put(one, shift(0.07, 0.02))


def cloth(rng: Rng) -> Shape:
    """Crumpled, lying."""
    return solid(cushion(0.34, 0.24, 0.07, 0.8), m.fabric(rng)) + solid(
        cushion(0.2, 0.26, 0.1, 0.8), m.fabric(rng), 0.04, 0.02, 0.0
    )


def plant(rng: Rng, height: float) -> Shape:
    """In a pot: leaves on stems."""
    pot_r = 0.19 * height
    parts = [solid(lathe([(0, 0), (0.75 * pot_r, 0), (pot_r, 0.3 * height), (0, 0.3 * height)]), m.glaze(rng))]
    green = m.plain(rng, 0.3, 0.6, 0.5)
    for k in range(11):
        a, up = k * 2.4 + float(rng.uniform(-0.3, 0.3)), float(rng.uniform(0.5, 0.9)) * height
        reach = 0.28 * height * float(rng.uniform(0.5, 1.0))
        tip = np.array([reach * np.cos(a), reach * np.sin(a), up])
        root = np.array([0, 0, 0.28 * height])
        parts.append(solid(tube([root, (root + tip) / 2 + (0, 0, 0.05), tip], 0.006, 6), green))
        leaf = solid(cushion(0.26 * height, 0.13 * height, 0.03, 0.9), green)
        parts.append(put(leaf, shift(*tip) @ turn("z", a) @ turn("y", 0.5)))
    return assembled(*parts)


def garbage_can(rng: Rng) -> Shape:
    """Conical, dark inside."""
    r, h = 0.14 * _scale(rng), 0.36 * _scale(rng)
    return solid(
        lathe([(0, 0), (0.8 * r, 0), (r, h), (0.96 * r, h), (0.76 * r, 0.02), (0, 0.02)]), m.plastic(rng, 0.45)
    )


def hamper(rng: Rng) -> Shape:
    """A basket with cloth in it."""
    weave = m.Material(m.hsv(0.1, 0.4, 0.65), m.hsv(0.08, 0.5, 0.4), "checks", 0.05, 0.2, 0.08)
    return solid(lathe([(0, 0), (0.19, 0), (0.22, 0.48), (0.21, 0.48), (0.18, 0.02), (0, 0.02)]), weave) + solid(
        cushion(0.36, 0.36, 0.2, 0.9), m.fabric(rng), 0, 0, 0.37
    )


def toy_car(rng: Rng) -> Shape:
    """With four wheels; drives along x."""
    colour = m.paint(rng)
    wheels = [
        put(solid(cylinder(0.022, 0.016, 16), m.plastic(rng)), shift(x, y, 0.022) @ turn("x", np.pi / 2))
        for x in (-0.05, 0.05)
        for y in (-0.03, 0.046)
    ]
    return assembled(
        solid(box(0.17, 0.075, 0.04), colour, 0, 0, 0.018),
        solid(box(0.09, 0.065, 0.035), m.plastic(rng, 0.6), -0.01, 0, 0.058),
        *wheels,
    )


SMALL: dict[str, Callable[[Rng], Shape]] = {
    "book": book,
    "box": carton,
    "tissue box": tissue_box,
    "candle": candle,
    "statue": statue,
    "pillow": pillow,
    "teddy bear": teddy_bear,
    "dumbbell": dumbbell,
    "boots": boots,
    "cloth": cloth,
    "garbage can": garbage_can,
    "laundry hamper": hamper,
    "toy car": toy_car,
} | TABLEWARE
