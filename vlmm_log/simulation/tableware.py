"""What one cooks with, eats from and eats. Each function draws one at random; sizes in metres."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from vlmm_log.simulation import materials as m
from vlmm_log.simulation.meshes import arc, box, cushion, cylinder, lathe, sphere, tube
from vlmm_log.simulation.shapes import Shape, assembled, put, shift, solid, turn

Rng = np.random.Generator


def _scale(rng: Rng, spread: float = 0.1) -> float:
    return float(rng.uniform(1 - spread, 1 + spread))


def vessel(rng: Rng, radius: float, height: float, flare: float) -> Shape:
    """An open vessel, wider (flare > 1) or narrower above."""
    s = _scale(rng)
    r, h, wall = radius * s, height * s, 0.006
    top = r * flare
    return solid(lathe([(0, 0), (r, 0), (top, h), (top - wall, h), (r - wall, wall * 2), (0, wall * 2)]), m.glaze(rng))


def mug(rng: Rng) -> Shape:
    """With a handle."""
    body = vessel(rng, 0.045, 0.11, 1.05)
    handle = arc(0.03, -1.4, 1.4) + np.array([0.046, 0.0, 0.055])
    return body + solid(tube(handle, 0.007), body.pieces[0].material)


def cup(rng: Rng) -> Shape:
    """Conical."""
    return vessel(rng, 0.036, 0.12, 1.35)


def bowl(rng: Rng) -> Shape:
    """Wide and low."""
    return vessel(rng, 0.06, 0.075, 1.7)


def plate(rng: Rng) -> Shape:
    """Flat."""
    return vessel(rng, 0.08, 0.022, 1.6)


def bottle(rng: Rng) -> Shape:
    """With a neck and a label."""
    s = _scale(rng)
    r, h = 0.038 * s, 0.26 * s
    glass = lathe([(0, 0), (r, 0), (r, 0.6 * h), (0.4 * r, 0.78 * h), (0.36 * r, h), (0, h)])
    return solid(glass, m.plain(rng, 0.3 + 0.3 * float(rng.uniform()), 0.6, 0.45)) + solid(
        cylinder(1.02 * r, 0.24 * h), m.glaze(rng), 0, 0, 0.2 * h
    )


def wine_bottle(rng: Rng) -> Shape:
    """Dark, with a label."""
    glass = lathe([(0, 0), (0.04, 0), (0.04, 0.18), (0.015, 0.24), (0.014, 0.31), (0, 0.31)])
    return solid(glass, m.plain(rng, 0.33, 0.5, 0.3)) + solid(cylinder(0.0408, 0.08), m.printed(rng), 0, 0, 0.06)


def soap_bottle(rng: Rng) -> Shape:
    """With a pump."""
    body = cylinder(0.042, 0.15)
    pump = tube([[0, 0, 0.15], [0, 0, 0.2], [0.05, 0, 0.2]], 0.008)
    return solid(body, m.paint(rng)) + solid(pump, m.plastic(rng, 0.7))


def pot(rng: Rng) -> Shape:
    """With two handles and a lid."""
    s = _scale(rng)
    r, h = 0.12 * s, 0.15 * s
    lid = lathe([(r * 1.02, h), (0.6 * r, h + 0.03), (0.12 * r, h + 0.035), (0.15 * r, h + 0.06), (0, h + 0.062)])
    handles = [
        put(
            solid(tube(arc(0.03, -1.4, 1.4), 0.008), m.plastic(rng)),
            shift(0, 0, 0.75 * h) @ turn("z", a) @ shift(r, 0) @ turn("x", 1.57),
        )
        for a in (0.0, np.pi)
    ]
    return assembled(solid(cylinder(r, h), m.metal(rng)), solid(lid, m.metal(rng, 0.5)), *handles)


def pan(rng: Rng) -> Shape:
    """With a long handle."""
    r = 0.13 * _scale(rng)
    dish = lathe([(0, 0), (0.8 * r, 0), (r, 0.045), (0.97 * r, 0.045), (0.78 * r, 0.006), (0, 0.006)])
    return solid(dish, m.metal(rng, 0.38)) + solid(tube([[r, 0, 0.04], [r + 0.17, 0, 0.055]], 0.011), m.plastic(rng))


def kettle(rng: Rng) -> Shape:
    """With spout and handle."""
    s = _scale(rng)
    body = lathe([(0, 0), (0.095 * s, 0), (0.1 * s, 0.05), (0.075 * s, 0.17), (0.03, 0.2), (0.02, 0.225), (0, 0.225)])
    spout = tube([[0.08, 0, 0.07], [0.12, 0, 0.12], [0.15, 0, 0.17]], 0.014)
    handle = tube(arc(0.085, 0.4, 2.74) + np.array([0, 0, 0.15]), 0.01)
    colour = m.paint(rng)
    return assembled(solid(body, colour), solid(spout, colour), solid(handle, m.plastic(rng)))


def vase(rng: Rng) -> Shape:
    """Bulged."""
    r, h = 0.065 * _scale(rng), 0.26 * _scale(rng)
    profile = [
        (0, 0),
        (0.6 * r, 0),
        (r, 0.3 * h),
        (0.85 * r, 0.55 * h),
        (0.42 * r, 0.82 * h),
        (0.6 * r, h),
        (0.5 * r, h),
        (0, 0.85 * h),
    ]
    return solid(lathe(profile), m.glaze(rng))


def fruit(rng: Rng, radius: float, hue: float) -> Shape:
    """A ball with a stalk; its centre is one radius up."""
    r = radius * _scale(rng, 0.06)
    skin = m.Material(m.hsv(hue, 0.75, 0.72), m.hsv(hue + 0.12, 0.7, 0.5), "print", 0.04, 0.25, 0.04)
    return solid(sphere(r, 24), skin)


def apple(rng: Rng) -> Shape:
    """Red or green."""
    return fruit(rng, 0.046, float(rng.choice([0.0, 0.25])))


def tomato(rng: Rng) -> Shape:
    """Red."""
    return fruit(rng, 0.042, 0.01)


def lettuce(rng: Rng) -> Shape:
    """A head."""
    return fruit(rng, 0.085, 0.27)


def potato(rng: Rng) -> Shape:
    """Oblong."""
    return solid(cushion(0.12, 0.08, 0.07, 0.85), m.plain(rng, 0.1, 0.5, 0.62))


def bread(rng: Rng) -> Shape:
    """A loaf."""
    return solid(cushion(0.26 * _scale(rng), 0.12, 0.11, 0.6), m.wood(rng, 0.66))


def paper_roll(rng: Rng) -> Shape:
    """Upright on a stand."""
    roll = solid(cylinder(0.065, 0.25), m.glaze(rng), 0, 0, 0.012)
    return assembled(roll, solid(cylinder(0.08, 0.012), m.wood(rng)), solid(cylinder(0.012, 0.3), m.wood(rng)))


def sponge(rng: Rng) -> Shape:
    """Two layers."""
    return solid(box(0.13, 0.085, 0.035), m.plain(rng, 0.15, 0.75, 0.85)) + solid(
        box(0.13, 0.085, 0.012), m.plain(rng, 0.33, 0.6, 0.4), 0, 0, 0.035
    )


TABLEWARE: dict[str, Callable[[Rng], Shape]] = {
    "mug": mug,
    "cup": cup,
    "bowl": bowl,
    "plate": plate,
    "bottle": bottle,
    "wine bottle": wine_bottle,
    "soap bottle": soap_bottle,
    "pot": pot,
    "pan": pan,
    "kettle": kettle,
    "vase": vase,
    "apple": apple,
    "tomato": tomato,
    "lettuce": lettuce,
    "potato": potato,
    "bread": bread,
    "paper towel roll": paper_roll,
    "dish sponge": sponge,
}
