"""Triangle meshes of simple solids, metres. z is up; a solid stands on z = 0 with its axis at the origin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vlmm_log.types import Float32, Float64, freeze


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles; either side of them may be seen."""

    vertices: Float32  # (N, 3) m
    triangles: NDArray[np.uint32]  # (M, 3) rows of vertices

    def __post_init__(self) -> None:
        freeze(self)


def box(width: float, depth: float, height: float) -> Mesh:
    """Along x, y and z."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0.0, 1.0)])
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = [t for a, b, c, d in faces for t in ((a, b, c), (a, c, d))]
    return _mesh(corners * (width, depth, height), triangles)


def lathe(profile: Sequence[tuple[float, float]], segments: int = 28) -> Mesh:
    """A line of (radius, height) turned about z."""
    angle = np.linspace(0.0, 2 * np.pi, segments, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle)], -1)
    rings = [np.column_stack([r * ring, np.full(segments, z)]) for r, z in profile]
    return _skin(np.stack(rings))


def cylinder(radius: float, height: float, segments: int = 28) -> Mesh:
    """With both its lids."""
    return lathe([(0, 0), (radius, 0), (radius, height), (0, height)], segments)


def sphere(radius: float, segments: int = 32) -> Mesh:
    """Standing on z = 0: its centre is one radius up."""
    polar = np.linspace(0.0, np.pi, segments // 2 + 1)
    return lathe([(radius * np.sin(a), radius * (1 - np.cos(a))) for a in polar], segments)


def cushion(width: float, depth: float, height: float, edge: float = 0.45) -> Mesh:
    """A superellipsoid: the rounder, the nearer ``edge`` is to 1. Barr 1981."""
    a, b = np.meshgrid(
        np.linspace(-np.pi / 2, np.pi / 2, 17), np.linspace(-np.pi, np.pi, 32, endpoint=False), indexing="ij"
    )
    x, y, z = (
        _power(np.cos(a), edge) * _power(np.cos(b), edge),
        _power(np.cos(a), edge) * _power(np.sin(b), edge),
        _power(np.sin(a), edge),
    )
    return _skin(np.stack([x * width / 2, y * depth / 2, (z + 1) * height / 2], -1))


def tube(path: ArrayLike, radius: float, segments: int = 10) -> Mesh:
    """A round bar along a line of points (n, 3)."""
    points = np.asarray(path, np.float64)
    along = np.gradient(points, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    side = np.cross(along, [0.267, 0.534, 0.802] if abs(along[0] @ [0.267, 0.534, 0.802]) < 0.9 else [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    other = np.cross(along, side)
    angle = np.linspace(0.0, 2 * np.pi, segments, endpoint=False)[None, :, None]
    rings = points[:, None] + radius * (np.cos(angle) * side[:, None] + np.sin(angle) * other[:, None])
    ends = (np.repeat(points[:1, None], segments, 1), np.repeat(points[-1:, None], segments, 1))
    return _skin(np.concatenate([ends[0], rings, ends[1]]))


def sheet(width: float, height: float, wave: float, folds: float) -> Mesh:
    """A hanging cloth in the plane of x and z with folds of amplitude ``wave``."""
    x, z = np.meshgrid(np.linspace(-0.5, 0.5, 12 * int(np.ceil(folds)) + 1), np.linspace(0.0, 1.0, 5), indexing="ij")
    y = wave * np.sin(2 * np.pi * folds * x) * (1.0 - 0.3 * z)
    points = np.stack([x * width, y, z * height], -1)
    n, m = x.shape
    return _mesh(points.reshape(-1, 3), _quads(np.arange(n * m).reshape(n, m)))


def arc(radius: float, start: float, stop: float, n: int = 9) -> Float64:
    """Points (n, 3) of a circle in the plane of x and z; angles rad from +x."""
    a = np.linspace(start, stop, n)
    return np.stack([radius * np.cos(a), np.zeros(n), radius * np.sin(a)], -1)


def moved(mesh: Mesh, T: Float64) -> Mesh:
    """The mesh in another frame; ``T`` (4, 4) may scale, too."""
    return _mesh(mesh.vertices @ T[:3, :3].T + T[:3, 3], mesh.triangles)


def joined(*meshes: Mesh) -> Mesh:
    """One mesh of several."""
    starts = np.cumsum([0, *(len(m.vertices) for m in meshes)])
    triangles = np.concatenate([m.triangles + np.uint32(s) for m, s in zip(meshes, starts, strict=False)])
    return _mesh(np.concatenate([m.vertices for m in meshes]), triangles)


def _skin(rings: Float64) -> Mesh:
    """Of rings (n, m, 3), each closed; triangles of no area are left out."""
    n, m = rings.shape[:2]
    index = np.arange(n * m).reshape(n, m)
    mesh = _mesh(rings.reshape(-1, 3), _quads(np.column_stack([index, index[:, 0]])))
    a, b, c = (mesh.vertices[mesh.triangles[:, k]].astype(np.float64) for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return _mesh(mesh.vertices, mesh.triangles[area > 1e-9])


def _quads(index: NDArray[np.int64]) -> NDArray[np.int64]:
    a, b, c, d = index[:-1, :-1].ravel(), index[1:, :-1].ravel(), index[1:, 1:].ravel(), index[:-1, 1:].ravel()
    return np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)])


def _power(x: Float64, exponent: float) -> Float64:
    return np.asarray(np.sign(x) * np.abs(x) ** exponent, np.float64)


def _mesh(vertices: ArrayLike, triangles: ArrayLike) -> Mesh:
    return Mesh(np.array(vertices, np.float32), np.array(triangles, np.uint32))
