"""The numeric kernels, compiled by numba: planar float32, a gather pass and a SIMD pass a row.

Sigma_m and d_M are computed in a sheared frame of camera b in which the viewing ray of u' is e3. The
shear S is invertible and linear, so that d_M is unchanged by it, and endpoint b's covariance becomes
diag(z_b^2 C, sigma_zb^2) with C the 2x2 lateral covariance in normalised image units. The textbook form
in float64 stands in ``tests/textbook.py``.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vlmm_log.compiled import jit
from vlmm_log.types import Float32, UInt8

Int32 = NDArray[np.int32]

f32 = np.float32


class Camera(NamedTuple):
    """Pinhole intrinsics, px."""

    fx: np.float32
    fy: np.float32
    cx: np.float32
    cy: np.float32


class Model(NamedTuple):
    """The gate and the noise, as the kernels want them: float32, variances in px^2 and m^2."""

    fb_px: np.float32
    depth_band: np.float32
    occlusion_sigma: np.float32
    occlusion_m: np.float32
    z_a: np.float32
    z_b: np.float32
    z_z0: np.float32
    var_px_first: np.float32
    var_px_second: np.float32
    fb_variance: np.float32
    var_displacement: np.float32
    edge_inflation: np.float32
    var_rotation: np.float32
    var_translation: np.float32


class Inputs(NamedTuple):
    """A pair as the kernels read it; fields of the first frame's grid but where told."""

    depth_first: Float32  # (H, W) m
    depth_second: Float32  # (H, W) m, on the second frame's grid
    range_first: Float32  # (H, W) m, local depth range
    range_second: Float32  # (H, W) m, on the second frame's grid
    forward: Float32  # (H, W, 2) px
    fb_error: Float32  # (H, W) px
    flow_covariance: Float32  # (3, H, W) px^2, xx, xy, yy: what texture and neighbours leave open
    camera: Camera
    model: Model


# Matches are worked on in blocks of one flat scratch array, plane after plane: constant distances between planes
# let the compiler see that none overlaps another, and vectorise.
BLOCK = 512  # pixels
NX, NY = 0 * BLOCK, 1 * BLOCK  # u' px, then as a normalised ray (x / z, y / z) of camera b
ZA, ZB = 2 * BLOCK, 3 * BLOCK  # depth at both ends, m
VA, VB = 4 * BLOCK, 5 * BLOCK  # local depth range m, then variance of the depth m^2, at both ends
CXX, CXY, CYY = 6 * BLOCK, 7 * BLOCK, 8 * BLOCK  # lateral covariance at b in normalised image units
GATHERED = 9  # planes of a match; those that score fills follow
DM, BEHIND = 9 * BLOCK, 10 * BLOCK  # d_M; squared distance of match before prediction, less the limit's, m^2
MX, MY, MZ = 11 * BLOCK, 12 * BLOCK, 13 * BLOCK  # residual in the world, m
PLANES = 14

VALID, NO_DEPTH, OUT_OF_VIEW, FB_INCONSISTENT, OCCLUDED, OUT_OF_RANGE = 0, 1, 2, 3, 4, 5  # types.Validity
LEAST, MOST = f32(2.0**-126), f32((2 - 2.0**-23) * 2.0**127)  # normal float32: less has no digits left

P_TABLE_SIZE = 8192
P_TABLE_MAX = 48.0  # d_M^2 beyond it: p_stat below 3e-10, written as its last value


def p_stat_table() -> Float32:
    """Tail probability of chi-square with 3 degrees of freedom at 0 .. P_TABLE_MAX in d_M^2, for linear look-up."""
    d2 = np.linspace(0.0, P_TABLE_MAX, P_TABLE_SIZE)
    tail = [math.erfc(math.sqrt(x / 2)) + math.sqrt(2 * x / math.pi) * math.exp(-x / 2) for x in d2]
    return np.array(tail, np.float32)


