"""What is done at every pixel, compiled by numba: rays, colour, exact flow.

``T`` arrays hold one (3, 4) a row of the image, or one for all rows where the shutter is global: (R, 3, 4).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numba
import numpy as np

from vlmm_log.types import Float32, Int32

LATTICE = 32  # nodes a side of the noise's period: the table fits a core's cache
OCTAVES = 6
FADE = 1.6  # wave of the noise over the pixel's footprint at which it vanishes

f32 = np.float32
jit = numba.njit(cache=True, error_model="numpy", nogil=True)  # no fastmath: equal runs are to be equal


class Lens(NamedTuple):
    """Pinhole intrinsics, px."""

    fx: float
    fy: float
    cx: float
    cy: float


class Looks(NamedTuple):
    """Materials of all pieces; patterns by their place in materials.PATTERNS."""

    colours: Float32  # (n, 2, 3) 0 to 1
    numbers: Float32  # (n, 6) scale m, grain, coarse m, shift m (3)
    pattern: Int32  # (n,)
    T_texture: Float32  # (n, 3, 4) from the part's frame
    part: Int32  # (n,)


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
def _noise(lattice: Any, x: Any, y: Any, z: Any) -> Any:
    """Value noise in about -1 to 1, period 32. Perlin's fade curve of 1985."""
    xf, yf, zf = math.floor(x), math.floor(y), math.floor(z)
    ax, ay, az = x - xf, y - yf, z - zf
    ax, ay, az = ax * ax * (f32(3) - f32(2) * ax), ay * ay * (f32(3) - f32(2) * ay), az * az * (f32(3) - f32(2) * az)
    i0, j0, k0 = int(xf) & 31, int(yf) & 31, int(zf) & 31
    i1, j1, k1 = ((i0 + 1) & 31) << 10, ((j0 + 1) & 31) << 5, (k0 + 1) & 31
    i0, j0 = i0 << 10, j0 << 5
    a = lattice[i0 + j0 + k0] * (f32(1) - az) + lattice[i0 + j0 + k1] * az
    b = lattice[i0 + j1 + k0] * (f32(1) - az) + lattice[i0 + j1 + k1] * az
    c = lattice[i1 + j0 + k0] * (f32(1) - az) + lattice[i1 + j0 + k1] * az
    d = lattice[i1 + j1 + k0] * (f32(1) - az) + lattice[i1 + j1 + k1] * az
    return (a * (f32(1) - ay) + b * ay) * (f32(1) - ax) + (c * (f32(1) - ay) + d * ay) * ax


@jit
def _step(x: Any, width: Any) -> Any:
    """0 to 1 about x = 0, over ``width`` each way."""
    s = min(max(x / (f32(2) * width) + f32(0.5), f32(0)), f32(1))
    return s * s * (f32(3) - f32(2) * s)


@jit
def _blend(kind: Any, a: Any, b: Any, coarse: Any, scale: Any, blur: Any) -> Any:
    """Share of the second colour at (a, b) m on a face; ``coarse`` is noise of the pattern's scale."""
    turn = f32(2 * math.pi)
    if kind == 1:  # stripes
        return _step(math.sin(turn * a / scale), f32(0.15) + f32(3) * blur)
    if kind == 2:  # checks
        return _step(math.sin(turn * a / scale) * math.sin(turn * b / scale), f32(0.1) + f32(3) * blur)
    if kind == 3:  # print
        return _step(coarse - f32(0.08), f32(0.07) + blur)
    if kind == 4:  # wood
        return f32(0.5) + f32(0.5) * math.sin(turn * (b / scale + f32(1.3) * coarse)) * max(
            f32(1) - f32(2.5) * blur, f32(0)
        )
    if kind == 5:  # tiles
        x, y = a / scale, b / scale
        gap = min(abs(x - math.floor(x) - f32(0.5)), abs(y - math.floor(y) - f32(0.5)))
        return f32(1) - _step(gap - f32(0.03), f32(0.012) + blur)
    if kind == 6:  # clouds
        return min(max(f32(0.5) + f32(0.8) * coarse, f32(0)), f32(1))
    return f32(0)


