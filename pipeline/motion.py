"""The observed-motion channel of a pair: residual, Sigma_m, d_M, p_stat (paper, Eqs. 2, 3, 6 to 8)."""

from __future__ import annotations

from functools import cache, partial

import numpy as np
from scipy.special import chdtri

from vlmm_log.pipeline import kernels
from vlmm_log.pipeline.ego import as_rows, row_transforms
from vlmm_log.pipeline.kernels import Inputs
from vlmm_log.pipeline.matches import Matches
from vlmm_log.types import Covariances, Ego, Float32, Motion, UInt8


def measure_motion(matches: Matches, ego: Ego) -> Motion:
    """Every pixel's residual against the static world and its Mahalanobis score."""
    H, W = matches.pair.first.depth.shape
    rows = as_rows(row_transforms(ego.T_second_first, ego.row_twist, np.arange(H), H))
    R_world_b = _world_rotation(matches)
    pose_variance = np.diag(ego.covariance).reshape(2, 3).mean(axis=1)  # all but nothing once refined
    model = matches.inputs.model._replace(
        var_rotation=np.float32(pose_variance[0]), var_translation=np.float32(pose_variance[1])
    )
    inputs = matches.inputs._replace(model=model)
    block, validity = np.empty((5, H, W), np.float32), np.empty((H, W), np.uint8)  # one block: fewer page faults
    residual, d_m, p_stat = block[:3], block[3], block[4]
    kernels.measure(inputs, rows, R_world_b, _p_table(), residual, d_m, p_stat, validity)

    tau_px = float(np.sqrt(chdtri(3, matches.alpha)))
    return Motion(residual, d_m, p_stat, validity, tau_px, partial(_covariances, inputs, rows, R_world_b, validity))


def _covariances(inputs: Inputs, rows: Float32, R_world_b: Float32, validity: UInt8, stride: int) -> Covariances:
    """See Motion."""
    H, W = validity.shape
    h, w = -(-H // stride), -(-W // stride)
    upper, sigma_z = np.empty((6, h, w), np.float32), np.empty((h, w), np.float32)
    kernels.sigma_m(stride, inputs, rows, R_world_b, validity, upper, sigma_z)
    return Covariances(stride, upper, sigma_z)


def _world_rotation(matches: Matches) -> Float32:
    """Second camera to world; the camera's own axes where the log has no pose."""
    T = matches.pair.second.T_world_cam
    return np.eye(3, dtype=np.float32) if T is None else np.ascontiguousarray(T[:3, :3], np.float32)


@cache
def _p_table() -> Float32:
    return kernels.p_stat_table()