@jit
def _depth_at(depth: Float32, W: int, ax: Any, ay: Any, corner: Any, band: Any) -> Any:
    """Bilinear over the neighbours within ``band * z`` of the nearest one; NaN where that one is unseen.

    ``depth`` is flat; ``corner`` indexes the upper left neighbour, (ax, ay) is the place from there. Unsigned
    indices: numba need not ask whether they count from the end.
    """
    one, down = np.uint64(1), np.uint64(W)
    z00, z10 = depth[corner], depth[corner + one]
    z01, z11 = depth[corner + down], depth[corner + down + one]
    right = ax >= f32(0.5)
    above, below = z10 if right else z00, z11 if right else z01
    nearest = below if ay >= f32(0.5) else above
    width = band * nearest
    bx, by = f32(1) - ax, f32(1) - ay
    d00, d10, d01, d11 = abs(z00 - nearest), abs(z10 - nearest), abs(z01 - nearest), abs(z11 - nearest)
    if d00 + d10 + d01 + d11 <= width:  # nearly always
        return by * (bx * z00 + ax * z10) + ay * (bx * z01 + ax * z11)
    in00, in10, in01, in11 = d00 <= width, d10 <= width, d01 <= width, d11 <= width
    w00, w10 = bx * by if in00 else f32(0), ax * by if in10 else f32(0)
    w01, w11 = bx * ay if in01 else f32(0), ax * ay if in11 else f32(0)
    total = (w00 * z00 if in00 else f32(0)) + (w10 * z10 if in10 else f32(0))
    total += (w01 * z01 if in01 else f32(0)) + (w11 * z11 if in11 else f32(0))
    return total / (w00 + w10 + w01 + w11)  # 0 / 0 is NaN where the nearest is


@jit
def _look_up(v: int, u0: int, stride: int, x: Inputs, s: Float32, status: UInt8) -> None:
    """The gate, and what only the match's place tells: u', both depths, depth range at b. Scalar: it jumps about."""
    H, W = x.depth_first.shape
    m = x.model
    right, bottom = f32(W - 1), f32(H - 1)
    flat_depth, flat_range = x.depth_second.ravel(), x.range_second.ravel()
    for i in range(status.shape[0]):
        u = u0 + i * stride
        za = x.depth_first[v, u]
        px, py = f32(u) + x.forward[v, u, 0], f32(v) + x.forward[v, u, 1]
        zb, near = f32(1), f32(0)
        if not za > f32(0):
            status[i] = NO_DEPTH
            za = f32(1)
        elif not (px >= f32(0) and py >= f32(0) and px <= right and py <= bottom):
            status[i] = OUT_OF_VIEW
        else:
            x0, y0 = min(np.int32(px), np.int32(W - 2)), min(np.int32(py), np.int32(H - 2))
            ax, ay = px - f32(x0), py - f32(y0)
            zb = _depth_at(flat_depth, W, ax, ay, np.uint64(y0 * W + x0), m.depth_band)
            below, beside = np.int32(ay >= f32(0.5)), np.int32(ax >= f32(0.5))
            near = flat_range[np.uint64((y0 + below) * W + x0 + beside)]
            if not zb > f32(0):
                status[i] = NO_DEPTH
                zb = f32(1)
            else:
                status[i] = VALID if x.fb_error[v, u] < m.fb_px else FB_INCONSISTENT
        s[NX + i], s[NY + i], s[ZA + i], s[ZB + i], s[VB + i] = px, py, za, zb, near


@jit
def gather(v: int, u0: int, stride: int, x: Inputs, s: Float32, status: UInt8) -> None:
    """Matches of pixels u0, u0 + stride, ... of image row v: GATHERED planes into ``s``, why-not into ``status`` (n,).

    Where a pixel has depth at both ends and its match is in view, the planes are right even if the gate fails.
    """
    _look_up(v, u0, stride, x, s, status)
    camera, m = x.camera, x.model
    inv_fx, inv_fy = f32(1) / camera.fx, f32(1) / camera.fy
    ixx, ixy, iyy = inv_fx * inv_fx, inv_fx * inv_fy, inv_fy * inv_fy
    for i in range(status.shape[0]):
        u = u0 + i * stride
        s[NX + i] = (s[NX + i] - camera.cx) * inv_fx
        s[NY + i] = (s[NY + i] - camera.cy) * inv_fy
        da, db = s[ZA + i] - m.z_z0, s[ZB + i] - m.z_z0
        sa, ea = m.z_a + m.z_b * da * da, m.edge_inflation * x.range_first[v, u]
        sb, eb = m.z_a + m.z_b * db * db, m.edge_inflation * s[VB + i]
        s[VA + i] = sa * sa + ea * ea
        s[VB + i] = sb * sb + eb * eb
        # lateral noise, round trip, displacement: isotropic; then what the image's texture leaves open
        wx, wy, fb = x.forward[v, u, 0], x.forward[v, u, 1], x.fb_error[v, u]
        same = m.var_px_second + m.fb_variance * fb * fb + m.var_displacement * (wx * wx + wy * wy)
        s[CXX + i] = (same + x.flow_covariance[0, v, u]) * ixx
        s[CXY + i] = x.flow_covariance[1, v, u] * ixy
        s[CYY + i] = (same + x.flow_covariance[2, v, u]) * iyy


