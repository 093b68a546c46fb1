"""The nouns of a scene: bodies that are rigid, things that have a name, and the camera's path."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vlmm_log import se3
from vlmm_log.simulation.motions import Motion
from vlmm_log.simulation.shapes import Shape
from vlmm_log.types import Float64


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid shape, still at its pose or moving."""

    shape: Shape
    T_world_body: Float64  # (4, 4); where it is still
    motion: Motion | None = None


@dataclass(frozen=True, eq=False)
class Thing:
    """One instance of the truth."""

    name: str  # as in movability.csv
    bodies: tuple[Body, ...]
    kind: str = "still"  # hinge, slide, roll, lift, walk
    mark: tuple[float, float, float] = (0.0, 0.0, 0.0)  # m in the first body's frame: what its way is measured at


@dataclass(frozen=True)
class Wave:
    """A sum of two sines: the sway of a hand and its tremor."""

    amplitudes: tuple[float, float]
    rates: tuple[float, float]  # Hz
    phases: tuple[float, float]  # rad

    def __call__(self, t: Float64) -> Float64:
        """(n,) at times (n,) s."""
        parts = zip(self.amplitudes, self.rates, self.phases, strict=True)
        return np.asarray(sum(a * np.sin(2 * np.pi * f * t + p) for a, f, p in parts), np.float64)


@dataclass(frozen=True)
class HandHeld:
    """A camera that sways about a place."""

    place: tuple[float, float, float]  # m
    pitch: float  # rad, of the view below the horizon
    sway: tuple[Wave, ...]  # x, y, z m; yaw, pitch, roll rad

    def __call__(self, t: Float64) -> Float64:
        """``T_world_cam`` (n, 4, 4) at times (n,) s; it looks along +y of the world."""
        x, y, z, yaw, pitch, roll = (wave(t) for wave in self.sway)
        zero = np.zeros((len(t), 6))
        about_z, about_x, about_view = zero.copy(), zero.copy(), zero.copy()
        about_z[:, 2], about_x[:, 0], about_view[:, 2] = yaw, pitch - self.pitch, roll
        T = se3.exp(about_z) @ se3.exp(about_x) @ AHEAD @ se3.exp(about_view)
        T[:, :3, 3] = np.array(self.place) + np.stack([x, y, z], -1)
        return np.asarray(T)


AHEAD = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])  # camera axes in the world's


def hand_held(rng: np.random.Generator, place: tuple[float, float, float], pitch: float) -> HandHeld:
    """A path of up to 0.3 m and 15 degrees, at most 0.35 m/s and 25 deg/s; phases and rates by chance."""
    amplitudes = [(0.13, 0.004), (0.07, 0.003), (0.035, 0.006), (0.1, 0.009), (0.04, 0.006), (0.025, 0.005)]
    rates = [(0.22, 1.1), (0.2, 0.9), (0.35, 1.7), (0.28, 1.2), (0.33, 1.3), (0.25, 0.9)]
    waves = []
    for (a, tremor), (f, g) in zip(amplitudes, rates, strict=True):
        stretch, p, q = rng.uniform(0.9, 1.1), *rng.uniform(0.0, 2 * np.pi, 2)
        waves.append(Wave((a, tremor), (float(f * stretch), g), (float(p), float(q))))
    return HandHeld(place, pitch, tuple(waves))


@dataclass(frozen=True, eq=False)
class Scene:
    """Everything there is to render."""

    name: str
    things: tuple[Thing, ...]
    camera: HandHeld
    light: tuple[float, float, float]  # m, in the world
