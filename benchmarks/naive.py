"""The paper as it reads, in numpy: what the fast pipeline is measured against. Correct, and slow in the usual ways.

Every function is one step of section III: Farneback's flow both ways, residuals in the world, RANSAC in a Python loop
over all matches, a covariance matrix a pixel and its inverse, quantiles object by object.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from vlmm_log.types import Float64, FramePair, Segments

HYPOTHESES, INLIER_M, FB_PX, SIGMA_PX, TAU = 256, 0.02, 2.0, 1.5, 2.795
Matches = tuple[Float64, Float64, NDArray[np.bool_]]


def flow(pair: FramePair) -> tuple[Float64, Float64]:
    """Dense flow a to b, and back."""
    a, b = (cv2.cvtColor(f.rgb, cv2.COLOR_RGB2GRAY) for f in (pair.first, pair.second))
    settings = (0.5, 5, 21, 3, 7, 1.5, 0)
    return (
        cv2.calcOpticalFlowFarneback(a, b, None, *settings).astype(np.float64),  # type: ignore[call-overload]
        cv2.calcOpticalFlowFarneback(b, a, None, *settings).astype(np.float64),  # type: ignore[call-overload]
    )


def points(u: Float64, v: Float64, z: Float64, K: Float64) -> Float64:
    """Back-projection (..., 3) m (paper, Eq. 2)."""
    return np.stack([(u - K[0, 2]) / K[0, 0] * z, (v - K[1, 2]) / K[1, 1] * z, z], axis=-1)


def matches(pair: FramePair) -> Matches:
    """Points of both cameras (H, W, 3) m, and which of them pass the gate."""
    forward, backward = flow(pair)
    H, W = pair.first.depth.shape
    v, u = np.mgrid[0:H, 0:W].astype(np.float64)
    u2, v2 = u + forward[..., 0], v + forward[..., 1]
    maps = u2.astype(np.float32), v2.astype(np.float32)
    back = np.stack([cv2.remap(backward[..., k], *maps, cv2.INTER_LINEAR, borderValue=np.nan) for k in (0, 1)], -1)
    z2 = cv2.remap(pair.second.depth, *maps, cv2.INTER_NEAREST, borderValue=np.nan).astype(np.float64)
    z1 = pair.first.depth.astype(np.float64)
    with np.errstate(invalid="ignore"):
        valid = (np.linalg.norm(forward + back, axis=-1) < FB_PX) & np.isfinite(z1) & np.isfinite(z2)
    return points(u, v, z1, pair.first.K), points(u2, v2, z2, pair.second.K), valid


def kabsch(a: Float64, b: Float64) -> tuple[Float64, Float64]:
    """R, t that bring a (n, 3) onto b (paper, Eq. 5)."""
    ca, cb = a.mean(axis=0), b.mean(axis=0)
    U, _, Vt = np.linalg.svd((b - cb).T @ (a - ca))
    R = U @ np.diag([1, 1, np.linalg.det(U @ Vt)]) @ Vt
    return R, cb - R @ ca


def ego(a: Float64, b: Float64, rng: np.random.Generator) -> tuple[Float64, Float64]:
    """RANSAC over all matches (n, 3), then a fit to the inliers (paper, Eq. 4)."""
    best = np.zeros(len(a), bool)
    for _ in range(HYPOTHESES):
        R, t = kabsch(*(x[rng.integers(0, len(a), 3)] for x in (a, b)))
        inlier = np.linalg.norm(a @ R.T + t - b, axis=1) < INLIER_M
        if inlier.sum() > best.sum():
            best = inlier
    return kabsch(a[best], b[best]) if best.sum() >= 3 else (np.eye(3), np.zeros(3))


def covariances(X: Float64, K: Float64) -> Float64:
    """(n, 3, 3) m^2 of camera points (paper, Eq. 6)."""
    z = X[:, 2]
    J = np.zeros((len(X), 3, 3))
    J[:, 0, 0], J[:, 1, 1], J[:, :, 2] = z / K[0, 0], z / K[1, 1], X / z[:, None]
    noise = np.zeros_like(J)
    noise[:, 0, 0] = noise[:, 1, 1] = SIGMA_PX**2
    noise[:, 2, 2] = (0.0012 + 0.0019 * (z - 0.4e-3) ** 2) ** 2
    return np.asarray(J @ noise @ J.transpose(0, 2, 1))


def d_m(pair: FramePair, rng: np.random.Generator) -> Float64:
    """Mahalanobis score (H, W), NaN where not valid (paper, Eqs. 3 to 8)."""
    first, second, valid = matches(pair)
    Ta, Tb = (np.eye(4) if f.T_world_cam is None else f.T_world_cam for f in (pair.first, pair.second))
    a, b = first[valid], second[valid]
    world_a, world_b = a @ Ta[:3, :3].T + Ta[:3, 3], b @ Tb[:3, :3].T + Tb[:3, 3]
    R, t = ego(world_a, world_b, rng)
    residual = world_b - (world_a @ R.T + t)
    A, B = R @ Ta[:3, :3], Tb[:3, :3]
    sigma = B @ covariances(b, pair.second.K) @ B.T + A @ covariances(a, pair.first.K) @ A.T
    out = np.full(valid.shape, np.nan)
    out[valid] = np.sqrt(np.einsum("ni,nij,nj->n", residual, np.linalg.inv(sigma), residual))
    return out


def objects(score: Float64, segments: Segments) -> list[tuple[float, float]]:
    """o and phi of each instance (paper, Eqs. 9 and 10)."""
    found = []
    for k in range(len(segments)):
        own = score[(segments.labels == k + 1) & np.isfinite(score)]
        found.append((float(np.percentile(own, 75)), float((own > TAU).mean())) if own.size else (0.0, 0.0))
    return found
