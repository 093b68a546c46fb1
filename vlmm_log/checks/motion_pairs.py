"""Pairs whose own motion is known: what poses and cameras are judged by."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vlmm_log import se3
from vlmm_log.checks.case import Case
from vlmm_log.checks.probe import FEWEST, Probe
from vlmm_log.checks.rigid import error_px, fit
from vlmm_log.types import Float64

EXPLAINED_PX = 2.5  # a pair whose best rigid motion leaves more is dynamic, or its depth is wrong
MOVING_PX = 4.0  # a pair with less flow does not tell conventions apart

PLACE_PRIOR = 0.0025  # (1 cm of a pair's translation / 20 cm of a mounting's position)^2
SECOND_AXIS, SECOND_RAD = 0.1, 0.02  # rotations about one axis alone leave a mounting's turn about it open


@dataclass(frozen=True, eq=False)
class MotionPair:
    """A pair and the motion that its own matches show."""

    probe: Probe
    T: Float64  # (4, 4) T_second_first


def motion_pairs(case: Case) -> list[MotionPair]:
    """Pairs with enough matches that one rigid motion explains under the log's camera."""
    found = []
    for probe in case.samples.probes:
        if len(probe.z_a) < FEWEST:
            continue
        T = fit(probe, case.log.camera.K, np.eye(4))
        left = error_px(probe, T, case.log.camera.K)
        if left < max(EXPLAINED_PX, 0.1 * probe.moved_px):
            found.append(MotionPair(probe, T))
    return found


def moving(pairs: list[MotionPair]) -> list[MotionPair]:
    """Those whose images move."""
    return [p for p in pairs if p.probe.moved_px >= MOVING_PX]


def flow_px(probe: Probe, T: Float64, K: Float64) -> float:
    """Median displacement px that a motion predicts for a pair's matches."""
    rays = np.column_stack([(probe.x_a - K[:2, 2]) / np.diag(K)[:2], np.ones(len(probe.z_a))])
    at = rays * probe.z_a[:, None] @ T[:3, :3].T + T[:3, 3]
    predicted = at[:, :2] / np.maximum(at[:, 2], 1e-3)[:, None] * np.diag(K)[:2] + K[:2, 2]
    return float(np.median(np.linalg.norm(predicted - probe.x_a, axis=1)))


def carried(pairs: list[tuple[Float64, Float64]]) -> tuple[Float64, Float64] | None:
    """The camera's pose (4, 4) in the tracked frame, turned only, and also displaced; None where that stays open.

    ``pairs`` are motions A of the camera and B of the tracked frame, X A = B X, the hand-eye problem: the rotation by
    Kabsch on the rotation vectors, the position by least squares with a prior, since it is near to open along the axis
    of most rotations. Park and Martin, IEEE Trans. Robotics and Automation 1994.
    """
    cameras, trackers = (np.array([se3.log(p[k])[:3] for p in pairs]) for k in (0, 1))
    spread = np.linalg.svd(cameras, compute_uv=False)
    if spread[1] < max(SECOND_AXIS * spread[0], SECOND_RAD):
        return None
    turned = np.eye(4)
    U, _, Vt = np.linalg.svd(trackers.T @ cameras)
    turned[:3, :3] = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    left = np.concatenate([B[:3, :3] - np.eye(3) for _, B in pairs])
    right = np.concatenate([turned[:3, :3] @ A[:3, 3] - B[:3, 3] for A, B in pairs])
    displaced = turned.copy()
    displaced[:3, 3] = np.linalg.solve(left.T @ left + PLACE_PRIOR * np.eye(3), left.T @ right)
    return turned, displaced