@jit
def sheared(match: Any, nax: Any, nay: Any, T: Any, lateral: Any, m: Model) -> Any:
    """Residual (3) and Sigma_m (6) of one gathered match in the sheared frame of camera b.

    ``match`` (9) holds its gathered values, (nax, nay) is the ray of u. T (12) is R row by row, then t: the first
    camera in the second. ``lateral`` (6) is sigma_px^2 (r1 r1^T / fx^2 + r2 r2^T / fy^2) of endpoint a, r1 and r2 the
    first columns of R.
    """
    nx, ny, za, zb, va, vb, cxx, cxy, cyy = match
    # d p / d z_a: the ray of u, turned into camera b
    wx = T[0] * nax + T[1] * nay + T[2]
    wy = T[3] * nax + T[4] * nay + T[5]
    wz = T[6] * nax + T[7] * nay + T[8]
    px, py, pz = za * wx + T[9], za * wy + T[10], za * wz + T[11]
    rx, ry, rz = nx * pz - px, ny * pz - py, zb - pz
    wx -= nx * wz
    wy -= ny * wz
    lxx, lxy, lxz, lyy, lyz, lzz = lateral
    z2 = za * za
    # S L S^T with S = [[1, 0, -nx], [0, 1, -ny], [0, 0, 1]]
    exz, eyz = lxz - nx * lzz, lyz - ny * lzz
    exx = lxx - nx * lxz - nx * exz
    exy = lxy - ny * lxz - nx * eyz
    eyy = lyy - ny * lyz - ny * eyz
    zb2 = zb * zb
    sxx = z2 * exx + va * wx * wx + zb2 * cxx
    sxy = z2 * exy + va * wx * wy + zb2 * cxy
    sxz = z2 * exz + va * wx * wz
    syy = z2 * eyy + va * wy * wy + zb2 * cyy
    syz = z2 * eyz + va * wy * wz
    szz = z2 * lzz + va * wz * wz + vb
    # Uncertain pose (ego off): var_t I + var_r (|p|^2 I - p p^T), sheared
    iso = m.var_translation + m.var_rotation * (px * px + py * py + pz * pz)
    sxx += iso * (f32(1) + nx * nx) - m.var_rotation * rx * rx
    sxy += iso * nx * ny - m.var_rotation * rx * ry
    sxz += -iso * nx + m.var_rotation * rx * pz
    syy += iso * (f32(1) + ny * ny) - m.var_rotation * ry * ry
    syz += -iso * ny + m.var_rotation * ry * pz
    szz += iso - m.var_rotation * pz * pz
    return rx, ry, rz, sxx, sxy, sxz, syy, syz, szz


@jit
def transform(rows: Float32, v: int) -> Any:
    """One row's transform as twelve scalars, which the compiler keeps in registers."""
    T = rows[v]
    return T[0], T[1], T[2], T[3], T[4], T[5], T[6], T[7], T[8], T[9], T[10], T[11]


@jit
def lateral_of(T: Any, camera: Camera, m: Model) -> Any:
    """sigma_px^2 (r1 r1^T / fx^2 + r2 r2^T / fy^2): endpoint a's lateral noise at one metre, in camera b."""
    a, b = m.var_px_first / (camera.fx * camera.fx), m.var_px_first / (camera.fy * camera.fy)
    return (
        a * T[0] * T[0] + b * T[1] * T[1],
        a * T[0] * T[3] + b * T[1] * T[4],
        a * T[0] * T[6] + b * T[1] * T[7],
        a * T[3] * T[3] + b * T[4] * T[4],
        a * T[3] * T[6] + b * T[4] * T[7],
        a * T[6] * T[6] + b * T[7] * T[7],
    )


@jit
def _match(s: Float32, i: int) -> Any:
    """The gathered values of one match."""
    return (
        s[NX + i],
        s[NY + i],
        s[ZA + i],
        s[ZB + i],
        s[VA + i],
        s[VB + i],
        s[CXX + i],
        s[CXY + i],
        s[CYY + i],
    )


