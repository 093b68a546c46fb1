"""The room itself: floor, walls, and what hangs on them. Sizes in metres; what hangs faces -y, its back at y = 0."""

from __future__ import annotations

import numpy as np

from vlmm_log.simulation import materials as m
from vlmm_log.simulation.materials import Material
from vlmm_log.simulation.meshes import Mesh, box, cylinder, joined, moved, sheet
from vlmm_log.simulation.shapes import Shape, assembled, put, shift, solid, turn
from vlmm_log.simulation.things import Body, Thing
from vlmm_log.types import Float64

Rng = np.random.Generator
THICK = 0.1


def shell(width: float, front: float, back: float, height: float, looks: dict[str, Material]) -> list[Thing]:
    """Floor, ceiling and four walls; x is centred, y from ``front`` to ``back``; looks of floor, wall, ceiling."""
    middle, depth = (front + back) / 2, back - front
    slab = box(width + 2 * THICK, depth + 2 * THICK, THICK)
    things = [
        still("floor", solid(slab, looks["floor"]), shift(0, middle, -THICK)),
        still("ceiling", solid(slab, looks["ceiling"]), shift(0, middle, height)),
    ]
    long, short = box(THICK, depth, height), box(width + 2 * THICK, THICK, height)
    for mesh, x, y in [
        (short, 0.0, back + THICK / 2),
        (long, -(width + THICK) / 2, middle),
        (long, (width + THICK) / 2, middle),
        (short, 0.0, front - THICK / 2),
    ]:
        things.append(still("wall", solid(mesh, looks["wall"]), shift(x, y)))
    return things


def still(name: str, shape: Shape, T: Float64) -> Thing:
    """A thing that stays."""
    return Thing(name, (Body(shape, T),))


def window(rng: Rng, width: float, height: float) -> Shape:
    """Panes in a frame with a cross."""
    frame = m.lacquer(rng, 0.85)
    bars = [solid(box(width, 0.06, 0.06), frame, 0, -0.03, z) for z in (0.0, height / 2 - 0.03, height - 0.06)] + [
        solid(box(0.06, 0.06, height), frame, x, -0.03, 0) for x in (-width / 2 + 0.03, 0.0, width / 2 - 0.03)
    ]
    return assembled(solid(box(width, 0.02, height), m.outdoors(rng), 0, -0.012, 0), *bars)


def picture(rng: Rng, width: float, height: float) -> Shape:
    """Framed."""
    inner = solid(box(width - 0.07, 0.006, height - 0.07), m.picture(rng), 0, -0.031, 0.035)
    return solid(box(width, 0.03, height), m.wood(rng, 0.35), 0, -0.015, 0) + inner


def poster(rng: Rng, width: float, height: float) -> Shape:
    """Bare paper."""
    return solid(box(width, 0.006, height), m.picture(rng), 0, -0.004, 0)


def mirror(rng: Rng, width: float, height: float) -> Shape:
    """Its glass shows blotches, as if blind."""
    glass = m.Material(m.hsv(0.55, 0.08, 0.8), m.hsv(0.6, 0.12, 0.62), "print", 0.2, 0.18, 0.15)
    return solid(box(width, 0.03, height), m.wood(rng, 0.4), 0, -0.015, 0) + solid(
        box(width - 0.08, 0.006, height - 0.08), glass, 0, -0.031, 0.04
    )


def curtain(rng: Rng, width: float, height: float) -> Shape:
    """One wing, folded."""
    return solid(sheet(width, height, 0.035, max(2.0, width / 0.13)), m.fabric(rng), 0, -0.08, 0)


def blinds(rng: Rng, width: float, height: float) -> Shape:
    """Slats."""
    slats = [_slat(width, z) for z in np.arange(0.0, height, 0.055)]
    return solid(joined(*slats), m.lacquer(rng, 0.8), 0, -0.07, 0)


def _slat(width: float, z: float) -> Mesh:
    return moved(box(width, 0.05, 0.006), shift(0, 0, z) @ turn("x", 0.6))


def light_switch(rng: Rng) -> Shape:
    """A plate with two keys."""
    return solid(box(0.16, 0.015, 0.11), m.lacquer(rng, 0.85), 0, -0.0075, 0) + solid(
        box(0.13, 0.012, 0.075), m.plastic(rng), 0, -0.018, 0.017
    )


def board(width: float, depth: float, material: Material) -> Shape:
    """A shelf on the wall: its upper face at z = 0."""
    brackets = [solid(box(0.03, depth - 0.03, 0.03), material, x, -depth / 2, -0.06) for x in (-width / 3, width / 3)]
    return assembled(solid(box(width, depth, 0.03), material, 0, -depth / 2, -0.03), *brackets)


def door_frame(width: float, height: float, material: Material) -> Shape:
    """Round a leaf that hangs at x = 0 and reaches to ``width``; its opening shows a dim room behind."""
    sides = [solid(box(0.09, 0.1, height + 0.09), material, x, 0, 0) for x in (-0.05, width + 0.05)]
    return assembled(solid(box(width, 0.1, 0.09), material, width / 2, 0, height + 0.01), *sides)


def wall_clock(rng: Rng) -> Shape:
    """Round."""
    rim = put(solid(cylinder(0.16, 0.04), m.paint(rng)), turn("x", np.pi / 2))
    face = put(solid(cylinder(0.135, 0.006), m.printed(rng)), shift(0, -0.038) @ turn("x", np.pi / 2))
    return put(rim + face, shift(0, 0, 0.16))
