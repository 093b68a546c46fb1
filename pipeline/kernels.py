"""The numeric kernels, compiled by numba: planar float32, a gather pass and a SIMD pass a row.

Sigma_m and d_M are computed in a sheared frame of camera b in which the viewing ray of u' is e3. The
shear S is invertible and linear, so that d_M is unchanged by it, and endpoint b's covariance becomes
diag(z_b^2 C, sigma_zb^2) with C the 2x2 lateral covariance in normalised image units. The textbook form
in float64 stands in ``tests/textbook.py``.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numba
import numpy as np

from vlmm_log.types import Float32, UInt8

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


# Planes of a gathered row, one value a pixel.
NX, NY = 0, 1  # u' as a normalised ray (x / z, y / z) of camera b
ZA, ZB = 2, 3  # depth at both ends, m
VA, VB = 4, 5  # variance of the depth at both ends, m^2
CXX, CXY, CYY = 6, 7, 8  # lateral covariance at b in normalised image units
PLANES = 9

VALID, NO_DEPTH, OUT_OF_VIEW, FB_INCONSISTENT, OCCLUDED = 0, 1, 2, 3, 4  # types.Validity, as numba wants it

P_TABLE_SIZE = 8192
P_TABLE_MAX = 48.0  # d_M^2 beyond it: p_stat below 3e-10, written as 0


def p_stat_table() -> Float32:
    """Tail probability of chi-square with 3 degrees of freedom at 0 .. P_TABLE_MAX in d_M^2, for linear look-up."""
    d2 = np.linspace(0.0, P_TABLE_MAX, P_TABLE_SIZE)
    tail = [math.erfc(math.sqrt(x / 2)) + math.sqrt(2 * x / math.pi) * math.exp(-x / 2) for x in d2]
    return np.array(tail, np.float32)


jit = numba.njit(cache=True, fastmath={"contract", "nsz", "arcp", "reassoc"}, error_model="numpy", nogil=True)


@jit
def round_trip(forward: Float32, backward: Float32, fb_error: Float32) -> None:
    """|w_ab(u) + w_ba(u + w_ab(u))| px into fb_error, w_ba bilinear; NaN where u + w_ab(u) is out of view."""
    H, W = fb_error.shape
    right, bottom = f32(W - 1), f32(H - 1)
    for v in range(H):
        for u in range(W):
            wx, wy = forward[v, u, 0], forward[v, u, 1]
            x, y = f32(u) + wx, f32(v) + wy
            if not (x >= f32(0) and y >= f32(0) and x <= right and y <= bottom):
                fb_error[v, u] = f32(np.nan)
                continue
            x0, y0 = min(np.int32(x), W - 2), min(np.int32(y), H - 2)
            ax, ay = x - f32(x0), y - f32(y0)
            w00, w10 = (f32(1) - ax) * (f32(1) - ay), ax * (f32(1) - ay)
            w01, w11 = (f32(1) - ax) * ay, ax * ay
            ex, ey = wx, wy
            ex += w00 * backward[y0, x0, 0] + w10 * backward[y0, x0 + 1, 0]
            ex += w01 * backward[y0 + 1, x0, 0] + w11 * backward[y0 + 1, x0 + 1, 0]
            ey += w00 * backward[y0, x0, 1] + w10 * backward[y0, x0 + 1, 1]
            ey += w01 * backward[y0 + 1, x0, 1] + w11 * backward[y0 + 1, x0 + 1, 1]
            fb_error[v, u] = math.sqrt(ex * ex + ey * ey)


@jit
def flow_covariance(
    tensor: Float32, spread: Float32, var_texture: np.float32, floor: np.float32, ridge: np.float32, out: Float32
) -> None:
    """Flow covariance (3, H, W) px^2, xx, xy, yy: ``var_texture (max(G - floor, 0) + ridge I)^-1 + spread I``.

    G (3, H, W) is the structure tensor, of which ``floor`` along either axis is sensor noise and no texture.
    """
    half = f32(0.5)
    for v in range(spread.shape[0]):
        for u in range(spread.shape[1]):
            gxx, gxy, gyy = tensor[0, v, u], tensor[1, v, u], tensor[2, v, u]
            mean, dx = half * (gxx + gyy), half * (gxx - gyy)
            radius = math.sqrt(dx * dx + gxy * gxy)
            # variances along the axes of most and of least texture
            most = var_texture / (max(mean + radius - floor, f32(0)) + ridge)
            least = var_texture / (max(mean - radius - floor, f32(0)) + ridge)
            turn = half * (most - least) / max(radius, f32(1e-6))
            middle = half * (most + least) + spread[v, u]
            out[0, v, u] = middle + turn * dx
            out[1, v, u] = turn * gxy
            out[2, v, u] = middle - turn * dx


@jit
def _depth_at(depth: Float32, x: np.float32, y: np.float32, x0: int, y0: int, band: np.float32) -> Any:
    """Bilinear over the neighbours within ``band * z`` of the nearest one; NaN where that one is unseen."""
    right, below = x - f32(x0) >= f32(0.5), y - f32(y0) >= f32(0.5)
    z00, z10 = depth[y0, x0], depth[y0, x0 + 1]
    z01, z11 = depth[y0 + 1, x0], depth[y0 + 1, x0 + 1]
    nearest = (z11 if right else z01) if below else (z10 if right else z00)
    width = band * nearest
    ax, ay = x - f32(x0), y - f32(y0)
    total, weight = f32(0), f32(0)
    if abs(z00 - nearest) <= width:
        w = (f32(1) - ax) * (f32(1) - ay)
        total += w * z00
        weight += w
    if abs(z10 - nearest) <= width:
        w = ax * (f32(1) - ay)
        total += w * z10
        weight += w
    if abs(z01 - nearest) <= width:
        w = (f32(1) - ax) * ay
        total += w * z01
        weight += w
    if abs(z11 - nearest) <= width:
        w = ax * ay
        total += w * z11
        weight += w
    return total / weight  # 0 / 0 is NaN where the nearest is


@jit
def gather_row(
    v: int,
    stride: int,
    depth_a: Float32,
    depth_b: Float32,
    range_a: Float32,
    range_b: Float32,
    forward: Float32,
    fb_error: Float32,
    flow_cov: Float32,
    camera: Camera,
    m: Model,
    out: Float32,
    status: UInt8,
) -> None:
    """Gate and look up one image row at every ``stride``-th column: PLANES rows of ``out``, why-not into ``status``.

    Where a pixel has depth at a and its match is in view, the planes are filled even if the gate fails.
    """
    H, W = depth_a.shape
    right, bottom = f32(W - 1), f32(H - 1)
    inv_fx, inv_fy = f32(1) / camera.fx, f32(1) / camera.fy
    for i in range(out.shape[1]):
        u = i * stride
        za = depth_a[v, u]
        x, y = f32(u) + forward[v, u, 0], f32(v) + forward[v, u, 1]
        # Everything below is finite for the SIMD pass, whatever the status.
        for plane in range(PLANES):
            out[plane, i] = f32(1)
        if not za > f32(0):
            status[i] = NO_DEPTH
            continue
        if not (x >= f32(0) and y >= f32(0) and x <= right and y <= bottom):
            status[i] = OUT_OF_VIEW
            continue
        x0, y0 = min(np.int32(x), W - 2), min(np.int32(y), H - 2)
        zb = _depth_at(depth_b, x, y, x0, y0, m.depth_band)
        if not zb > f32(0):
            status[i] = NO_DEPTH
            continue
        fb = fb_error[v, u]
        status[i] = VALID if fb < m.fb_px else FB_INCONSISTENT
        out[NX, i] = (x - camera.cx) * inv_fx
        out[NY, i] = (y - camera.cy) * inv_fy
        out[ZA, i] = za
        out[ZB, i] = zb
        da, db = za - m.z_z0, zb - m.z_z0
        sa, ea = m.z_a + m.z_b * da * da, m.edge_inflation * range_a[v, u]
        yb, xb = np.int32(y + f32(0.5)), np.int32(x + f32(0.5))
        sb, eb = m.z_a + m.z_b * db * db, m.edge_inflation * range_b[yb, xb]
        out[VA, i] = sa * sa + ea * ea
        out[VB, i] = sb * sb + eb * eb
        # lateral noise, round trip, displacement: isotropic; then what the image's texture leaves open
        moved2 = forward[v, u, 0] * forward[v, u, 0] + forward[v, u, 1] * forward[v, u, 1]
        same = m.var_px_second + m.fb_variance * fb * fb + m.var_displacement * moved2
        out[CXX, i] = (same + flow_cov[0, v, u]) * inv_fx * inv_fx
        out[CXY, i] = flow_cov[1, v, u] * inv_fx * inv_fy
        out[CYY, i] = (same + flow_cov[2, v, u]) * inv_fy * inv_fy


@jit
def sheared(g: Float32, i: int, nax: Any, nay: Any, T: Float32, lateral: Any, m: Model) -> Any:
    """Residual (3) and Sigma_m (6) of one gathered match in the sheared frame of camera b, and the point p.

    T (12) is R row by row, then t: the first camera in the second. ``lateral`` (6) is
    sigma_px^2 (r1 r1^T / fx^2 + r2 r2^T / fy^2) of endpoint a, r1 and r2 the first columns of R.
    """
    nx, ny, za, zb = g[NX, i], g[NY, i], g[ZA, i], g[ZB, i]
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
    va = g[VA, i]
    # S L S^T with S = [[1, 0, -nx], [0, 1, -ny], [0, 0, 1]]
    exz, eyz = lxz - nx * lzz, lyz - ny * lzz
    exx = lxx - nx * lxz - nx * exz
    exy = lxy - ny * lxz - nx * eyz
    eyy = lyy - ny * lyz - ny * eyz
    zb2 = zb * zb
    sxx = z2 * exx + va * wx * wx + zb2 * g[CXX, i]
    sxy = z2 * exy + va * wx * wy + zb2 * g[CXY, i]
    sxz = z2 * exz + va * wx * wz
    syy = z2 * eyy + va * wy * wy + zb2 * g[CYY, i]
    syz = z2 * eyz + va * wy * wz
    szz = z2 * lzz + va * wz * wz + g[VB, i]
    # Uncertain pose (ego off): var_t I + var_r (|p|^2 I - p p^T), sheared
    iso = m.var_translation + m.var_rotation * (px * px + py * py + pz * pz)
    sxx += iso * (f32(1) + nx * nx) - m.var_rotation * rx * rx
    sxy += iso * nx * ny - m.var_rotation * rx * ry
    sxz += -iso * nx + m.var_rotation * rx * pz
    syy += iso * (f32(1) + ny * ny) - m.var_rotation * ry * ry
    syz += -iso * ny + m.var_rotation * ry * pz
    szz += iso - m.var_rotation * pz * pz
    return rx, ry, rz, sxx, sxy, sxz, syy, syz, szz, px, py, pz


@jit
def lateral_of(T: Float32, camera: Camera, m: Model) -> Any:
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
def measure(
    depth_a: Float32,
    depth_b: Float32,
    range_a: Float32,
    range_b: Float32,
    forward: Float32,
    fb_error: Float32,
    flow_cov: Float32,
    camera: Camera,
    m: Model,
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
    H, W = depth_a.shape
    g = np.empty((PLANES, W), np.float32)
    nax = np.empty(W, np.float32)
    for u in range(W):
        nax[u] = (f32(u) - camera.cx) / camera.fx
    nan = f32(np.nan)
    per_step = f32((P_TABLE_SIZE - 1) / P_TABLE_MAX)
    w00, w01, w02 = R_world_b[0, 0], R_world_b[0, 1], R_world_b[0, 2]
    w10, w11, w12 = R_world_b[1, 0], R_world_b[1, 1], R_world_b[1, 2]
    w20, w21, w22 = R_world_b[2, 0], R_world_b[2, 1], R_world_b[2, 2]
    behind = np.empty(W, np.float32)
    for v in range(H):
        status = validity[v]
        gather_row(v, 1, depth_a, depth_b, range_a, range_b, forward, fb_error, flow_cov, camera, m, g, status)
        T = rows[v]
        nay = (f32(v) - camera.cy) / camera.fy
        lateral = lateral_of(T, camera, m)
        out_x, out_y, out_z, out_d = residual[0, v], residual[1, v], residual[2, v], d_m[v]
        for u in range(W):
            rx, ry, rz, sxx, sxy, sxz, syy, syz, szz, _, _, _ = sheared(g, u, nax[u], nay, T, lateral, m)
            # adjugate of Sigma
            axx, axy, axz = syy * szz - syz * syz, sxz * syz - sxy * szz, sxy * syz - sxz * syy
            ayy, ayz, azz = sxx * szz - sxz * sxz, sxy * sxz - sxx * syz, sxx * syy - sxy * sxy
            det = sxx * axx + sxy * axy + sxz * axz
            quad = (
                rx * (axx * rx + f32(2) * (axy * ry + axz * rz)) + ry * (ayy * ry + f32(2) * ayz * rz) + azz * rz * rz
            )
            out_d[u] = math.sqrt(max(quad / det, f32(0)))
            # out of the shear, then into the world
            rx += g[NX, u] * rz
            ry += g[NY, u] * rz
            out_x[u] = w00 * rx + w01 * ry + w02 * rz
            out_y[u] = w10 * rx + w11 * ry + w12 * rz
            out_z[u] = w20 * rx + w21 * ry + w22 * rz
            # how far p lies behind the measured surface, beyond what sigma and the least distance allow
            behind[u] = -rz - max(m.occlusion_sigma * math.sqrt(szz), m.occlusion_m)
        hide = m.occlusion_sigma > f32(0)
        out_p = p_stat[v]
        for u in range(W):
            if hide and behind[u] > f32(0) and (status[u] == VALID or status[u] == FB_INCONSISTENT):
                status[u] = OCCLUDED
            if status[u] != VALID:
                out_d[u] = nan
                out_x[u] = nan
                out_y[u] = nan
                out_z[u] = nan
                out_p[u] = nan
                continue
            at = out_d[u] * out_d[u] * per_step
            if at < f32(P_TABLE_SIZE - 1):
                k = np.int32(at)
                share = at - f32(k)
                out_p[u] = p_table[k] + share * (p_table[k + 1] - p_table[k])
            else:
                out_p[u] = f32(0)


@jit
def sigma_m(
    stride: int,
    depth_a: Float32,
    depth_b: Float32,
    range_a: Float32,
    range_b: Float32,
    forward: Float32,
    fb_error: Float32,
    flow_cov: Float32,
    camera: Camera,
    m: Model,
    rows: Float32,
    R_world_b: Float32,
    validity: UInt8,
    upper: Float32,
    sigma_z: Float32,
) -> None:
    """Sigma_m in the world frame and its standard deviation along b's optical axis, every ``stride`` pixels."""
    h, w = sigma_z.shape
    g = np.empty((PLANES, w), np.float32)
    status = np.empty(w, np.uint8)
    S = np.empty((3, 3), np.float32)
    for j in range(h):
        v = j * stride
        gather_row(v, stride, depth_a, depth_b, range_a, range_b, forward, fb_error, flow_cov, camera, m, g, status)
        T = rows[v]
        nay = (f32(v) - camera.cy) / camera.fy
        lateral = lateral_of(T, camera, m)
        for i in range(w):
            if validity[v, i * stride] != VALID:
                sigma_z[j, i] = f32(np.nan)
                upper[:, j, i] = f32(np.nan)
                continue
            nax = (f32(i * stride) - camera.cx) / camera.fx
            _, _, _, sxx, sxy, sxz, syy, syz, szz, _, _, _ = sheared(g, i, nax, nay, T, lateral, m)
            sigma_z[j, i] = math.sqrt(szz)
            nx, ny = g[NX, i], g[NY, i]
            # undo the shear: S^-1 Sigma S^-T
            S[0, 2] = sxz + nx * szz
            S[1, 2] = syz + ny * szz
            S[0, 0] = sxx + nx * sxz + nx * S[0, 2]
            S[0, 1] = sxy + ny * sxz + nx * S[1, 2]
            S[1, 1] = syy + ny * syz + ny * S[1, 2]
            S[2, 2] = szz
            S[1, 0], S[2, 0], S[2, 1] = S[0, 1], S[0, 2], S[1, 2]
            k = 0
            for a in range(3):
                for b in range(a, 3):
                    total = f32(0)
                    for c in range(3):
                        for d in range(3):
                            total += R_world_b[a, c] * S[c, d] * R_world_b[b, d]
                    upper[k, j, i] = total
                    k += 1


@jit
def gather_grid(
    stride: int,
    depth_a: Float32,
    depth_b: Float32,
    range_a: Float32,
    range_b: Float32,
    forward: Float32,
    fb_error: Float32,
    flow_cov: Float32,
    camera: Camera,
    m: Model,
    planes: Float32,
    status: UInt8,
) -> None:
    """The gathered planes (PLANES, h, w) and status (h, w) of every ``stride``-th row and column."""
    for j in range(status.shape[0]):
        gather_row(
            j * stride,
            stride,
            depth_a,
            depth_b,
            range_a,
            range_b,
            forward,
            fb_error,
            flow_cov,
            camera,
            m,
            planes[:, j],
            status[j],
        )
