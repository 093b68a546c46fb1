"""Where things stand: without touching one another, low ones before high ones, lanes left free for what moves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from vlmm_log.simulation.shapes import Shape, shift, turn
from vlmm_log.simulation.things import Body, Thing
from vlmm_log.types import Float64

GAP_M = 0.015
TRIES = 400
TURN_RAD = 0.35


@dataclass
class Surface:
    """A rectangle to put things on; what stands there is kept, so that nothing is put into it."""

    centre: tuple[float, float]  # m
    width: float  # m along x
    depth: float  # m along y
    z: float  # m
    taken: list[tuple[float, float, float, float]] = field(default_factory=list)  # x0, y0, x1, y1 m

    def claim(
        self,
        half_x: float,
        half_y: float,
        where: tuple[float, float] | None,
        rng: np.random.Generator,
        back: tuple[float, float] = (0.0, 1.0),
    ) -> tuple[float, float] | None:
        """The middle of a free rectangle, at a place or by chance within a share of the depth; None: there is none."""
        room_x, room_y = self.width / 2 - half_x, self.depth / 2 - half_y
        if room_x < 0 or room_y < 0:
            return None
        for _ in range(1 if where else TRIES):
            x = where[0] if where else self.centre[0] + float(rng.uniform(-room_x, room_x))
            share = float(rng.uniform(*back))
            y = where[1] if where else self.centre[1] + (2 * share - 1) * room_y
            spot = (x - half_x, y - half_y, x + half_x, y + half_y)
            if all(_apart(spot, other) for other in self.taken):
                self.taken.append(spot)
                return x, y
        return None


def _apart(a: tuple[float, float, float, float], b: tuple[float, float, float, float]) -> bool:
    return a[2] + GAP_M < b[0] or b[2] + GAP_M < a[0] or a[3] + GAP_M < b[1] or b[3] + GAP_M < a[1]


def footprint(shape: Shape, yaw: float) -> tuple[float, float]:
    """Half sizes m along x and y of a shape turned about its origin, about which it is centred then."""
    low, high = shape.bounds
    corners = np.array([[x, y] for x in (low[0], high[0]) for y in (low[1], high[1])])
    c, s = np.cos(yaw), np.sin(yaw)
    turned = np.abs(corners @ np.array([[c, s], [-s, c]]))
    return float(turned[:, 0].max()), float(turned[:, 1].max())


def spread(
    surface: Surface,
    names: Sequence[str],
    draw: dict[str, Callable[[np.random.Generator], Shape]],
    rng: np.random.Generator,
) -> list[Thing]:
    """Things of these names on a surface, as many as find a place: the largest first, high ones behind low ones."""
    shapes = [(name, draw[name](rng)) for name in names]
    order = sorted(range(len(shapes)), key=lambda k: -float(np.prod(shapes[k][1].size[:2])))
    heights = sorted(float(shape.size[2]) for _, shape in shapes)
    things = []
    for k in order:
        name, shape = shapes[k]
        yaw = float(rng.uniform(-TURN_RAD, TURN_RAD))
        rank = heights.index(float(shape.size[2])) / max(len(heights) - 1, 1)
        back = (0.75 * rank, 0.25 + 0.75 * rank) if len(names) > 2 else (0.0, 1.0)
        at = surface.claim(*footprint(shape, yaw), None, rng, back) or surface.claim(*footprint(shape, yaw), None, rng)
        if at is not None:
            things.append(Thing(name, (Body(shape, standing(at[0], at[1], surface.z - shape.bounds[0, 2], yaw)),)))
    return things


def standing(x: float, y: float, z: float = 0.0, yaw: float = 0.0) -> Float64:
    """``T_world_thing`` (4, 4) of what stands upright."""
    return shift(x, y, z) @ turn("z", yaw)
