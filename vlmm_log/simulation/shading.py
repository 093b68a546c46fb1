"""Colour of what is seen: procedural texture under a lamp, compiled by numba."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from vlmm_log.compiled import jit
from vlmm_log.simulation.kernels import f32
from vlmm_log.types import Float32, Int32

LATTICE = 32  # nodes a side of the noise's period: the table fits a core's cache
OCTAVES = 5
SHORTER = f32(0.42)  # wave of an octave over the one before
FADE = f32(1.6)  # wave of the noise over the pixel's footprint at which it vanishes


class Looks(NamedTuple):
    """Materials of all pieces; patterns by their place in materials.PATTERNS."""

    colours: Float32  # (n, 2, 3) 0 to 1
    numbers: Float32  # (n, 6) scale m, grain, coarse m, shift m (3)
    pattern: Int32  # (n,)
    T_texture: Float32  # (n, 3, 4) from the part's frame
    part: Int32  # (n,)
    parts: int  # how many, with part 0


@jit
def _between(values: Any, i: Any, j: Any, share: Any) -> Any:
    return values[i] + (values[j] - values[i]) * share


@jit
def _noise(lattice: Any, x: Any, y: Any, z: Any) -> Any:
    """Value noise in about -1 to 1, period 32. Perlin's fade curve of 1985."""
    xf, yf, zf = np.floor(x), np.floor(y), np.floor(z)
    ax, ay, az = x - xf, y - yf, z - zf
    ax, ay, az = ax * ax * (f32(3) - f32(2) * ax), ay * ay * (f32(3) - f32(2) * ay), az * az * (f32(3) - f32(2) * az)
    u0, v0, w0 = int(xf) & 31, int(yf) & 31, int(zf) & 31
    i0, i1 = np.uint64(u0 << 10), np.uint64(((u0 + 1) & 31) << 10)  # unsigned: numba need not ask for the end
    j0, j1 = np.uint64(v0 << 5), np.uint64(((v0 + 1) & 31) << 5)
    k0, k1 = np.uint64(w0), np.uint64((w0 + 1) & 31)
    a, b = _between(lattice, i0 + j0 + k0, i0 + j0 + k1, az), _between(lattice, i0 + j1 + k0, i0 + j1 + k1, az)
    c, d = _between(lattice, i1 + j0 + k0, i1 + j0 + k1, az), _between(lattice, i1 + j1 + k0, i1 + j1 + k1, az)
    near, far = a + (b - a) * ay, c + (d - c) * ay
    return near + (far - near) * ax


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
        gap = min(abs(x - np.floor(x) - f32(0.5)), abs(y - np.floor(y) - f32(0.5)))
        return f32(1) - _step(gap - f32(0.03), f32(0.012) + blur)
    if kind == 6:  # clouds
        return min(max(f32(0.5) + f32(0.8) * coarse, f32(0)), f32(1))
    return f32(0)


@jit
def _turned(T: Any, i: Any, k: Any, x: Any, y: Any, z: Any) -> Any:
    """Component k of a vector after the rotation of T[i]. Without a view of T: numba would count its users."""
    return T[i, k, 0] * x + T[i, k, 1] * y + T[i, k, 2] * z


@jit
def _texture(looks: Any, lattice: Any, p: Any, x: Any, y: Any, z: Any, nx: Any, ny: Any, nz: Any, foot: Any) -> Any:
    """Share of the second colour, and gain, at a point and normal of the part; ``foot`` m is the size of the pixel."""
    T = looks.T_texture
    a = _turned(T, p, 0, x, y, z) + T[p, 0, 3]
    b = _turned(T, p, 1, x, y, z) + T[p, 1, 3]
    c = _turned(T, p, 2, x, y, z) + T[p, 2, 3]
    ma, mb, mc = (
        abs(_turned(T, p, 0, nx, ny, nz)),
        abs(_turned(T, p, 1, nx, ny, nz)),
        abs(_turned(T, p, 2, nx, ny, nz)),
    )
    sx, sy, sz = a + looks.numbers[p, 3], b + looks.numbers[p, 4], c + looks.numbers[p, 5]
    if ma > mb and ma > mc:  # the face's own two axes
        a, b = b, c
    elif mb > mc:
        b = c
    scale, kind, coarse = looks.numbers[p, 0], looks.pattern[p], f32(0)
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
        total += min(f32(1), (over - FADE) / FADE) * _noise(lattice, sx * per, sy * per, sz * per)
        wave *= SHORTER
    return share, max(f32(1) + looks.numbers[p, 1] * f32(1.3) * total, f32(0.15))


