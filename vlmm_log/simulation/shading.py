"""Colour of what is seen: procedural texture under a lamp, compiled by numba."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from vlmm_log.simulation.kernels import f32, jit
from vlmm_log.types import Float32, Int32

LATTICE = 32  # nodes a side of the noise's period: the table fits a core's cache
OCTAVES = 5
SHORTER = f32(0.42)  # wave of an octave over the one before
FADE = 1.6  # wave of the noise over the pixel's footprint at which it vanishes


class Looks(NamedTuple):
    """Materials of all pieces; patterns by their place in materials.PATTERNS."""

    colours: Float32  # (n, 2, 3) 0 to 1
    numbers: Float32  # (n, 6) scale m, grain, coarse m, shift m (3)
    pattern: Int32  # (n,)
    T_texture: Float32  # (n, 3, 4) from the part's frame
    part: Int32  # (n,)


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
                wave *= SHORTER
            gain = bright * max(f32(1) + looks.numbers[p, 1] * f32(1.3) * total, f32(0.15)) * f32(255)
            for k in range(3):
                c = looks.colours[p, 0, k] * (f32(1) - share) + looks.colours[p, 1, k] * share
                value = c * gain + grain[v, u, k]
                rgb[v, u, k] = np.uint8(min(max(value + f32(0.5), f32(0)), f32(255)))


def lattice(seed: int) -> Float32:
    """Flat (32^3,) table of the noise, uniform in -1 to 1."""
    rng = np.random.default_rng([seed, 64])
    return rng.uniform(-1.0, 1.0, LATTICE**3).astype(np.float32)
