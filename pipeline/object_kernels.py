"""Kernels of aggregation and tracking: one pass over the image for all instances. They call none of another file."""

from __future__ import annotations

from typing import Any

import numpy as np

from vlmm_log.compiled import jit
from vlmm_log.pipeline.kernels import Camera
from vlmm_log.types import Float32, Float64, Int32, Int64

f32 = np.float32
FENCE = f32(1.5)  # Tukey's: depths this many interquartile ranges beyond the quartiles are not the instance's
SLACK_M = f32(0.02)
SAMPLE = 512  # depths of an instance, or up to twice as many, tell its place and size
THIN = 2  # every second row tells how much masks overlap
BINS = 256  # of the histogram that a quantile is looked up in: d_M and metres up to 16, what is more in the last one
A_UNIT, TOP = f32(BINS / 16), f32(15.99)
TILE = 16  # px, side of the patches in which a moving part must show


@jit
def count(
    labels: Int32, depth: Float32, d_m: Float32, tau: np.float32, counts: Int32, parts: Int32, boxes: Int32
) -> None:
    """Pixels of each instance. counts (n, 3): all, those with depth, those scored; boxes (n, 4): first and last u, v.

    parts (n,): scored pixels in tiles that the instance all but fills and in which most are above tau. A part that
    moves is a patch; false flags are strips along borders, as wide as flow bleeds from what moves beside.
    """
    n = counts.shape[0]
    counts[:] = 0
    parts[:] = 0
    boxes[:, 0] = boxes[:, 1] = 1 << 30
    boxes[:, 2] = boxes[:, 3] = -1
    scored, flagged = np.zeros(n, np.int32), np.zeros(n, np.int32)
    for top in range(0, labels.shape[0], TILE):
        for left in range(0, labels.shape[1], TILE):
            end = min(left + TILE, labels.shape[1])
            for v in range(top, min(top + TILE, labels.shape[0])):
                u = left
                while u < end:  # runs of one instance
                    start, k = u, labels[v, u] - 1
                    seen = valid = above = 0
                    while u < end and labels[v, u] - 1 == k:
                        d = d_m[v, u]
                        seen += depth[v, u] == depth[v, u]
                        valid += d == d
                        above += d > tau
                        u += 1
                    if k < 0:
                        continue
                    counts[k, 0] += u - start
                    counts[k, 1] += seen
                    scored[k] += valid
                    flagged[k] += above
                    boxes[k, 0] = min(boxes[k, 0], start)
                    boxes[k, 1] = min(boxes[k, 1], v)
                    boxes[k, 2] = max(boxes[k, 2], u - 1)
                    boxes[k, 3] = max(boxes[k, 3], v)
            for k in range(n):
                if scored[k]:
                    if 10 * scored[k] >= 9 * TILE * TILE and 2 * flagged[k] > scored[k]:
                        parts[k] += scored[k]
                    counts[k, 2] += scored[k]
                    scored[k] = 0
                    flagged[k] = 0


@jit
def gather(
    labels: Int32,
    depth: Float32,
    d_m: Float32,
    residual: Float32,
    tau: np.float32,
    lattice: Int32,
    ends: Int64,
    pixels: Int32,
    depths: Float32,
    scores: Float32,
    sums: Float64,
) -> None:
    """Sort scores, and a sample of the depths with their pixels, by instance, and sum the residuals.

    ends (n, 2): where each instance's depths and scores start; then where they end. lattice (n, 2): every how many
    pixels, a power of two, less one, a depth is taken, and by how much that shifts from row to row.

    sums (n, 10): pixels above tau; unit residuals of those (3), of all scored (3); residuals of those above (3).
    """
    at = ends
    sums[:] = 0.0
    for v in range(labels.shape[0]):
        for u in range(labels.shape[1]):
            k = labels[v, u] - 1
            if k < 0:
                continue
            z, d = depth[v, u], d_m[v, u]
            if z == z and (u + v * lattice[k, 1]) & lattice[k, 0] == 0:
                depths[at[k, 0]] = z
                pixels[at[k, 0]] = v * labels.shape[1] + u
                at[k, 0] += 1
            if d == d:
                scores[at[k, 1]] = d
                at[k, 1] += 1
                x, y, w = residual[0, v, u], residual[1, v, u], residual[2, v, u]
                norm = np.sqrt(x * x + y * y + w * w)
                scale = f32(1) / norm if norm > f32(0) else f32(0)
                sums[k, 4] += x * scale
                sums[k, 5] += y * scale
                sums[k, 6] += w * scale
                if d > tau:
                    sums[k, 0] += 1.0
                    sums[k, 1] += x * scale
                    sums[k, 2] += y * scale
                    sums[k, 3] += w * scale
                    sums[k, 7] += x
                    sums[k, 8] += y
                    sums[k, 9] += w


