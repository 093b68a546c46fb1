"""How rigid bodies move: T_world_body at any time, exact and smooth.

Times are seconds from the first frame's stamp; a motion takes (n,) of them and gives (n, 4, 4).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from vlmm_log import se3
from vlmm_log.types import Float64

ROUND = 0.985  # how sharp a course turns: 1 at once
RAMP_S = 0.12  # a start or stop takes


class Motion(Protocol):
    """Where a body is."""

    def __call__(self, t: Float64) -> Float64:
        """``T_world_body`` (n, 4, 4) at times (n,)."""
        ...


@dataclass(frozen=True)
class Course:
    """To and fro between 0 and ``span`` at a steady rate but for the turns, from ``start`` to ``stop``."""

    span: float  # m or rad
    rate: float  # m/s or rad/s
    phase: float = 0.0  # of a way there and back, 0 to 2
    start: float = -1e9  # s
    stop: float = 1e9  # s

    def __call__(self, t: Float64) -> Float64:
        """(n,) m or rad."""
        elapsed = _soft(t - self.start) - _soft(t - self.stop) + (self.start if self.start > -1e8 else 0.0)
        if self.start <= -1e8:
            elapsed = t - _soft(t - self.stop)
        x = self.phase + elapsed * self.rate / self.span
        rounded = np.arccos(ROUND * np.cos(np.pi * x))
        edge = np.arccos(ROUND)
        return np.asarray(self.span * (rounded - edge) / (np.pi - 2 * edge))


def _soft(x: Float64) -> Float64:
    """``max(x, 0)`` with a round corner."""
    return np.asarray(np.where(x > RAMP_S, x - RAMP_S / 2, np.clip(x, 0.0, RAMP_S) ** 2 / (2 * RAMP_S)))


@dataclass(frozen=True, eq=False)
class Hinge:
    """Turns about its own z axis."""

    T_world_hinge: Float64  # (4, 4) of the closed leaf
    angle: Course  # rad
    sign: float = 1.0

    def __call__(self, t: Float64) -> Float64:
        """See Motion."""
        return np.asarray(self.T_world_hinge @ se3.exp(_twists(t, 2, self.sign * self.angle(t))))


@dataclass(frozen=True, eq=False)
class Slide:
    """Shifts along a direction of its own frame: a drawer, a thing on a table, or lifted straight up."""

    T_world_start: Float64
    direction: Float64  # (3,) unit, in the body's frame
    way: Course  # m
    spin: float = 0.0  # rad/m about z

    def __call__(self, t: Float64) -> Float64:
        """See Motion."""
        s = self.way(t)
        T = se3.exp(_twists(t, 2, self.spin * s))
        T[:, :3, 3] = s[:, None] * self.direction
        return np.asarray(self.T_world_start @ T)


@dataclass(frozen=True, eq=False)
class Roll:
    """A ball that rolls along x of its frame without slipping; the body's origin is its centre."""

    T_world_start: Float64
    radius: float  # m
    way: Course  # m

    def __call__(self, t: Float64) -> Float64:
        """See Motion."""
        s = self.way(t)
        T = se3.exp(_twists(t, 1, s / self.radius))
        T[:, 0, 3] = s
        return np.asarray(self.T_world_start @ T)


@dataclass(frozen=True, eq=False)
class Walk:
    """Round an ellipse on the floor, looking ahead; the body's frame is the walker's, x ahead, z up."""

    centre: Float64  # (2,) m
    radii: tuple[float, float]  # m along x and y
    turn_rate: float  # rad/s of the ellipse's parameter
    phase: float  # rad

    def __call__(self, t: Float64) -> Float64:
        """See Motion."""
        a = self.phase + self.turn_rate * t
        dx, dy = -self.radii[0] * np.sin(a) * self.turn_rate, self.radii[1] * np.cos(a) * self.turn_rate
        T = se3.exp(_twists(t, 2, np.arctan2(dy, dx)))
        T[:, 0, 3] = self.centre[0] + self.radii[0] * np.cos(a)
        T[:, 1, 3] = self.centre[1] + self.radii[1] * np.sin(a)
        return T


@dataclass(frozen=True, eq=False)
class Swing:
    """A limb that swings about y of its parent at a joint: ``middle + amplitude sin(rate t + phase)``."""

    parent: Motion
    joint: Float64  # (3,) m in the parent's frame
    amplitude: float  # rad
    rate: float  # rad/s
    phase: float  # rad
    middle: float = 0.0  # rad

    def __call__(self, t: Float64) -> Float64:
        """See Motion."""
        T = se3.exp(_twists(t, 1, self.middle + self.amplitude * np.sin(self.rate * t + self.phase)))
        T[:, :3, 3] = self.joint
        return np.asarray(self.parent(t) @ T)


def _twists(t: Float64, axis: int, angles: Float64) -> Float64:
    twists = np.zeros((len(t), 6))
    twists[:, axis] = angles
    return twists
