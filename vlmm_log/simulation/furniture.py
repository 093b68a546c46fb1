"""Furniture. Sizes in metres; a piece stands about the origin, its front towards -y."""

from __future__ import annotations

import numpy as np

from vlmm_log.simulation import materials as m
from vlmm_log.simulation.materials import Material
from vlmm_log.simulation.meshes import box, cushion, cylinder
from vlmm_log.simulation.shapes import Shape, assembled, solid

Rng = np.random.Generator


def table(width: float, depth: float, height: float, material: Material, top: float = 0.035) -> Shape:
    """A top on four legs."""
    legs = [
        solid(box(0.055, 0.055, height - top), material, x, y, 0)
        for x in (-width / 2 + 0.05, width / 2 - 0.05)
        for y in (-depth / 2 + 0.05, depth / 2 - 0.05)
    ]
    return assembled(solid(box(width, depth, top), material, 0, 0, height - top), *legs)


def chair(rng: Rng) -> Shape:
    """With a back of two rails; it faces -y."""
    timber, seat = m.wood(rng), m.fabric(rng)
    w, d, h = 0.42, 0.42, 0.45
    legs = [solid(box(0.04, 0.04, h), timber, x, y, 0) for x in (-0.19, 0.19) for y in (-0.19, 0.19)]
    posts = [solid(box(0.04, 0.04, 0.5), timber, x, 0.19, h) for x in (-0.19, 0.19)]
    rails = [solid(box(w, 0.025, 0.1), timber, 0, 0.19, z) for z in (h + 0.18, h + 0.38)]
    return assembled(*legs, *posts, *rails, solid(box(w, d, 0.05), seat, 0, 0, h))


def stool(rng: Rng) -> Shape:
    """Round."""
    timber = m.wood(rng)
    legs = [
        solid(cylinder(0.02, 0.45, 12), timber, 0.13 * np.cos(a), 0.13 * np.sin(a), 0) for a in (0.8, 2.4, 3.9, 5.5)
    ]
    return assembled(solid(cylinder(0.18, 0.05), m.fabric(rng), 0, 0, 0.45), *legs)


def sofa(rng: Rng, width: float) -> Shape:
    """Two or three seats between arms."""
    cover = m.fabric(rng)
    d, seats = 0.85, max(1, round((width - 0.36) / 0.65))
    seat = (width - 0.36) / seats
    middles = [-(width - 0.36) / 2 + seat * (k + 0.5) for k in range(seats)]
    pads = [solid(cushion(seat, 0.66, 0.2, 0.25), cover, x, -0.08, 0.26) for x in middles]
    backs = [solid(cushion(seat, 0.24, 0.5, 0.3), cover, x, 0.28, 0.38) for x in middles]
    arms = [solid(box(0.18, d, 0.6), cover, s * (width / 2 - 0.09), 0, 0) for s in (-1, 1)]
    return assembled(solid(box(width - 0.36, d, 0.3), cover), *pads, *backs, *arms)


def ottoman(rng: Rng) -> Shape:
    """A padded cube."""
    return solid(cushion(0.5, 0.5, 0.4, 0.2), m.fabric(rng))


def bed(rng: Rng, width: float, length: float) -> Shape:
    """The head towards +y, under a blanket that leaves the pillows' place free."""
    timber = m.wood(rng, 0.4)
    frame = solid(box(width, length, 0.28), timber)
    mattress = solid(box(width - 0.06, length - 0.06, 0.2), m.glaze(rng), 0, 0, 0.28)
    blanket = solid(box(width + 0.02, 0.68 * length, 0.05), m.fabric(rng), 0, -0.16 * length, 0.465)
    return assembled(frame, mattress, blanket, solid(box(width + 0.06, 0.06, 0.95), timber, 0, length / 2, 0))


def shelves(width: float, depth: float, height: float, boards: int, material: Material, rear: Material) -> Shape:
    """An open case; its boards lie at even heights, the lowest at 0.04."""
    sides = [solid(box(0.025, depth, height), material, s * (width / 2 - 0.0125), 0, 0) for s in (-1, 1)]
    levels = board_heights(height, boards)
    laid = [solid(box(width - 0.05, depth, 0.025), material, 0, 0, z - 0.025) for z in [*levels, height]]
    return assembled(*sides, *laid, solid(box(width, 0.012, height), rear, 0, depth / 2 - 0.006, 0))


def board_heights(height: float, boards: int) -> list[float]:
    """Upper faces of the boards, m; the top not among them."""
    return [0.04 + k * (height - 0.04) / boards for k in range(boards)]


def carcass(width: float, depth: float, height: float, material: Material, boards: tuple[float, ...] = (0.5,)) -> Shape:
    """A box that is open in front: what a door or a drawer leaves; ``boards`` at shares of its height."""
    walls = [solid(box(0.02, depth, height), material, s * (width / 2 - 0.01), 0, 0) for s in (-1, 1)]
    lids = [solid(box(width, depth, 0.02), material, 0, 0, z) for z in (0.0, height - 0.02)]
    laid = [solid(box(width, depth - 0.02, 0.015), material, 0, 0.01, share * height) for share in boards]
    return assembled(*walls, *lids, *laid, solid(box(width, 0.015, height), material, 0, depth / 2 - 0.0075, 0))


def front(width: float, height: float, material: Material, handle: Material) -> Shape:
    """The closed front of a cabinet or a drawer: its back at y = 0, a bar to pull at."""
    wide = width > height
    bar = box(0.4 * width, 0.025, 0.02) if wide else box(0.02, 0.025, 0.3 * height)
    at = (0.0, -0.032, 0.5 * height) if wide else (0.38 * width, -0.032, 0.35 * height)
    return solid(box(width, 0.02, height), material, 0, -0.01, 0) + solid(bar, handle, *at)


def drawer(width: float, depth: float, height: float, material: Material, handle: Material) -> Shape:
    """A tray behind a front; the front's back at y = 0, the tray towards +y."""
    w, h = width - 0.05, 0.6 * height
    sides = [solid(box(0.014, depth, h), material, s * (w / 2 - 0.007), depth / 2, 0.04) for s in (-1, 1)]
    end = solid(box(w, 0.014, h), material, 0, depth - 0.007, 0.04)
    return assembled(
        front(width, height, material, handle), *sides, end, solid(box(w, depth, 0.012), material, 0, depth / 2, 0.03)
    )


def leaf(width: float, height: float, material: Material, handle: Material) -> Shape:
    """A door's leaf, or a cabinet's: it hangs at x = 0 on z, reaches to x = ``width``, faces -y."""
    panels = [
        solid(box(0.7 * width, 0.052, 0.36 * height), material, width / 2, 0, z) for z in (0.07 * height, 0.53 * height)
    ]
    knob = solid(box(0.09, 0.12, 0.025), handle, width - 0.08, 0, 0.48 * height)
    return assembled(solid(box(width, 0.04, height), material, width / 2, 0, 0), *panels, knob)
