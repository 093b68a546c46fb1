"""Kernels of ego-refinement: transforms of image rows, MSAC scores, normal equations."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from vlmm_log.compiled import jit
from vlmm_log.types import Float32, Float64

f32, f64 = np.float32, np.float64
FAR = f32(2.0**100)  # d_M^2 of a match that single precision cannot weigh: no inlier, and its sums stay finite
LOST = f32(-1)  # less is no rounding: an inverse that is not positive
Int32 = NDArray[np.int32]


@jit
def moved(T: Float64, twist: Float64, share: Float64, out: Float64) -> None:
    """exp(share[i] twist) @ T of motions (4, 4) into out (n, 4, 4), which is zeros: ``se3.exp``, share by share."""
    x, y, z = twist[0], twist[1], twist[2]
    a, b, c = twist[3], twist[4], twist[5]
    E = np.empty((3, 4))
    for i in range(share.size):
        s = share[i]
        angle2 = s * s * (x * x + y * y + z * z)
        if angle2 < 1e-12:
            p, q, r = 1.0 - angle2 / 6.0, 0.5 - angle2 / 24.0, 1.0 / 6.0
        else:
            angle = math.sqrt(angle2)
            p, q = math.sin(angle) / angle, (1.0 - math.cos(angle)) / angle2
            r = (angle - math.sin(angle)) / (angle2 * angle)
        wx, wy, wz = s * x, s * y, s * z
        xx, xy, xz = -wy * wy - wz * wz, wx * wy, wx * wz  # of the squared cross product matrix
        yy, yz, zz = -wx * wx - wz * wz, wy * wz, -wx * wx - wy * wy
        E[0, 0], E[0, 1], E[0, 2] = 1.0 + q * xx, q * xy - p * wz, q * xz + p * wy
        E[1, 0], E[1, 1], E[1, 2] = q * xy + p * wz, 1.0 + q * yy, q * yz - p * wx
        E[2, 0], E[2, 1], E[2, 2] = q * xz - p * wy, q * yz + p * wx, 1.0 + q * zz
        ta, tb, tc = s * a, s * b, s * c
        E[0, 3] = (1.0 + r * xx) * ta + (r * xy - q * wz) * tb + (r * xz + q * wy) * tc
        E[1, 3] = (r * xy + q * wz) * ta + (1.0 + r * yy) * tb + (r * yz - q * wx) * tc
        E[2, 3] = (r * xz - q * wy) * ta + (r * yz + q * wx) * tb + (1.0 + r * zz) * tc
        for j in range(3):
            for k in range(4):
                out[i, j, k] = E[j, 0] * T[0, k] + E[j, 1] * T[1, k] + E[j, 2] * T[2, k] + E[j, 3] * T[3, k]
        out[i, 3, 3] = 1.0


@jit
def points(g: Float32, rays: Float32, first: Float32, second: Float32) -> None:
    """Matched points (3, N) m of both cameras, each in its own frame."""
    for i in range(g.shape[1]):
        za, zb = g[2, i], g[3, i]
        first[0, i], first[1, i], first[2, i] = za * rays[0, i], za * rays[1, i], za
        second[0, i], second[1, i], second[2, i] = zb * g[0, i], zb * g[1, i], zb


@jit
def msac(
    hypotheses: Float32, first: Float32, second: Float32, inverse: Float32, cut: np.float32, cost: Float32
) -> None:
    """Sum over matches of min(d_M^2, cut) for each hypothesis (12, n). Torr and Zisserman 2000."""
    T = hypotheses
    cost[:] = 0
    for i in range(first.shape[1]):
        a, b, c = first[0, i], first[1, i], first[2, i]
        x, y, z = second[0, i], second[1, i], second[2, i]
        xx, xy, xz = inverse[0, i], inverse[1, i], inverse[2, i]
        yy, yz, zz = inverse[3, i], inverse[4, i], inverse[5, i]
        for k in range(cost.size):  # side by side: each one's sum is in the order of the matches
            rx = x - (T[0, k] * a + T[1, k] * b + T[2, k] * c + T[9, k])
            ry = y - (T[3, k] * a + T[4, k] * b + T[5, k] * c + T[10, k])
            rz = z - (T[6, k] * a + T[7, k] * b + T[8, k] * c + T[11, k])
            q = rx * (xx * rx + f32(2) * (xy * ry + xz * rz))
            q += ry * (yy * ry + f32(2) * yz * rz) + zz * rz * rz
            cost[k] += q if q > LOST and q < cut else cut


@jit
def whitened(first: Float32, second: Float32, inverse: Float32, row: Int32, rows: Float32, d2: Float32) -> None:
    """d_M^2 of each match under the transforms ``rows`` (h, 12) of its image row; at most FAR."""
    for i in range(first.shape[1]):
        T = rows[row[i]]
        a, b, c = first[0, i], first[1, i], first[2, i]
        rx = second[0, i] - (T[0] * a + T[1] * b + T[2] * c + T[9])
        ry = second[1, i] - (T[3] * a + T[4] * b + T[5] * c + T[10])
        rz = second[2, i] - (T[6] * a + T[7] * b + T[8] * c + T[11])
        q = rx * (inverse[0, i] * rx + f32(2) * (inverse[1, i] * ry + inverse[2, i] * rz))
        q = q + ry * (inverse[3, i] * ry + f32(2) * inverse[4, i] * rz) + inverse[5, i] * rz * rz
        d2[i] = q if q > LOST and q <= FAR else FAR  # NaN too


@jit
def normal_equations(
    first: Float32,
    second: Float32,
    inverse: Float32,
    d2: Float32,
    cut: np.float32,
    biweight: bool,
    row: Int32,
    rows: Float32,
    share: Float64,
    moments: Float64,
    gradients: Float64,
) -> None:
    """Gauss-Newton's sums over matches for p' = exp(xi0 + r xi1) p, r = share[row].

    Inliers, d2 < cut, weigh by Tukey's biweight, or all alike; others nothing.
    moments (3, 6, 6) is sum r^k J^T W J, gradients (2, 6) is sum r^k J^T W (X_b - p'), J = [-[p']x, I].
    """
    moments[:] = 0.0
    gradients[:] = 0.0
    n = first.shape[1]
    i = 0
    while i < n:  # row after row: its sums are scaled once
        here = row[i]
        r, T = share[here], rows[here]
        b00 = b01 = b02 = b03 = b04 = b05 = b11 = b12 = b13 = b14 = b15 = 0.0  # J^T W J, rows of its upper triangle
        b22 = b23 = b24 = b25 = b33 = b34 = b35 = b44 = b45 = b55 = 0.0
        s0 = s1 = s2 = s3 = s4 = s5 = 0.0
        while i < n and row[i] == here:
            d = d2[i] / cut
            if not d < f32(1):
                i += 1
                continue
            w = (f32(1) - d) * (f32(1) - d) if biweight else f32(1)
            a, b, c = first[0, i], first[1, i], first[2, i]
            qx = T[0] * a + T[1] * b + T[2] * c + T[9]
            qy = T[3] * a + T[4] * b + T[5] * c + T[10]
            qz = T[6] * a + T[7] * b + T[8] * c + T[11]
            rx, ry, rz = f64(second[0, i] - qx), f64(second[1, i] - qy), f64(second[2, i] - qz)
            px, py, pz = f64(qx), f64(qy), f64(qz)
            xx, xy, xz = f64(w * inverse[0, i]), f64(w * inverse[1, i]), f64(w * inverse[2, i])
            yy, yz, zz = f64(w * inverse[3, i]), f64(w * inverse[4, i]), f64(w * inverse[5, i])
            i += 1
            # W J: the columns of J are (0, -pz, py), (pz, 0, -px), (-py, px, 0) and the axes
            x0, y0, z0 = xz * py - xy * pz, yz * py - yy * pz, zz * py - yz * pz
            x1, y1, z1 = xx * pz - xz * px, xy * pz - yz * px, xz * pz - zz * px
            x2, y2, z2 = xy * px - xx * py, yy * px - xy * py, yz * px - xz * py
            s0 += x0 * rx + y0 * ry + z0 * rz
            s1 += x1 * rx + y1 * ry + z1 * rz
            s2 += x2 * rx + y2 * ry + z2 * rz
            s3 += xx * rx + xy * ry + xz * rz
            s4 += xy * rx + yy * ry + yz * rz
            s5 += xz * rx + yz * ry + zz * rz
            b00 += py * z0 - pz * y0
            b01 += py * z1 - pz * y1
            b02 += py * z2 - pz * y2
            b11 += pz * x1 - px * z1
            b12 += pz * x2 - px * z2
            b22 += px * y2 - py * x2
            b03 += x0
            b04 += y0
            b05 += z0
            b13 += x1
            b14 += y1
            b15 += z1
            b23 += x2
            b24 += y2
            b25 += z2
            b33 += xx
            b34 += xy
            b35 += xz
            b44 += yy
            b45 += yz
            b55 += zz
        side = (s0, s1, s2, s3, s4, s5)
        block = (
            (b00, b01, b02, b03, b04, b05),
            (b01, b11, b12, b13, b14, b15),
            (b02, b12, b22, b23, b24, b25),
            (b03, b13, b23, b33, b34, b35),
            (b04, b14, b24, b34, b44, b45),
            (b05, b15, b25, b35, b45, b55),
        )
        for k in range(6):
            gradients[0, k] += side[k]
            gradients[1, k] += r * side[k]
            for j in range(6):
                moments[0, k, j] += block[k][j]
                moments[1, k, j] += r * block[k][j]
                moments[2, k, j] += r * r * block[k][j]
