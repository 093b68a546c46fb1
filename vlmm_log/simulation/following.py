"""Exact optical flow and motion of what is seen, compiled by numba."""

from __future__ import annotations

from typing import Any

import numpy as np

from vlmm_log.compiled import jit

ROUNDS = 6  # of the fixed point, at most
STILL_PX = 2e-3  # it moves by less in the last one


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
    rounds = ROUNDS if second[0].shape[1] > 1 else 1
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
                before = row
                column, row = lens.fx * Y[0] / ahead + lens.cx, lens.fy * Y[1] / ahead + lens.cy
                if abs(row - before) < STILL_PX:
                    break
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