@jit
def shade(
    rgb: Any,
    depth: Any,
    piece: Any,
    normal: Any,
    T_part_cam: Any,
    T_world_part: Any,
    looks: Any,
    lattice: Any,
    grain: Any,
    light: Any,
    lens: Any,
) -> None:
    """Colours (H, W, 3) u8 of what is seen: texture, diffuse light, grain of the image."""
    H, W = depth.shape
    X, q, m = np.empty(3, np.float32), np.empty(3, np.float32), np.empty(3, np.float32)
    for v in range(H):
        r = v if T_part_cam.shape[1] > 1 else 0
        y = (v - lens.cy) / lens.fy
        for u in range(W):
            p = piece[v, u]
            if p < 0:
                for k in range(3):
                    rgb[v, u, k] = 0
                continue
            part = looks.part[p]
            M, P, A = T_part_cam[part, r], T_world_part[part, r], looks.T_texture[p]
            x, z = (u - lens.cx) / lens.fx, depth[v, u]
            facing = 0.0
            for k in range(3):
                way = M[k, 0] * x + M[k, 1] * y + M[k, 2]
                X[k] = M[k, 3] + z * way
                facing += way * normal[v, u, k]
            side = -1.0 if facing > 0 else 1.0
            lit, up = 0.0, 0.0
            square = 0.0
            for k in range(3):
                nk = side * (P[k, 0] * normal[v, u, 0] + P[k, 1] * normal[v, u, 1] + P[k, 2] * normal[v, u, 2])
                to = light[k] - (P[k, 0] * X[0] + P[k, 1] * X[1] + P[k, 2] * X[2] + P[k, 3])
                lit += nk * to
                square += to * to
                if k == 2:
                    up = nk
            bright = f32(0.55 + 0.14 * up + 0.42 * max(lit, 0.0) / math.sqrt(square))
            cosine = max(abs(facing) / math.sqrt(x * x + y * y + 1.0), 0.15)
            foot = f32(z / lens.fx / math.sqrt(cosine))
            for k in range(3):
                q[k] = A[k, 0] * X[0] + A[k, 1] * X[1] + A[k, 2] * X[2] + A[k, 3]
                m[k] = abs(A[k, 0] * normal[v, u, 0] + A[k, 1] * normal[v, u, 1] + A[k, 2] * normal[v, u, 2])
            a, b = q[0], q[1]
            if m[0] > m[2] and m[0] > m[1]:
                a, b = q[1], q[2]
            elif m[1] > m[2]:
                a, b = q[0], q[2]
            scale = looks.numbers[p, 0]
            sx, sy, sz = q[0] + looks.numbers[p, 3], q[1] + looks.numbers[p, 4], q[2] + looks.numbers[p, 5]
            kind = looks.pattern[p]
            coarse = f32(0)
            if kind == 3 or kind == 4 or kind == 6:
                per = f32(0.25) / scale if kind == 4 else f32(2) / scale
                coarse = _noise(lattice, sx * per, sy * per, sz * per)
            share = _blend(kind, a, b, coarse, scale, foot / scale)
            wave, total = looks.numbers[p, 2], f32(0)
            for _ in range(OCTAVES):
                over = wave / foot
                if over < FADE:
                    break
                per = f32(1) / wave
                total += min(f32(1), (over - f32(FADE)) / f32(FADE)) * _noise(lattice, sx * per, sy * per, sz * per)
                wave *= f32(0.46)
            gain = bright * max(f32(1) + looks.numbers[p, 1] * f32(1.3) * total, f32(0.15)) * f32(255)
            for k in range(3):
                c = looks.colours[p, 0, k] * (f32(1) - share) + looks.colours[p, 1, k] * share
                value = c * gain + grain[v, u, k]
                rgb[v, u, k] = np.uint8(min(max(value + f32(0.5), f32(0)), f32(255)))


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
def _row(T: Any, v: Any, M: Any) -> None:
    """M (3, 4): T (R, 3, 4) at a row that need not be whole, between its neighbours."""
    last = T.shape[0] - 1
    at = min(max(v, 0.0), float(last))
    i = min(int(at), max(last - 1, 0))
    s = at - i
    j = min(i + 1, last)
    for a in range(3):
        for b in range(4):
            M[a, b] = (1.0 - s) * T[i, a, b] + s * T[j, a, b]


@jit
def follow(flow: Any, motion: Any, depth: Any, piece: Any, part: Any, first: Any, second: Any, lens: Any) -> None:
    """Where each pixel's point is seen in the second image, and whether it moved in the world meanwhile.

    ``flow`` (H, W, 3) u16 is filled as KITTI stores it, in the order valid, v, u in which OpenCV writes channels;
    ``motion`` is (H, W) u8. ``first`` is (T_part_cam, T_world_part), ``second`` is (T_cam_part, T_world_part), of all
    parts. Where rows are exposed one after another, the row where a point is seen says when it is: a fixed point, which
    contracts by readout times the point's speed in rows.
    """
    H, W = depth.shape
    M, P = np.empty((3, 4)), np.empty((3, 4))
    X, Y = np.empty(3), np.empty(3)
    rounds = 6 if second[0].shape[1] > 1 else 1
    for v in range(H):
        r = v if first[0].shape[1] > 1 else 0
        y = (v - lens.cy) / lens.fy
        for u in range(W):
            p = piece[v, u]
            flow[v, u, 0], flow[v, u, 1], flow[v, u, 2], motion[v, u] = 0, 0, 0, 0
            if p < 0:
                continue
            k = part[p]
            x, z = (u - lens.cx) / lens.fx, float(depth[v, u])
            F = first[0][k, r]
            for i in range(3):
                X[i] = F[i, 3] + z * (F[i, 0] * x + F[i, 1] * y + F[i, 2])
            row, column, ahead = float(v), float(u), 1.0
            for _ in range(rounds):
                _row(second[0][k], row, M)
                for i in range(3):
                    Y[i] = M[i, 0] * X[0] + M[i, 1] * X[1] + M[i, 2] * X[2] + M[i, 3]
                ahead = Y[2]
                if ahead < 0.05:
                    break
                column, row = lens.fx * Y[0] / ahead + lens.cx, lens.fy * Y[1] / ahead + lens.cy
            if k > 0:
                way2 = 0.0
                _row(second[1][k], row, P)
                Q = first[1][k, r]
                for i in range(3):
                    d = (P[i, 0] - Q[i, 0]) * X[0] + (P[i, 1] - Q[i, 1]) * X[1] + (P[i, 2] - Q[i, 2]) * X[2]
                    way2 += (d + P[i, 3] - Q[i, 3]) ** 2
                motion[v, u] = 255 if way2 >= 1e-4 else (0 if way2 < 1e-6 else 128)
            if ahead < 0.05 or column < 0 or column > W - 1 or row < 0 or row > H - 1:
                continue
            flow[v, u, 2] = np.uint16(round((column - u) * 64.0) + 32768)
            flow[v, u, 1] = np.uint16(round((row - v) * 64.0) + 32768)
            flow[v, u, 0] = 1


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


def lattice(seed: int) -> Float32:
    """Flat (32^3,) table of the noise, uniform in -1 to 1."""
    rng = np.random.default_rng([seed, 64])
    return rng.uniform(-1.0, 1.0, LATTICE**3).astype(np.float32)
