"""A shape: pieces of one material each, in one rigid frame."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from vlmm_log import se3
from vlmm_log.simulation.materials import Material
from vlmm_log.simulation.meshes import Mesh, moved
from vlmm_log.types import Float64


@dataclass(frozen=True, eq=False)
class Piece:
    """A mesh of one material, and the frame of its texture."""

    mesh: Mesh
    material: Material
    T_texture: Float64  # (4, 4) from the shape's frame into the texture's


@dataclass(frozen=True, eq=False)
class Shape:
    """What is rigid. z up; most stand on z = 0 about the origin, their front towards -y."""

    pieces: tuple[Piece, ...]

    @cached_property
    def bounds(self) -> Float64:
        """(2, 3) m: lowest and highest corner."""
        low = np.min([p.mesh.vertices.min(0) for p in self.pieces], 0)
        high = np.max([p.mesh.vertices.max(0) for p in self.pieces], 0)
        return np.stack([low, high]).astype(np.float64)

    @property
    def size(self) -> Float64:
        """(3,) m."""
        return np.asarray(self.bounds[1] - self.bounds[0], np.float64)

    def __add__(self, other: Shape) -> Shape:
        return Shape(self.pieces + other.pieces)


def solid(mesh: Mesh, material: Material, *at: float) -> Shape:
    """One piece, shifted by (x, y, z)."""
    T = shift(*at) if at else np.eye(4)
    return Shape((Piece(moved(mesh, T), material, np.eye(4)),))


def put(shape: Shape, T: Float64) -> Shape:
    """The shape in another frame, its texture moving along."""
    back = se3.inverse(T)
    return Shape(tuple(Piece(moved(p.mesh, T), p.material, p.T_texture @ back) for p in shape.pieces))


def assembled(*shapes: Shape) -> Shape:
    """One rigid shape of several."""
    return Shape(tuple(piece for shape in shapes for piece in shape.pieces))


def shift(x: float, y: float, z: float = 0.0) -> Float64:
    """The motion (4, 4) by a vector, m."""
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def turn(axis: str, angle: float) -> Float64:
    """The motion (4, 4) about "x", "y" or "z" by an angle, rad."""
    twist = np.zeros(6)
    twist["xyz".index(axis)] = angle
    return se3.exp(twist)