@jit
def _bin(x: Any) -> Any:
    return np.int32(min(x, TOP) * A_UNIT)


@jit
def quantiles(values: Float32, starts: Int64, ends: Int64, share: np.float32, out: Float32) -> None:
    """The quantile of each run ``values[starts[k]:ends[k]]``, linear between neighbours; NaN of an empty one.

    Values are not negative. A histogram finds the bin that holds it, so that only a few need sorting out.
    """
    counts, few = np.empty(BINS, np.int32), np.empty(values.size, np.float32)
    for k in range(starts.size):
        run = values[starts[k] : ends[k]]
        if run.size == 0:
            out[k] = np.nan
            continue
        counts[:] = 0
        for x in run:
            counts[_bin(x)] += 1
        place = np.float64(share) * np.float64(run.size - 1)
        rank = np.int64(np.floor(place))
        chosen = 0
        while rank >= counts[chosen]:
            rank -= counts[chosen]
            chosen += 1
        n = 0
        for x in run:
            if _bin(x) == chosen:
                few[n] = x
                n += 1
        a, b = 0, n - 1
        while a < b:  # Hoare's selection
            pivot = few[(a + b) // 2]
            i, j = a, b
            while i <= j:
                while few[i] < pivot:
                    i += 1
                while few[j] > pivot:
                    j -= 1
                if i <= j:
                    few[i], few[j] = few[j], few[i]
                    i += 1
                    j -= 1
            if rank <= j:
                b = j
            elif rank >= i:
                a = i
            else:
                break
        here, rest = few[rank], f32(place - np.floor(place))
        if rest > f32(0):
            following = np.inf
            for i in range(rank + 1, n):
                following = min(following, few[i])
            if rank + 1 == n:  # it lies in a higher bin
                for x in run:
                    if _bin(x) > chosen and x < following:
                        following = x
            here += rest * (f32(following) - here)
        out[k] = here


@jit
def shapes(
    depth: Float32,
    pixels: Int32,
    starts: Int64,
    ends: Int64,
    fences: Float32,
    camera: Camera,
    mean: Float64,
    cov: Float64,
) -> None:
    """Mean (n, 3) m and covariance (n, 6) m^2 of the points whose depth lies within the fences (n, 2); NaN if none."""
    width = depth.shape[1]
    flat = depth.ravel()
    total = np.zeros(9)
    for k in range(starts.size):
        total[:] = 0.0
        m = 0
        for i in range(starts[k], ends[k]):
            p = pixels[i]
            z = flat[p]
            if z < fences[k, 0] or z > fences[k, 1]:
                continue
            x = (f32(p % width) - camera.cx) / camera.fx * z
            y = (f32(p // width) - camera.cy) / camera.fy * z
            m += 1
            total[0] += x
            total[1] += y
            total[2] += z
            total[3] += x * x
            total[4] += x * y
            total[5] += x * z
            total[6] += y * y
            total[7] += y * z
            total[8] += z * z
        if m == 0:
            mean[k], cov[k] = np.nan, np.nan
            continue
        a, b, c = total[0] / m, total[1] / m, total[2] / m
        mean[k, 0], mean[k, 1], mean[k, 2] = a, b, c
        cov[k, 0], cov[k, 1], cov[k, 2] = total[3] / m - a * a, total[4] / m - a * b, total[5] / m - a * c
        cov[k, 3], cov[k, 4], cov[k, 5] = total[6] / m - b * b, total[7] / m - b * c, total[8] / m - c * c


@jit
def carried_overlap(before: Int32, flow: Float32, share: np.float32, labels: Int32, areas: Int32, both: Int32) -> None:
    """Carry an earlier frame's masks by a share of its flow onto a frame's own masks.

    before (H, W): 0 none, i + 1 for mask i. flow (H / THIN, W, 2): of every THIN-th row. areas (m,): pixels of each
    that stay in view; both (m, n): those of them that land on each of the n instances of ``labels``, several on one
    pixel where a mask shrinks.
    """
    areas[:] = 0
    both[:] = 0
    H, W = labels.shape
    for v in range(0, H, THIN):
        for u in range(W):
            i = before[v, u] - 1
            if i < 0:
                continue
            x = np.int64(np.rint(f32(u) + share * flow[v // THIN, u, 0]))
            y = np.int64(np.rint(f32(v) + share * flow[v // THIN, u, 1]))
            if x < 0 or y < 0 or x >= W or y >= H:
                continue
            areas[i] += THIN
            k = labels[y, x] - 1
            if k >= 0:
                both[i, k] += THIN
