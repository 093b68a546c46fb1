"""Depth of one pinhole camera as another one sees it: depth registered to colour.

A depth pixel is a small patch of surface. Its four corners, each at the mean depth of the up to four pixels that meet
there, are projected into the colour image, and the pixel centres between them get the patch's depth; the nearest
patch wins. Patches of one surface share their corners, so that nothing shows through them however much finer the
colour image is, and across a depth edge none is stretched. librealsense's ``align`` and ``fill_upsampling_holes`` of
ROS's depth_image_proc draw patches likewise, but each at its own depth: surfaces at a slant tear there.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from vlmm_log.types import Float32, Float64, InputError

SAME_SURFACE = 0.05  # of the nearer depth: pixels further apart share no corner
LARGEST = 64.0  # px a side: what is larger touches the colour camera's lens, and is left unseen


def register(depth: Float32, K_depth: Float64, K_rgb: Float64, T_rgb_depth: Float64, size: tuple[int, int]) -> Float32:
    """Depth (h, w) m as the colour camera, of image ``size`` (H, W) px, has it: (H, W) m, NaN where nothing lands.

    ``K_depth`` and ``K_rgb`` (3, 3) px are of images without lens distortion. What cannot be positive depth is unseen.
    Each value is that of one depth pixel's middle; none is interpolated. Raises InputError where ``T_rgb_depth``
    (4, 4) is no rigid motion.
    """
    T = np.asarray(T_rgb_depth, np.float64)
    _check_rigid(T)
    # A pixel (u, v) at depth z lies at H (u, v, 1) z + e of the colour camera (Hartley and Zisserman, 9.6).
    H, e = K_rgb @ T[:3, :3] @ np.linalg.inv(K_depth), K_rgb @ T[:3, 3]
    depth = np.ascontiguousarray(depth, np.float32)
    corners = np.empty((2, depth.shape[0] + 1, depth.shape[1] + 1))
    _compiled(_project_corners)(depth, H, e, corners)
    out = np.full(size, np.nan, np.float32)
    _compiled(_draw_patches)(depth, H, e, corners, out)
    return out


@cache
def _compiled(kernel: Callable[..., None]) -> Any:
    from vlmm_log.compiled import jit  # half a second that logs with registered depth need not wait for

    return jit(kernel)


def _check_rigid(T: Float64) -> None:
    if T.shape == (4, 4) and np.isfinite(T).all():
        R = T[:3, :3]
        if np.allclose(T[3], (0, 0, 0, 1)) and np.allclose(R @ R.T, np.eye(3), atol=1e-3) and np.linalg.det(R) > 0:
            return
    raise InputError(
        f"depth to colour: {T.tolist()} is no rigid motion; give rows of (4, 4), translation in metres last in each"
    )


def _project_corners(depth: Float32, H: Float64, e: Float64, corners: Float64) -> None:
    """Corner (u - 1/2, v - 1/2) in the colour image, px, into ``corners[:, v, u]`` (2, h + 1, w + 1).

    NaN where the pixels that meet there are of two surfaces, or none is seen.
    """
    h, w = depth.shape
    total, seen = np.zeros(w + 2, np.float32), np.zeros(w + 2, np.float32)  # of two rows' pixels, column u at u + 1
    near, far = np.full(w + 2, np.float32(np.inf)), np.zeros(w + 2, np.float32)
    zero, one, infinity = np.float32(0), np.float32(1), np.float32(np.inf)
    for v in range(h + 1):
        y = v - 0.5
        above, below = depth[max(v - 1, 0)], depth[min(v, h - 1)]  # the border's own row stands in for the one beyond
        for u in range(w):
            a, b = above[u], below[u]
            in_a, in_b = (a > zero) & (a < infinity), (b > zero) & (b < infinity)
            total[u + 1] = (a if in_a else zero) + (b if in_b else zero)
            seen[u + 1] = (one if in_a else zero) + (one if in_b else zero)
            near[u + 1] = min(a if in_a else infinity, b if in_b else infinity)
            far[u + 1] = max(a if in_a else zero, b if in_b else zero)
        for u in range(w + 1):
            x = u - 0.5
            together = max(far[u], far[u + 1]) <= (1 + SAME_SURFACE) * min(near[u], near[u + 1])
            z = (total[u] + total[u + 1]) / (seen[u] + seen[u + 1]) if together else np.nan
            scale = z * (H[2, 0] * x + H[2, 1] * y + H[2, 2]) + e[2]
            scale = scale if scale > 0 else 0.0  # behind the colour camera: at infinity, and the patches too large
            corners[0, v, u] = (z * (H[0, 0] * x + H[0, 1] * y + H[0, 2]) + e[0]) / scale
            corners[1, v, u] = (z * (H[1, 0] * x + H[1, 1] * y + H[1, 2]) + e[1]) / scale


def _draw_patches(depth: Float32, H: Float64, e: Float64, corners: Float64, out: Float32) -> None:
    """Each depth pixel's patch into ``out`` (H, W) m, NaN at first, where none nearer is drawn."""
    h, w = depth.shape
    rows, columns = out.shape
    for v in range(h):
        for u in range(w):
            z = float(depth[v, u])
            if not 0 < z < np.inf:
                continue
            z_rgb = np.float32(z * (H[2, 0] * u + H[2, 1] * v + H[2, 2]) + e[2])
            left, right, top, bottom = np.inf, -np.inf, np.inf, -np.inf
            for dv in range(2):
                for du in range(2):
                    px, py = corners[0, v + dv, u + du], corners[1, v + dv, u + du]
                    if px != px:  # a depth edge: the corner as it is at this pixel's own depth
                        x, y = u + du - 0.5, v + dv - 0.5
                        scale = z * (H[2, 0] * x + H[2, 1] * y + H[2, 2]) + e[2]
                        scale = scale if scale > 0 else 0.0
                        px = (z * (H[0, 0] * x + H[0, 1] * y + H[0, 2]) + e[0]) / scale
                        py = (z * (H[1, 0] * x + H[1, 1] * y + H[1, 2]) + e[1]) / scale
                    left, right, top, bottom = min(left, px), max(right, px), min(top, py), max(bottom, py)
            if not (z_rgb > 0 and right - left <= LARGEST and bottom - top <= LARGEST):
                continue
            u_first, u_end = math.ceil(max(left, 0.0)), math.ceil(min(right, float(columns)))
            v_first, v_end = math.ceil(max(top, 0.0)), math.ceil(min(bottom, float(rows)))
            for y_rgb in range(v_first, v_end):
                for x_rgb in range(u_first, u_end):
                    if not out[y_rgb, x_rgb] <= z_rgb:  # NaN: the first patch here
                        out[y_rgb, x_rgb] = z_rgb
