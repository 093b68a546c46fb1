"""What a pair shows of each instance: observed motion, reliability, place (paper, Eqs. 9 to 11)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vlmm_log.elements import OBSERVATION, Instances, Observations, Sightings
from vlmm_log.pipeline import object_kernels as ok
from vlmm_log.pipeline.kernels import Camera
from vlmm_log.settings import ObjectSettings
from vlmm_log.types import Ego, Float32, Float64, FramePair, Motion, Odometry, Segments

f32 = np.float32


def aggregate(
    pair: FramePair, segments: Segments, motion: Motion, ego: Ego, odometry: Odometry, s: ObjectSettings
) -> Sightings:
    """One row an instance, in the world."""
    return place(gather_instances(pair, segments, motion, s), pair, ego, odometry, s)


def gather_instances(pair: FramePair, segments: Segments, motion: Motion, s: ObjectSettings) -> Instances:
    """One row an instance, in the pair's own cameras."""
    first, n = pair.first, len(segments)
    tau = f32(motion.tau_px)
    counts, parts, boxes = np.empty((n, 3), np.int32), np.empty(n, np.int32), np.empty((n, 4), np.int32)
    ok.count(segments.labels, first.depth, motion.d_m, tau, counts, parts, boxes)
    starts = np.stack([_starts(counts[:, 1]), _starts(counts[:, 2])], axis=1)
    ends = starts.copy()
    pixels, depths = np.empty(counts[:, 1].sum(), np.int32), np.empty(counts[:, 1].sum(), np.float32)
    scores, sums = np.empty(counts[:, 2].sum(), np.float32), np.empty((n, 10))
    lattice = np.array([_lattice(int(c)) for c in counts[:, 1]], np.int32).reshape(n, 2)
    ok.gather(
        segments.labels, first.depth, motion.d_m, motion.residual, tau, lattice, ends, pixels, depths, scores, sums
    )
    by_depth, by_score = (starts[:, 0], ends[:, 0]), (starts[:, 1], ends[:, 1])
    rows = np.zeros(n, OBSERVATION)
    rows["first_ns"], rows["second_ns"], rows["index"] = first.stamp_ns, pair.second.stamp_ns, first.index
    rows["pixels"], rows["scored"] = counts[:, 0], counts[:, 2]
    rows["o"] = _quantile(scores, by_score, s.quantile)
    _reliability(rows, sums, s)
    rows["part"] = parts / np.maximum(counts[:, 0], 1)
    mean, cov = _shape(first.depth, pixels, depths, by_depth, first.K)
    return Instances(segments, rows, boxes, mean, cov, sums[:, 7:] / np.maximum(sums[:, :1], 1))


def place(instances: Instances, pair: FramePair, ego: Ego, odometry: Odometry, s: ObjectSettings) -> Sightings:
    """Instances in the world. Those of an unreliable pair, or with too few scored pixels, are no observations."""
    rows = instances.rows.copy()
    rows["drift"] = instances.drift @ _residual_axes(pair, odometry).T
    _place(rows, instances.mean, instances.covariance, odometry.T_world_first)
    observed = (rows["scored"] >= s.min_scored) & ego.reliable & np.isfinite(rows["position"]).all(axis=1)
    return Sightings(instances.segments, rows, instances.boxes, observed)


Runs = tuple[NDArray[np.int64], NDArray[np.int64]]  # where each instance's values start and end


def _starts(counts: NDArray[np.int32]) -> NDArray[np.int64]:
    return np.cumsum(counts, dtype=np.int64) - counts


def _lattice(count: int) -> tuple[int, int]:
    """For ``gather``: SAMPLE depths or up to twice as many, spread evenly whatever a mask's width.

    The shift is odd, so that it meets every column, and near the golden ratio.
    """
    every = 1 << max((count // ok.SAMPLE).bit_length() - 1, 0)
    return every - 1, round(0.618 * every) | 1


def _quantile(values: Float32, runs: Runs, share: float) -> Float32:
    out = np.empty(runs[0].size, np.float32)
    ok.quantiles(values, *runs, f32(share), out)
    return out


def _reliability(rows: Observations, sums: Float64, s: ObjectSettings) -> None:
    """phi, gamma and kappa. gamma is 0 where no residual has a direction."""
    scored, flagged = np.maximum(rows["scored"], 1), sums[:, 0]
    rows["phi"] = flagged / scored
    rows["gamma_all"] = np.linalg.norm(sums[:, 4:7], axis=1) / scored
    over_flagged = np.linalg.norm(sums[:, 1:4], axis=1) / np.maximum(flagged, 1)
    rows["gamma"] = over_flagged if s.coherence == "flagged" else rows["gamma_all"]
    rows["kappa"] = rows["phi"] * rows["gamma"]


def _shape(
    depth: Float32, pixels: NDArray[np.int32], depths: Float32, runs: Runs, K: Float64
) -> tuple[Float64, Float64]:
    """Mean (n, 3) and covariance (n, 6) in the camera of the sampled points that Tukey's fences on depth keep.

    A mask's border often holds a strip of what lies behind.
    """
    low, high = _quantile(depths, runs, 0.25), _quantile(depths, runs, 0.75)
    reach = ok.FENCE * (high - low) + ok.SLACK_M
    fences = np.stack([low - reach, high + reach], axis=1)
    camera = Camera(f32(K[0, 0]), f32(K[1, 1]), f32(K[0, 2]), f32(K[1, 2]))
    mean, cov = np.empty((low.size, 3)), np.empty((low.size, 6))
    ok.shapes(depth, pixels, *runs, fences, camera, mean, cov)
    return mean, cov


def _place(rows: Observations, mean: Float64, cov: Float64, T_world_cam: Float64) -> None:
    """Position and extent in the world."""
    R, t = T_world_cam[:3, :3], T_world_cam[:3, 3]
    rows["position"] = mean @ R.T + t
    xx, xy, xz, yy, yz, zz = cov.T
    full = np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], axis=1).reshape(-1, 3, 3)
    world = R @ full @ R.T
    rows["extent"] = world.reshape(-1, 9)[:, [0, 1, 2, 4, 5, 8]]


def _residual_axes(pair: FramePair, odometry: Odometry) -> Float64:
    """World from the axes of Motion.residual, which are the second camera's where it has no pose."""
    if pair.second.T_world_cam is not None:
        return np.eye(3)
    return odometry.T_world_second[:3, :3]
