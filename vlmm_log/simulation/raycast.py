"""What the camera meets, by Embree through Open3D: the still world at once, each moving part in its own frame.

Wald et al., SIGGRAPH 2014. Nothing is rebuilt while things move: rays are taken into the part's frame instead, those
of the rectangle of the image that the part may fill, at each row's own time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from vlmm_log import se3
from vlmm_log.open3d_loading import load_open3d
from vlmm_log.simulation.kernels import Lens, cast_rays, merge
from vlmm_log.simulation.materials import PATTERNS
from vlmm_log.simulation.meshes import Mesh, moved
from vlmm_log.simulation.motions import Motion
from vlmm_log.simulation.shading import Looks
from vlmm_log.simulation.shapes import Piece, put
from vlmm_log.simulation.things import HandHeld, Scene
from vlmm_log.types import Float32, Float64, Int32, UInt16

NEAR_M = 0.05  # nearer than it, a part's rectangle is the whole image


@dataclass(frozen=True, eq=False)
class World:
    """A scene as rays and kernels want it. Part 0 is all that stays; row k of a table is of piece k."""

    scene: Any  # RaycastingScene of part 0
    parts: tuple[Any, ...]  # RaycastingScene of each part from 1 on, in its frame
    corners: tuple[Float64, ...]  # (8, 3) m of each part from 1 on, in its frame
    motions: tuple[Motion, ...]  # of each part from 1 on
    first_piece: tuple[int, ...]  # of each part from 1 on
    looks: Looks
    instance: UInt16  # (pieces,)
    instance_of_part: tuple[int, ...]  # of each part from 1 on
    camera: HandHeld
    light: Float32  # (3,) m


@dataclass(frozen=True, eq=False)
class Exposure:
    """Camera and parts while an image is taken: R is its height, or 1 where all rows are taken at once."""

    T_world_cam: Float64  # (R, 4, 4)
    T_world_part: Float64  # (P + 1, R, 4, 4); part 0 is the world
    T_part_cam: Float64  # (P + 1, R, 4, 4)


@dataclass(frozen=True, eq=False)
class Hits:
    """The nearest surface at every pixel."""

    depth: Float32  # (H, W) m along the optical axis, inf: nothing
    piece: Int32  # (H, W) -1: nothing
    normal: Float32  # (H, W, 3) unit, in the part's frame, of either sign


def build(scene: Scene) -> World:
    """Everything that does not change. Raises InputError where Open3D is not installed."""
    o3d = load_open3d("simulate")
    pieces: list[tuple[Piece, int, int]] = []  # with part and instance
    still = o3d.t.geometry.RaycastingScene()
    moving, corners, motions, first_piece, owners = [], [], [], [], []
    bodies = [(body, i) for i, thing in enumerate(scene.things, 1) for body in thing.bodies]
    for body, instance in (pair for pair in bodies if pair[0].motion is None):
        for piece in put(body.shape, body.T_world_body).pieces:
            _add(o3d, still, piece.mesh)
            pieces.append((piece, 0, instance))
    for part, (body, instance) in enumerate((pair for pair in bodies if pair[0].motion is not None), 1):
        own = o3d.t.geometry.RaycastingScene()
        first_piece.append(len(pieces))
        for piece in body.shape.pieces:
            _add(o3d, own, piece.mesh)
            pieces.append((piece, part, instance))
        low, high = body.shape.bounds
        corners.append(
            np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
        )
        assert body.motion is not None
        moving.append(own)
        motions.append(body.motion)
        owners.append(instance)
    instance_of = np.array([i for _, _, i in pieces], np.uint16)
    light = np.array(scene.light, np.float32)
    world = World(
        still,
        tuple(moving),
        tuple(corners),
        tuple(motions),
        tuple(first_piece),
        _looks(pieces),
        instance_of,
        tuple(owners),
        scene.camera,
        light,
    )
    for embree in (still, *moving):  # so that each is built before threads share it
        embree.cast_rays(o3d.core.Tensor(np.array([[0, 0, 0, 0, 0, 1]], np.float32)))
    return world


def exposure(world: World, t: float, readout_s: float, height: int) -> Exposure:
    """Where all is when row v of ``height`` is taken: at ``t + (v / height - 1/2) readout_s``, seconds."""
    rows = np.array([t]) if readout_s == 0 else t + (np.arange(height) / height - 0.5) * readout_s
    T_world_cam = world.camera(rows)
    still = np.broadcast_to(np.eye(4), (len(rows), 4, 4))
    T_world_part = np.stack([still, *(motion(rows) for motion in world.motions)])
    return Exposure(T_world_cam, T_world_part, np.asarray(se3.inverse(T_world_part) @ T_world_cam))


def cast(world: World, seen: Exposure, lens: Lens, size: tuple[int, int]) -> Hits:
    """The nearest surfaces on a grid of size (H, W)."""
    o3d = load_open3d("simulate")
    H, W = size
    found = _cast(o3d, world.scene, seen.T_part_cam[0], lens, (0, 0, W, H))
    depth, normal = found["t_hit"].numpy(), found["primitive_normals"].numpy()
    piece = found["geometry_ids"].numpy().view(np.int32)  # none is 2^32 - 1, thus -1
    for k, own in enumerate(world.parts):
        T = seen.T_part_cam[k + 1]
        rectangle = _rectangle(world.corners[k], T, lens, size)
        if rectangle is None:
            continue
        found = _cast(o3d, own, T, lens, rectangle)
        t, geometry, normals = (found[name].numpy() for name in ("t_hit", "geometry_ids", "primitive_normals"))
        merge(depth, piece, normal, t, geometry, normals, world.first_piece[k], rectangle[0], rectangle[1])
    return Hits(depth, piece, normal)


def _cast(o3d: Any, scene: Any, T: Float64, lens: Lens, rectangle: tuple[int, int, int, int]) -> Any:
    u0, v0, u1, v1 = rectangle
    rays = np.empty((v1 - v0, u1 - u0, 6), np.float32)
    cast_rays(rays, T[:, :3], lens, u0, v0)
    return scene.cast_rays(o3d.core.Tensor.from_numpy(rays))


def _rectangle(
    corners: Float64, T_part_cam: Float64, lens: Lens, size: tuple[int, int]
) -> tuple[int, int, int, int] | None:
    """u0, v0, u1, v1 of the pixels that a part may fill at any row's time; None: it is out of view."""
    H, W = size
    some = np.unique(np.linspace(0, len(T_part_cam) - 1, 9).astype(int))
    points = np.concatenate([corners @ T[:3, :3].T + T[:3, 3] for T in se3.inverse(T_part_cam[some])])
    if points[:, 2].max() < NEAR_M:
        return None
    if points[:, 2].min() < NEAR_M:
        return 0, 0, W, H
    u, v = lens.fx * points[:, 0] / points[:, 2] + lens.cx, lens.fy * points[:, 1] / points[:, 2] + lens.cy
    u0, v0 = max(int(np.floor(u.min())) - 2, 0), max(int(np.floor(v.min())) - 2, 0)
    u1, v1 = min(int(np.ceil(u.max())) + 3, W), min(int(np.ceil(v.max())) + 3, H)
    return (u0, v0, u1, v1) if u0 < u1 and v0 < v1 else None


def _looks(pieces: list[tuple[Piece, int, int]]) -> Looks:
    materials = [piece.material for piece, _, _ in pieces]
    return Looks(
        np.array([(m.colour, m.second) for m in materials], np.float32),
        np.array([(m.scale, m.grain, m.coarse, *m.shift) for m in materials], np.float32),
        np.array([PATTERNS.index(m.pattern) for m in materials], np.int32),
        np.array([piece.T_texture[:3] for piece, _, _ in pieces], np.float32),
        np.array([part for _, part, _ in pieces], np.int32),
        1 + max(part for _, part, _ in pieces),
    )


def _add(o3d: Any, scene: Any, mesh: Mesh) -> None:
    mesh = moved(mesh, np.eye(4))
    scene.add_triangles(o3d.core.Tensor(mesh.vertices.copy()), o3d.core.Tensor(mesh.triangles.copy()))