@jit
def measure(
    x: Inputs,
    rows: Float32,
    R_world_b: Float32,
    p_table: Float32,
    residual: Float32,
    d_m: Float32,
    p_stat: Float32,
    validity: UInt8,
) -> None:
    """The whole motion channel of a pair: residual in the world frame, d_M, p_stat, validity.

    ``rows`` (H, 12) is, for each row of the first image, the first camera in the second (R, then t).
    """
    H, W = x.depth_first.shape
    s = np.empty(PLANES * BLOCK, np.float32)
    a, b, c = R_world_b[0], R_world_b[1], R_world_b[2]
    world = (a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2])
    hide = x.model.occlusion_sigma > f32(0)
    for v in range(H):
        T = transform(rows, v)
        lateral = lateral_of(T, x.camera, x.model)
        for u0 in range(0, W, BLOCK):
            n = min(BLOCK, W - u0)
            status = validity[v, u0 : u0 + n]
            gather(v, u0, 1, x, s, status)
            score(s, n, u0, v, T, lateral, world, x.camera, x.model)
            if hide:
                for i in range(n):
                    if s[BEHIND + i] > f32(0) and (status[i] == VALID or status[i] == FB_INCONSISTENT):
                        status[i] = OCCLUDED
            for i in range(n):
                if status[i] == VALID and s[DM + i] != s[DM + i]:
                    status[i] = OUT_OF_RANGE
            # one array a loop: each is then free to vectorise
            _masked(s, DM, status, d_m[v, u0 : u0 + n])
            _masked(s, MX, status, residual[0, v, u0 : u0 + n])
            _masked(s, MY, status, residual[1, v, u0 : u0 + n])
            _masked(s, MZ, status, residual[2, v, u0 : u0 + n])
            _tails(s, status, p_table, p_stat[v, u0 : u0 + n])


@jit
def _tails(s: Float32, status: UInt8, p_table: Float32, out: Float32) -> None:
    """p_stat of a block's d_M by linear look-up; NaN where the pixel is not valid."""
    per_step, last = f32((P_TABLE_SIZE - 1) / P_TABLE_MAX), f32(P_TABLE_SIZE - 2)
    for i in range(status.shape[0]):
        at = s[DM + i] * s[DM + i] * per_step
        at = at if at < last else last  # NaN too
        k = np.uint32(at)
        low = p_table[k]
        out[i] = low + (at - f32(k)) * (p_table[k + np.uint32(1)] - low) if status[i] == VALID else f32(np.nan)


@jit
def _masked(s: Float32, plane: int, status: UInt8, out: Float32) -> None:
    """One scored plane, NaN where the pixel is not valid."""
    for i in range(status.shape[0]):
        out[i] = s[plane + i] if status[i] == VALID else f32(np.nan)


@jit
def score(s: Float32, n: int, u0: int, v: int, T: Any, lateral: Any, world: Any, camera: Camera, m: Model) -> None:
    """From a block's gathered planes its scored ones: d_M, residual in the world, distance behind."""
    nay = (f32(v) - camera.cy) / camera.fy
    inv_fx = f32(1) / camera.fx
    sigmas2, least2 = m.occlusion_sigma * m.occlusion_sigma, m.occlusion_m * m.occlusion_m
    for i in range(n):
        nax = (f32(u0 + i) - camera.cx) * inv_fx
        nx, ny = s[NX + i], s[NY + i]
        rx, ry, rz, sxx, sxy, sxz, syy, syz, szz = sheared(_match(s, i), nax, nay, T, lateral, m)
        # adjugate of Sigma
        axx, axy, axz = syy * szz - syz * syz, sxz * syz - sxy * szz, sxy * syz - sxz * syy
        ayy, ayz, azz = sxx * szz - sxz * sxz, sxy * sxz - sxx * syz, sxx * syy - sxy * sxy
        det = sxx * axx + sxy * axy + sxz * axz
        quad = rx * (axx * rx + f32(2) * (axy * ry + axz * rz))
        quad += ry * (ayy * ry + f32(2) * ayz * rz) + azz * rz * rz
        weighed = det >= LEAST and det <= MOST and abs(quad) <= MOST
        s[DM + i] = math.sqrt(max(quad / det, f32(0))) if weighed else f32(np.nan)
        nearer = max(-rz, f32(0))  # the match lies this far before its prediction
        s[BEHIND + i] = nearer * nearer - max(sigmas2 * szz, least2)
        # out of the shear, then into the world
        rx += nx * rz
        ry += ny * rz
        s[MX + i] = world[0] * rx + world[1] * ry + world[2] * rz
        s[MY + i] = world[3] * rx + world[4] * ry + world[5] * rz
        s[MZ + i] = world[6] * rx + world[7] * ry + world[8] * rz


