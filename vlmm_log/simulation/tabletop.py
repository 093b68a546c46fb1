"""What moves on a table, each in its lane, and what stands still beside it."""

from __future__ import annotations

import numpy as np

from vlmm_log.simulation.household import ball
from vlmm_log.simulation.layout import Surface, footprint, standing
from vlmm_log.simulation.movers import ALONG, course, lifted, rolled, slid
from vlmm_log.simulation.shapes import Shape, put, shift
from vlmm_log.simulation.things import Thing

LIFT_M, LIFT_RATE = 0.28, 0.25  # m, m/s


def pushed(
    surface: Surface,
    name: str,
    shape: Shape,
    y: float,
    span: float,
    rate: float,
    rng: np.random.Generator,
    duration_s: float,
) -> Thing:
    """Slides along x on the surface, at a given y m; the lane is claimed."""
    half_x, half_y = footprint(shape, 0.0)
    x = _lane(surface, half_x, half_y, y, span, rng)
    T = standing(x - span / 2, y, surface.z - float(shape.bounds[0, 2]))
    return slid(name, shape, T, ALONG, course(rng, span, rate, duration_s))


def rolling(
    surface: Surface,
    name: str,
    shape: Shape,
    y: float,
    span: float,
    rate: float,
    rng: np.random.Generator,
    duration_s: float,
) -> Thing:
    """Rolls along x; the shape is a ball that stands on its origin or about it."""
    radius = float(shape.size[2]) / 2
    centred = put(shape, shift(0, 0, -float(shape.bounds.mean(0)[2])))
    x = _lane(surface, radius, radius, y, span, rng)
    T = standing(x - span / 2, y, surface.z + radius)
    return rolled(name, centred, T, radius, course(rng, span, rate, duration_s))


def raised(surface: Surface, name: str, shape: Shape, rng: np.random.Generator, duration_s: float) -> Thing:
    """Lifted off the surface and put down again; room to turn is claimed."""
    half = max(footprint(shape, a)[k] for a in (0.0, 0.4, 0.8) for k in (0, 1))
    at = surface.claim(half, half, None, rng, (0.3, 0.9))
    assert at is not None, "the surface is too small for what moves on it"
    T = standing(at[0], at[1], surface.z - float(shape.bounds[0, 2]), float(rng.uniform(-0.3, 0.3)))
    return lifted(name, shape, T, course(rng, LIFT_M, LIFT_RATE, duration_s))


def basketball(rng: np.random.Generator) -> Shape:
    """About its origin."""
    return ball(rng, 0.12)


def _lane(surface: Surface, half_x: float, half_y: float, y: float, span: float, rng: np.random.Generator) -> float:
    """The middle x of a free lane at y."""
    for _ in range(200):
        room = surface.width / 2 - half_x - span / 2
        x = surface.centre[0] + float(rng.uniform(-1, 1)) * max(room, 0.0)
        if surface.claim(half_x + span / 2, half_y, (x, y), rng) is not None:
            return x
    raise AssertionError("the surface is too small for what moves on it")
