"""One frame: what the camera gives, and the truth about it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vlmm_log import se3
from vlmm_log.simulation.following import follow
from vlmm_log.simulation.kernels import Lens, incidence
from vlmm_log.simulation.noise import DepthNoise, measured
from vlmm_log.simulation.raycast import Exposure, Hits, World, cast, exposure
from vlmm_log.simulation.shading import lattice, shade
from vlmm_log.types import Float32, Float64, UInt8, UInt16, freeze

FPS = 30
GRAIN = 1.6  # grey levels, sigma


@dataclass(frozen=True)
class Shutter:
    """When images are taken."""

    readout_s: float = 0.0  # from the first row of an image to the last
    depth_offset_s: float = 0.0  # of the depth image after the colour image


@dataclass(frozen=True, eq=False)
class View:
    """One frame of a scene; flow and motion towards the partner, None where there is none."""

    rgb: UInt8  # (H, W, 3)
    depth: Float32  # (H, W) m as the sensor gives it, 0 unseen
    exact: Float32  # (H, W) m at the colour image's exposure, inf: nothing
    instances: UInt16  # (H, W)
    parts: UInt16  # (H, W)
    flow: UInt16 | None  # (H, W, 3) as kernels.follow fills it
    motion: UInt8 | None  # (H, W)

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True, eq=False)
class Studio:
    """All that is the same in every frame."""

    world: World
    size: tuple[int, int]  # H, W
    lens: Lens
    shutter: Shutter
    noise: DepthNoise
    seed: int
    noise_lattice: Float32
    grain: Float32  # (2 H, 2 W, 3) grey levels, of which every frame takes another piece


def studio(world: World, size: tuple[int, int], shutter: Shutter, noise: DepthNoise, seed: int) -> Studio:
    """A camera of size (H, W) px in a world; nominal Kinect optics, scaled to the width."""
    H, W = size
    focal = 525.0 * W / 640
    grain = np.random.default_rng([seed, 1]).normal(0, GRAIN, (2 * H, 2 * W, 3)).astype(np.float32)
    lens = Lens(focal, focal, (W - 1) / 2, (H - 1) / 2)
    return Studio(world, size, lens, shutter, noise, seed, lattice(seed), grain)


def taken(at: Studio, index: int, partner: int | None) -> View:
    """Frame ``index``, and its truth towards frame ``partner``."""
    rng = np.random.default_rng([at.seed, 2, index])
    t = index / FPS
    seen = exposure(at.world, t, at.shutter.readout_s, at.size[0])
    hits = cast(at.world, seen, at.lens, at.size)
    flow, motion = (None, None) if partner is None else _onward(at, seen, hits, partner / FPS)
    known = hits.piece >= 0
    instances = np.where(known, at.world.instance[hits.piece], 0).astype(np.uint16)
    parts = np.where(known, at.world.looks.part[hits.piece], 0).astype(np.uint16)
    rgb = _coloured(at, seen, hits, rng)
    return View(rgb, _sensed(at, t, seen, hits, rng), hits.depth, instances, parts, flow, motion)


def _coloured(at: Studio, seen: Exposure, hits: Hits, rng: np.random.Generator) -> UInt8:
    H, W = at.size
    v, u = int(rng.integers(H + 1)), int(rng.integers(W + 1))
    rgb = np.empty((H, W, 3), np.uint8)
    T_part_cam, T_world_part = (
        T[:, :, :3].reshape(-1, 3, 4).astype(np.float32) for T in (seen.T_part_cam, seen.T_world_part)
    )
    grain, lens = at.grain[v : v + H, u : u + W], Lens(*np.array(at.lens, np.float32))
    surfaces = (hits.depth, hits.piece, hits.normal)
    shade(rgb, surfaces, T_part_cam, T_world_part, at.world.looks, at.noise_lattice, grain, at.world.light, lens)
    return rgb


def _sensed(at: Studio, t: float, seen: Exposure, hits: Hits, rng: np.random.Generator) -> Float32:
    """Depth of the sensor, whose image may be taken at another time."""
    if at.shutter.depth_offset_s:
        seen = exposure(at.world, t + at.shutter.depth_offset_s, at.shutter.readout_s, at.size[0])
        hits = cast(at.world, seen, at.lens, at.size)
    cosine = np.ones(at.size, np.float32)
    if at.noise.model == "nguyen" or at.noise.holes:
        incidence(cosine, hits.piece, hits.normal, seen.T_part_cam[:, :, :3], at.world.looks.part, at.lens)
    return measured(hits.depth, cosine, at.noise, at.lens.fx, rng)


def _onward(at: Studio, seen: Exposure, hits: Hits, t: float) -> tuple[UInt16, UInt8]:
    then = exposure(at.world, t, at.shutter.readout_s, at.size[0])
    T_cam_part = np.ascontiguousarray(se3.inverse(then.T_part_cam)[:, :, :3])
    flow, motion = np.empty((*at.size, 3), np.uint16), np.empty(at.size, np.uint8)
    first: tuple[Float64, Float64] = (seen.T_part_cam[:, :, :3], seen.T_world_part[:, :, :3])
    second: tuple[Float64, Float64] = (T_cam_part, then.T_world_part[:, :, :3])
    follow(flow, motion, hits.depth, hits.piece, at.world.looks.part, first, second, at.lens)
    return flow, motion
