"""Machines and lamps: what is plugged in, and what is carried in a pocket. Sizes in metres, fronts towards -y."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from vlmm_log.simulation import materials as m
from vlmm_log.simulation.meshes import box, cushion, cylinder, lathe, tube
from vlmm_log.simulation.shapes import Shape, assembled, put, shift, solid, turn

Rng = np.random.Generator


def _scale(rng: Rng) -> float:
    return float(rng.uniform(0.93, 1.07))


def toaster(rng: Rng) -> Shape:
    """With two slots and a lever."""
    body = solid(cushion(0.3, 0.19, 0.21, 0.25), m.metal(rng))
    slots = [solid(box(0.2, 0.022, 0.012), m.plastic(rng, 0.1), 0, y, 0.2) for y in (-0.035, 0.035)]
    return assembled(body, *slots, solid(box(0.03, 0.04, 0.02), m.plastic(rng), 0.15, 0, 0.12))


def microwave(rng: Rng) -> Shape:
    """With a dark window and a panel."""
    w, h = 0.48 * _scale(rng), 0.28
    body = solid(box(w, 0.34, h), m.metal(rng, 0.7))
    window = solid(box(0.62 * w, 0.012, 0.72 * h), m.plastic(rng, 0.15), -0.13 * w, -0.173, 0.14 * h)
    return assembled(body, window, solid(box(0.2 * w, 0.012, 0.8 * h), m.printed(rng), 0.36 * w, -0.173, 0.1 * h))


def coffee_machine(rng: Rng) -> Shape:
    """A column, a head, a jug under it."""
    dark = m.plastic(rng, 0.25)
    column, head = solid(box(0.22, 0.11, 0.36), dark, 0, 0.08, 0), solid(box(0.22, 0.26, 0.1), dark, 0, 0, 0.26)
    jug = solid(lathe([(0, 0), (0.07, 0), (0.075, 0.08), (0.055, 0.14), (0, 0.14)]), m.metal(rng, 0.75), 0, -0.06, 0.03)
    return assembled(column, head, jug, solid(box(0.22, 0.26, 0.03), m.metal(rng)))


def laptop(rng: Rng) -> Shape:
    """Open."""
    lower = solid(box(0.34, 0.24, 0.02), m.metal(rng, 0.55)) + solid(
        box(0.29, 0.12, 0.003), m.printed(rng), 0, 0.03, 0.02
    )
    lid = solid(box(0.34, 0.014, 0.23), m.metal(rng, 0.4)) + solid(
        box(0.31, 0.004, 0.2), m.picture(rng), 0, -0.008, 0.015
    )
    return lower + put(lid, shift(0, 0.12, 0.02) @ turn("x", -0.3))


def television(rng: Rng) -> Shape:
    """A screen on a foot."""
    w, h = 1.05 * _scale(rng), 0.6
    screen = solid(box(w, 0.05, h), m.plastic(rng, 0.15), 0, 0, 0.09)
    shown = solid(box(w - 0.06, 0.006, h - 0.06), m.picture(rng), 0, -0.028, 0.12)
    return assembled(
        screen, shown, solid(box(0.1, 0.06, 0.1), m.plastic(rng)), solid(box(0.45, 0.22, 0.02), m.plastic(rng))
    )


def desk_lamp(rng: Rng) -> Shape:
    """A foot, a bent arm, a shade."""
    colour = m.paint(rng)
    arm = tube([[0, 0, 0.02], [-0.06, 0, 0.2], [-0.04, 0, 0.33], [0.06, 0, 0.42]], 0.011)
    shade = put(
        solid(lathe([(0.03, 0.09), (0.085, 0), (0.08, 0), (0.0, 0.085)]), colour),
        shift(0.09, 0, 0.33) @ turn("y", -0.35),
    )
    return assembled(solid(cylinder(0.09, 0.022), colour), solid(arm, m.metal(rng)), shade)


def floor_lamp(rng: Rng) -> Shape:
    """A pole with a shade."""
    h = 1.55 * _scale(rng)
    shade = solid(lathe([(0.22, h - 0.32), (0.15, h), (0.0, h - 0.01)]), m.fabric(rng))
    return assembled(
        solid(cylinder(0.15, 0.03), m.metal(rng)), solid(cylinder(0.016, h - 0.05, 12), m.metal(rng)), shade
    )


def alarm_clock(rng: Rng) -> Shape:
    """Round, on feet, with two bells."""
    case = put(solid(cylinder(0.075, 0.06), m.paint(rng)), shift(0, 0.03, 0.085) @ turn("x", np.pi / 2))
    face = put(solid(cylinder(0.063, 0.004), m.printed(rng)), shift(0, -0.03, 0.085) @ turn("x", np.pi / 2))
    bells = [solid(cushion(0.06, 0.05, 0.04, 0.9), m.metal(rng), x, 0, 0.15) for x in (-0.042, 0.042)]
    return assembled(
        case, face, *bells, *(solid(box(0.02, 0.05, 0.03), m.metal(rng), x, 0, 0) for x in (-0.045, 0.045))
    )


def remote_control(rng: Rng) -> Shape:
    """Long, with rows of keys."""
    return solid(box(0.065, 0.2, 0.024), m.plastic(rng)) + solid(box(0.05, 0.16, 0.005), m.printed(rng), 0, 0, 0.024)


def cell_phone(rng: Rng) -> Shape:
    """Lying, its screen up."""
    return solid(box(0.085, 0.17, 0.012), m.plastic(rng)) + solid(box(0.076, 0.15, 0.002), m.picture(rng), 0, 0, 0.012)


def vacuum_cleaner(rng: Rng) -> Shape:
    """Upright."""
    stick = tube([[0, 0, 0.12], [0, 0.1, 0.6], [0, 0.16, 1.0], [0, 0.1, 1.08]], 0.017)
    body = put(solid(cushion(0.2, 0.18, 0.5, 0.6), m.paint(rng)), shift(0, 0.04, 0.1) @ turn("x", -0.18))
    return assembled(solid(box(0.32, 0.24, 0.09), m.plastic(rng)), body, solid(stick, m.metal(rng)))


def faucet(rng: Rng) -> Shape:
    """A bent spout over a basin, towards -y."""
    a = np.linspace(np.pi, 0, 9)
    bend = np.stack([0 * a, -0.07 + 0.09 * -np.cos(a) * -1.0, 0.24 + 0.09 * np.sin(a)], -1)
    path = np.concatenate(
        [[[0, 0.02, 0], [0, 0.02, 0.12]], bend[::-1] if bend[0, 1] < bend[-1, 1] else bend, [[0, -0.16, 0.17]]]
    )
    return assembled(
        solid(tube(path, 0.018), m.metal(rng, 0.75)),
        solid(cylinder(0.04, 0.04), m.metal(rng), 0, 0.02, 0),
        solid(tube([[0.03, 0.02, 0.03], [0.1, 0.0, 0.09]], 0.012), m.metal(rng)),
    )


def stove_burner(rng: Rng) -> Shape:
    """A grate on a flat ring."""
    bars = [solid(box(0.2, 0.016, 0.02), m.plastic(rng, 0.15)), solid(box(0.016, 0.2, 0.02), m.plastic(rng, 0.15))]
    return assembled(
        solid(lathe([(0, 0), (0.1, 0), (0.1, 0.012), (0.06, 0.014), (0, 0.014)]), m.metal(rng, 0.4)), *bars
    )


def radio(rng: Rng) -> Shape:
    """A speaker box."""
    return solid(box(0.17, 0.16, 0.26), m.wood(rng, 0.35)) + solid(
        box(0.14, 0.006, 0.22), m.plastic(rng), 0, -0.082, 0.02
    )


MACHINES: dict[str, Callable[[Rng], Shape]] = {
    "toaster": toaster,
    "microwave": microwave,
    "coffee machine": coffee_machine,
    "laptop": laptop,
    "television": television,
    "desk lamp": desk_lamp,
    "floor lamp": floor_lamp,
    "alarm clock": alarm_clock,
    "remote control": remote_control,
    "cell phone": cell_phone,
    "vacuum cleaner": vacuum_cleaner,
    "faucet": faucet,
    "stove burner": stove_burner,
    "speaker": radio,
}
