"""Kernels of the flow: its round trip, and its covariance from the image's texture."""

from __future__ import annotations

import math

import numpy as np

from vlmm_log.compiled import jit
from vlmm_log.types import Float32

f32 = np.float32


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
