"""How well a relative pose and a camera explain the matches of a pair."""

from __future__ import annotations

import numpy as np

from vlmm_log import se3
from vlmm_log.checks.probe import Probe
from vlmm_log.types import Float64

DEPTH_SHARE = 0.3  # a depth error counts as this share of what it would be as a displacement of f dz / z px
FARTHEST_PX = 300.0  # errors are capped here: a point behind the camera has no place in the image
ITERATIONS = 12


def errors_px(probe: Probe, T: Float64, K: Float64) -> Float64:
    """(N,) px: reprojection error and depth error under ``T_second_first`` (4, 4)."""
    at = _points(probe, K) @ T[:3, :3].T + T[:3, 3]
    errors = np.linalg.norm(_residuals(probe, at, K), axis=1)
    return np.asarray(np.where(at[:, 2] > 0, np.minimum(errors, FARTHEST_PX), FARTHEST_PX))


def error_px(probe: Probe, T: Float64, K: Float64) -> float:
    """Median of them: what moves by itself does not count."""
    return float(np.median(errors_px(probe, T, K)))


def fit(probe: Probe, K: Float64, start: Float64) -> Float64:
    """``T_second_first`` (4, 4) by the matches alone: reweighted Gauss-Newton with Cauchy's weights from a guess."""
    points, T = _points(probe, K), start
    for _ in range(ITERATIONS):
        at = points @ T[:3, :3].T + T[:3, 3]
        residuals = _residuals(probe, at, K)
        length = np.linalg.norm(residuals, axis=1)
        weight = 1.0 / (1.0 + (length / max(1.5 * float(np.median(length)), 0.5)) ** 2)
        J = _jacobian(probe, at, K)
        normal = np.einsum("nij,n,nik->jk", J, weight, J) + 1e-6 * np.eye(6)
        step = np.linalg.solve(normal, np.einsum("nij,n,ni->j", J, weight, residuals))
        T = se3.exp(-step) @ T
        if np.abs(step).max() < 1e-5:
            break
    return T


def _points(probe: Probe, K: Float64) -> Float64:
    """(N, 3) m in the first camera."""
    rays = (probe.x_a - K[:2, 2]) / np.diag(K)[:2]
    return np.column_stack([rays, np.ones(len(rays))]) * probe.z_a[:, None]


def _residuals(probe: Probe, at: Float64, K: Float64) -> Float64:
    """(N, 3) px: in the image's columns and rows, and in depth."""
    z = np.maximum(at[:, 2], 1e-3)[:, None]
    in_depth = DEPTH_SHARE * K[0, 0] * (at[:, 2] / probe.z_b - 1)
    return np.column_stack([at[:, :2] / z * np.diag(K)[:2] + K[:2, 2] - probe.x_b, in_depth])


def _jacobian(probe: Probe, at: Float64, K: Float64) -> Float64:
    """(N, 3, 6) of the residuals by a twist on the left."""
    z = np.maximum(at[:, 2], 1e-3)
    by_point = np.zeros((len(at), 3, 3))
    by_point[:, 0, 0], by_point[:, 0, 2] = K[0, 0] / z, -K[0, 0] * at[:, 0] / z**2
    by_point[:, 1, 1], by_point[:, 1, 2] = K[1, 1] / z, -K[1, 1] * at[:, 1] / z**2
    by_point[:, 2, 2] = DEPTH_SHARE * K[0, 0] / probe.z_b
    return np.concatenate([-by_point @ se3.skew(at), by_point], axis=2)
