"""Rays and what they meet, pixel by pixel, compiled by numba.

``T`` arrays hold one (3, 4) a row of the image, or one for all rows where the shutter is global: (R, 3, 4).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from vlmm_log.compiled import jit

f32 = np.float32


class Lens(NamedTuple):
    """Pinhole intrinsics, px."""

    fx: float
    fy: float
    cx: float
    cy: float


@jit
def cast_rays(rays: Any, T: Any, lens: Any, u0: Any, v0: Any) -> None:
    """Fill rays (h, w, 6): origin and direction in the frame that ``T`` leads into; lengths along them are depths."""
    h, w = rays.shape[0], rays.shape[1]
    for i in range(h):
        M = T[i + v0] if T.shape[0] > 1 else T[0]
        y = (i + v0 - lens.cy) / lens.fy
        for j in range(w):
            x = (j + u0 - lens.cx) / lens.fx
            for k in range(3):
                rays[i, j, k] = f32(M[k, 3])
                rays[i, j, k + 3] = f32(M[k, 0] * x + M[k, 1] * y + M[k, 2])


@jit
def merge(
    depth: Any, piece: Any, normal: Any, t: Any, geometry: Any, normals: Any, first: Any, u0: Any, v0: Any
) -> None:
    """Take the hits of one part (h, w) into the image where they are the nearest."""
    for i in range(t.shape[0]):
        for j in range(t.shape[1]):
            if t[i, j] < depth[i + v0, j + u0]:
                depth[i + v0, j + u0] = t[i, j]
                piece[i + v0, j + u0] = first + np.int32(geometry[i, j])
                for k in range(3):
                    normal[i + v0, j + u0, k] = normals[i, j, k]


@jit
def incidence(cosine: Any, piece: Any, normal: Any, T_part_cam: Any, part: Any, lens: Any) -> None:
    """Cosine (H, W) between the viewing ray and the surface's normal; 1 where nothing is seen."""
    H, W = piece.shape
    for v in range(H):
        r = v if T_part_cam.shape[1] > 1 else 0
        y = (v - lens.cy) / lens.fy
        for u in range(W):
            p = piece[v, u]
            if p < 0:
                cosine[v, u] = f32(1)
                continue
            M = T_part_cam[part[p], r]
            x = (u - lens.cx) / lens.fx
            facing = 0.0
            for k in range(3):
                facing += (M[k, 0] * x + M[k, 1] * y + M[k, 2]) * normal[v, u, k]
            cosine[v, u] = f32(abs(facing) / math.sqrt(x * x + y * y + 1.0))


@jit
def shadow(hidden: Any, depth: Any, reach: Any) -> None:
    """Mark what a projector to the right does not light; ``reach`` is baseline times focal length, m px."""
    H, W = depth.shape
    for v in range(H):
        least = 1e9
        for u in range(W - 1, -1, -1):
            z = depth[v, u]
            hidden[v, u] = False
            if z > 0:
                at = u - reach / z
                hidden[v, u] = at > least + 0.75
                least = min(least, at)