@jit
def sigma_m(
    stride: int, x: Inputs, rows: Float32, R_world_b: Float32, validity: UInt8, upper: Float32, sigma_z: Float32
) -> None:
    """Sigma_m in the world frame and its standard deviation along b's optical axis, every ``stride`` pixels."""
    h, w = sigma_z.shape
    camera, m = x.camera, x.model
    s = np.empty(PLANES * BLOCK, np.float32)
    status = np.empty(BLOCK, np.uint8)
    inv_fx = f32(1) / camera.fx
    for j in range(h):
        v = j * stride
        T = transform(rows, v)
        lateral = lateral_of(T, camera, m)
        nay = (f32(v) - camera.cy) / camera.fy
        for i0 in range(0, w, BLOCK):
            n = min(BLOCK, w - i0)
            u0 = i0 * stride
            gather(v, u0, stride, x, s, status[:n])
            for i in range(n):
                u = u0 + i * stride
                if validity[v, u] != VALID:
                    sigma_z[j, i0 + i] = f32(np.nan)
                    upper[:, j, i0 + i] = f32(np.nan)
                    continue
                nx, ny = s[NX + i], s[NY + i]
                nax = (f32(u) - camera.cx) * inv_fx
                _, _, _, sxx, sxy, sxz, syy, syz, szz = sheared(_match(s, i), nax, nay, T, lateral, m)
                sigma_z[j, i0 + i] = math.sqrt(szz)
                # undo the shear: S^-1 Sigma S^-T
                xz, yz = sxz + nx * szz, syz + ny * szz
                xx, xy = sxx + nx * sxz + nx * xz, sxy + ny * sxz + nx * yz
                yy = syy + ny * syz + ny * yz
                k = 0
                for a in range(3):  # the upper triangle of R S R^T
                    ra, rb, rc = R_world_b[a, 0], R_world_b[a, 1], R_world_b[a, 2]
                    mx, my, mz = ra * xx + rb * xy + rc * xz, ra * xy + rb * yy + rc * yz, ra * xz + rb * yz + rc * szz
                    for b in range(a, 3):
                        upper[k, j, i0 + i] = mx * R_world_b[b, 0] + my * R_world_b[b, 1] + mz * R_world_b[b, 2]
                        k += 1


@jit
def gather_grid(stride: int, x: Inputs, planes: Float32, status: UInt8) -> None:
    """The gathered planes (GATHERED, h, w) and status (h, w) of every ``stride``-th row and column."""
    h, w = status.shape
    s = np.empty(PLANES * BLOCK, np.float32)
    for j in range(h):
        for i0 in range(0, w, BLOCK):
            n = min(BLOCK, w - i0)
            gather(j * stride, i0 * stride, stride, x, s, status[j, i0 : i0 + n])
            for plane in range(GATHERED):
                for i in range(n):
                    planes[plane, j, i0 + i] = s[plane * BLOCK + i]


@jit
def inverse_covariances(
    g: Float32, rays: Float32, row: Int32, rows: Float32, camera: Camera, m: Model, out: Float32
) -> None:
    """Sigma_m^-1 of each match in camera b into out (6, N): xx, xy, xz, yy, yz, zz, 1/m^2.

    g (GATHERED, N) matches in the kernels' order of planes, rays (2, N) of camera a, row (N) index into rows (h, 12).
    """
    if not row.size:
        return
    last = row[0]
    T = transform(rows, last)
    lateral = lateral_of(T, camera, m)
    for i in range(g.shape[1]):
        if row[i] != last:
            last = row[i]
            T = transform(rows, last)
            lateral = lateral_of(T, camera, m)
        nx, ny = g[0, i], g[1, i]
        match = (nx, ny, g[2, i], g[3, i], g[4, i], g[5, i], g[6, i], g[7, i], g[8, i])
        _, _, _, sxx, sxy, sxz, syy, syz, szz = sheared(match, rays[0, i], rays[1, i], T, lateral, m)
        axx, axy, axz = syy * szz - syz * syz, sxz * syz - sxy * szz, sxy * syz - sxz * syy
        ayy, ayz, azz = sxx * szz - sxz * sxz, sxy * sxz - sxx * syz, sxx * syy - sxy * sxy
        det = sxx * axx + sxy * axy + sxz * axz
        inv = f32(1) / det if det >= LEAST and det <= MOST else f32(np.nan)
        # S^T A S
        bxz = axz - nx * axx - ny * axy
        byz = ayz - nx * axy - ny * ayy
        out[0, i] = inv * axx
        out[1, i] = inv * axy
        out[2, i] = inv * bxz
        out[3, i] = inv * ayy
        out[4, i] = inv * byz
        out[5, i] = inv * (azz - nx * axz - ny * ayz - nx * bxz - ny * byz)
