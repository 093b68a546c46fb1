"""Kernels of ego-refinement: MSAC scores, normal equations. They call none of another file: numba's cache would not
see that one change."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vlmm_log.pipeline.kernels import jit
from vlmm_log.types import Float32, Float64

f32 = np.float32
Int32 = NDArray[np.int32]


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
    """Sum over matches of min(d_M^2, cut) for each hypothesis (n, 12). Torr and Zisserman 2000."""
    for k in range(hypotheses.shape[0]):
        T = hypotheses[k]
        total = f32(0)
        for i in range(first.shape[1]):
            a, b, c = first[0, i], first[1, i], first[2, i]
            rx = second[0, i] - (T[0] * a + T[1] * b + T[2] * c + T[9])
            ry = second[1, i] - (T[3] * a + T[4] * b + T[5] * c + T[10])
            rz = second[2, i] - (T[6] * a + T[7] * b + T[8] * c + T[11])
            q = rx * (inverse[0, i] * rx + f32(2) * (inverse[1, i] * ry + inverse[2, i] * rz))
            q += ry * (inverse[3, i] * ry + f32(2) * inverse[4, i] * rz) + inverse[5, i] * rz * rz
            total += min(q, cut)
        cost[k] = total


@jit
def whitened(first: Float32, second: Float32, inverse: Float32, row: Int32, rows: Float32, d2: Float32) -> None:
    """d_M^2 of each match under the transforms ``rows`` (h, 12) of its image row."""
    for i in range(first.shape[1]):
        T = rows[row[i]]
        a, b, c = first[0, i], first[1, i], first[2, i]
        rx = second[0, i] - (T[0] * a + T[1] * b + T[2] * c + T[9])
        ry = second[1, i] - (T[3] * a + T[4] * b + T[5] * c + T[10])
        rz = second[2, i] - (T[6] * a + T[7] * b + T[8] * c + T[11])
        q = rx * (inverse[0, i] * rx + f32(2) * (inverse[1, i] * ry + inverse[2, i] * rz))
        d2[i] = q + ry * (inverse[3, i] * ry + f32(2) * inverse[4, i] * rz) + inverse[5, i] * rz * rz


@jit
def normal_equations(
    first: Float32,
    second: Float32,
    inverse: Float32,
    weight: Float32,
    row: Int32,
    rows: Float32,
    share: Float64,
    moments: Float64,
    gradients: Float64,
) -> None:
    """Gauss-Newton's sums over matches for p' = exp(xi0 + r xi1) p, r = share[row].

    moments (3, 6, 6) is sum r^k J^T W J, gradients (2, 6) is sum r^k J^T W (X_b - p'), J = [-[p']x, I].
    """
    moments[:] = 0.0
    gradients[:] = 0.0
    J = np.zeros((3, 6))
    WJ = np.empty((3, 6))
    J[0, 3] = J[1, 4] = J[2, 5] = 1.0
    block = np.zeros((6, 6))
    side = np.zeros(6)
    last = -1
    for i in range(first.shape[1] + 1):
        if i == first.shape[1] or row[i] != last:
            if last >= 0:  # a row's sums are scaled once
                r = share[last]
                for a in range(6):
                    gradients[0, a] += side[a]
                    gradients[1, a] += r * side[a]
                    for b in range(a, 6):
                        moments[0, a, b] += block[a, b]
                        moments[1, a, b] += r * block[a, b]
                        moments[2, a, b] += r * r * block[a, b]
                block[:] = 0.0
                side[:] = 0.0
            if i == first.shape[1]:
                break
            last = row[i]
        w = weight[i]
        if w == f32(0):
            continue
        T = rows[last]
        a, b, c = first[0, i], first[1, i], first[2, i]
        px = T[0] * a + T[1] * b + T[2] * c + T[9]
        py = T[3] * a + T[4] * b + T[5] * c + T[10]
        pz = T[6] * a + T[7] * b + T[8] * c + T[11]
        rx, ry, rz = second[0, i] - px, second[1, i] - py, second[2, i] - pz
        J[0, 1], J[0, 2], J[1, 0] = pz, -py, -pz
        J[1, 2], J[2, 0], J[2, 1] = px, py, -px
        mxx, mxy, mxz = w * inverse[0, i], w * inverse[1, i], w * inverse[2, i]
        myy, myz, mzz = w * inverse[3, i], w * inverse[4, i], w * inverse[5, i]
        for k in range(6):
            x, y, z = J[0, k], J[1, k], J[2, k]
            WJ[0, k] = mxx * x + mxy * y + mxz * z
            WJ[1, k] = mxy * x + myy * y + myz * z
            WJ[2, k] = mxz * x + myz * y + mzz * z
            side[k] += WJ[0, k] * rx + WJ[1, k] * ry + WJ[2, k] * rz
        for k in range(6):
            for j in range(k, 6):
                block[k, j] += J[0, k] * WJ[0, j] + J[1, k] * WJ[1, j] + J[2, k] * WJ[2, j]
    for k in range(3):
        for a in range(6):
            for b in range(a):
                moments[k, a, b] = moments[k, b, a]
