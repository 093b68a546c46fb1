"""Things that move, made of a shape, a place and a course."""

from __future__ import annotations

import numpy as np

from vlmm_log.simulation.motions import Course, Hinge, Roll, Slide
from vlmm_log.simulation.shapes import Shape
from vlmm_log.simulation.things import Body, Thing
from vlmm_log.types import Float64

UP = np.array([0.0, 0.0, 1.0])
FORWARD = np.array([0.0, -1.0, 0.0])  # the way fronts look
ALONG = np.array([1.0, 0.0, 0.0])


def course(rng: np.random.Generator, span: float, rate: float, duration_s: float) -> Course:
    """To and fro; one in three starts late, one in three stops early, all move more than 60 % of the time."""
    start, stop = -1e9, 1e9
    match int(rng.integers(3)):
        case 1:
            start = float(rng.uniform(0.1, 0.3)) * duration_s
        case 2:
            stop = float(rng.uniform(0.7, 0.9)) * duration_s
    return Course(span, rate * float(rng.uniform(0.9, 1.1)), float(rng.uniform(0.05, 0.5)), start, stop)


def hinged(name: str, leaf: Shape, T_world_hinge: Float64, angle: Course, sign: float) -> Thing:
    """A leaf that hangs on its z axis; its way is its free edge's."""
    motion = Hinge(T_world_hinge, angle, sign)
    low, high = leaf.bounds
    edge = high[0] if high[0] > -low[0] else low[0]
    return Thing(name, (Body(leaf, np.eye(4), motion),), "hinge", (float(edge), 0.0, float(high[2] / 2)))


def slid(name: str, shape: Shape, T: Float64, direction: Float64, way: Course) -> Thing:
    """A thing that is pushed to and fro, a drawer that is pulled."""
    return Thing(name, (Body(shape, np.eye(4), Slide(T, direction, way)),), "slide", _centre(shape))


def lifted(name: str, shape: Shape, T: Float64, way: Course) -> Thing:
    """A thing that is lifted, turned a little meanwhile, and put down."""
    return Thing(name, (Body(shape, np.eye(4), Slide(T, UP, way, 1.5)),), "lift", _centre(shape))


def rolled(name: str, ball: Shape, T: Float64, radius: float, way: Course) -> Thing:
    """A ball whose centre is the origin of its shape."""
    return Thing(name, (Body(ball, np.eye(4), Roll(T, radius, way)),), "roll")


def _centre(shape: Shape) -> tuple[float, float, float]:
    x, y, z = shape.bounds.mean(0)
    return float(x), float(y), float(z)