@jit
def _light(T: Any, i: Any, light: Any, x: Any, y: Any, z: Any, nx: Any, ny: Any, nz: Any) -> Any:
    """Brightness of a point with a normal, both of the part's frame, which T[i] leads into the world."""
    lit, square = f32(0), f32(0)
    for k in range(3):
        to = light[k] - _turned(T, i, k, x, y, z) - T[i, k, 3]
        lit += _turned(T, i, k, nx, ny, nz) * to
        square += to * to
    return f32(0.55) + f32(0.14) * _turned(T, i, 2, nx, ny, nz) + f32(0.42) * max(lit, f32(0)) / math.sqrt(square)


@jit
def shade(
    rgb: Any, hits: Any, T_part_cam: Any, T_world_part: Any, looks: Any, lattice: Any, grain: Any, light: Any, lens: Any
) -> None:
    """Colours (H, W, 3) u8 of what is seen: texture, diffuse light, grain of the image. All floats are float32.

    ``hits`` are depth (H, W), piece (H, W) and normal (H, W, 3); T arrays (parts * R, 3, 4).
    """
    depth, piece, normal = hits
    H, W = depth.shape
    rows = T_part_cam.shape[0] // looks.parts
    for v in range(H):
        y = (f32(v) - lens.cy) / lens.fy
        for u in range(W):
            p = piece[v, u]
            if p < 0:
                rgb[v, u, 0], rgb[v, u, 1], rgb[v, u, 2] = 0, 0, 0
                continue
            i = looks.part[p] * rows + (v if rows > 1 else 0)
            x, z = (f32(u) - lens.cx) / lens.fx, depth[v, u]
            wx, wy, wz = (
                _turned(T_part_cam, i, 0, x, y, f32(1)),
                _turned(T_part_cam, i, 1, x, y, f32(1)),
                _turned(T_part_cam, i, 2, x, y, f32(1)),
            )
            px, py, pz = T_part_cam[i, 0, 3] + z * wx, T_part_cam[i, 1, 3] + z * wy, T_part_cam[i, 2, 3] + z * wz
            nx, ny, nz = normal[v, u, 0], normal[v, u, 1], normal[v, u, 2]
            facing = wx * nx + wy * ny + wz * nz
            side = f32(-1) if facing > 0 else f32(1)
            bright = _light(T_world_part, i, light, px, py, pz, side * nx, side * ny, side * nz)
            cosine = max(abs(facing) / math.sqrt(x * x + y * y + f32(1)), f32(0.15))
            share, gain = _texture(looks, lattice, p, px, py, pz, nx, ny, nz, z / lens.fx / math.sqrt(cosine))
            gain *= bright * f32(255)
            for k in range(3):
                c = looks.colours[p, 0, k] * (f32(1) - share) + looks.colours[p, 1, k] * share
                rgb[v, u, k] = np.uint8(min(max(c * gain + grain[v, u, k] + f32(0.5), f32(0)), f32(255)))


def lattice(seed: int) -> Float32:
    """Flat (32^3,) table of the noise, uniform in -1 to 1."""
    rng = np.random.default_rng([seed, 64])
    return rng.uniform(-1.0, 1.0, LATTICE**3).astype(np.float32)
