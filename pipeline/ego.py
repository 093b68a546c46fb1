"""Ego-refinement: the camera's motion from the static correspondences (paper, Eqs. 4 and 5).

Fitted in the second camera, which has the same minimiser as the paper's world-frame fit without the lever arm
to the world's origin. MSAC hypotheses from three matches each, then Gauss-Newton on the inliers.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from vlmm_log import se3
from vlmm_log.pipeline import ego_kernels as ek
from vlmm_log.pipeline import kernels
from vlmm_log.pipeline.matches import Matches
from vlmm_log.settings import EgoSettings
from vlmm_log.types import CHI2_3_MEDIAN, Ego, Float32, Float64, Segments

CONVERGED = 1e-4  # rad and m: a refit that moves the camera by less is the last
CHI2_3_QUARTILE = 1.2125329030456688  # a quarter of still points is below it


def row_transforms(T_second_first: Float64, row_twist: Float64, rows: NDArray[np.int64], height: int) -> Float64:
    """(n, 4, 4) transforms of image rows: exp((v / H - 1/2) row_twist) @ T_second_first."""
    return _moved(T_second_first, row_twist, rows / height - 0.5)


def _moved(T: Float64, twist: Float64, shares: Float64) -> Float64:
    """(n, 4, 4): exp(share twist) @ T."""
    out = np.zeros((shares.size, 4, 4))
    ek.moved(np.ascontiguousarray(T), np.ascontiguousarray(twist), shares, out)
    return out


def as_rows(T: Float64) -> Float32:
    """(n, 12) float32 of (n, 4, 4): rotation row by row, then translation, as the kernels read it."""
    return np.concatenate([T[:, :3, :3].reshape(-1, 9), T[:, :3, 3]], axis=1).astype(np.float32)


def refine_ego(matches: Matches, segments: Segments, s: EgoSettings, rng: np.random.Generator) -> Ego:
    """The relative pose of a pair by its static matches; the log's own where ego-refinement is off or impossible.

    No instance of ``segments`` (those of the first frame) supplies more than ``instance_share`` of the hypotheses and
    their votes, so that one large mover does not pass for the world.
    """
    prior = matches.pair.relative_pose()
    grid = _Grid.gather(matches, s.stride)
    unit = Fit(prior, np.zeros(6))
    inverse = grid.inverse_covariances(unit)
    weighable = np.asarray(np.isfinite(inverse).all(axis=0))  # not that of very far points, nor of a very odd camera
    if not weighable.all():
        grid, inverse = grid.of(weighable), inverse[:, weighable]
    if s.model == "off" or grid.count < s.min_matches:
        first, second = matches.pair.first.T_world_cam, matches.pair.second.T_world_cam
        off = s.model == "off" and first is not None and second is not None
        covariance = np.diag(np.repeat([s.pose_sigma_rad, s.pose_sigma_m], 3) ** 2.0)
        return Ego(prior, np.zeros(6), covariance, np.zeros(6), np.nan, np.nan, grid.count, off)

    cut = s.inlier_sigma**2 if s.inlier == "sigma" else 1.0
    if s.inlier == "metric":
        inverse = grid.isotropic(s.inlier_m)
    weight = grid.balanced(segments, s.instance_share)
    fit = Fit(_consensus(grid, inverse, weight, prior, cut, s, rng), np.zeros(6))
    scale2 = 1.0
    for iteration in range(s.iterations):
        if s.inlier == "sigma" and iteration in (0, 2):
            inverse = grid.inverse_covariances(fit)
        d2 = grid.whitened(fit, inverse)
        if s.inlier == "sigma":  # the noise model may be off by a factor; the inlier test must not be
            scale2 = float(np.clip(_quartile(d2) / CHI2_3_QUARTILE, 0.25, 4.0))
        fit, step, hessian = _gauss_newton(grid, fit, inverse, d2, cut * scale2, s)
        if np.abs(step).max() < CONVERGED:
            break
    inlier_share = float(np.mean(grid.whitened(fit, inverse) < cut * scale2))
    d2 = grid.whitened(fit, grid.inverse_covariances(fit))
    spread = float(np.sqrt(np.median(d2) / CHI2_3_MEDIAN))
    covariance = np.asarray(np.linalg.pinv(hessian, hermitian=True)[:6, :6] * scale2)
    correction = se3.log(fit.T @ se3.inverse(prior))
    reliable = inlier_share >= s.min_inlier_share
    return Ego(fit.T, fit.row_twist, covariance, correction, inlier_share, spread, grid.count, reliable)


def _quartile(values: Float32) -> np.float32:
    """np.quantile(values, 0.25), by one partition."""
    k, quarters = divmod(values.size - 1, 4)
    parted = np.partition(values, k)
    low = parted[k]
    high = parted[k + 1 :].min() if quarters else low  # cheaper than a second place to part at
    share = np.float32(quarters / 4)
    return np.float32(low + (high - low) * share if share < 0.5 else high - (high - low) * (1 - share))


@dataclass(frozen=True, eq=False)
class Fit:
    """A candidate: exp((v / H - 1/2) row_twist) @ T."""

    T: Float64
    row_twist: Float64
    rows: dict[bytes, Float32] = field(default_factory=dict)  # by the image rows of a grid: made once


@dataclass(frozen=True, eq=False)
class _Grid:
    """Valid matches of a coarse pixel grid, row after row."""

    matches: Matches
    planes: Float32  # (GATHERED, N)
    rays: Float32  # (2, N) of the first camera
    row: NDArray[np.int32]  # (N,) grid row
    column: NDArray[np.int64]  # (N,) image column
    image_rows: NDArray[np.int64]  # (h,) image row of each grid row
    first: Float32  # (3, N) m
    second: Float32  # (3, N) m

    @property
    def count(self) -> int:
        return int(self.row.size)

    @property
    def height(self) -> int:
        return int(self.matches.pair.first.depth.shape[0])

    @staticmethod
    def gather(matches: Matches, stride: int) -> _Grid:
        H, W = matches.pair.first.depth.shape
        v, u = np.arange(0, H, stride), np.arange(0, W, stride)
        planes = np.empty((kernels.GATHERED, v.size, u.size), np.float32)
        status = np.empty((v.size, u.size), np.uint8)
        kernels.gather_grid(stride, matches.inputs, planes, status)
        j, i = np.nonzero(status == kernels.VALID)
        c = matches.inputs.camera
        rays = np.stack([(u[i] - c.cx) / c.fx, (v[j] - c.cy) / c.fy]).astype(np.float32)
        kept = np.ascontiguousarray(planes[:, j, i])
        first, second = np.empty((3, j.size), np.float32), np.empty((3, j.size), np.float32)
        ek.points(kept, rays, first, second)
        return _Grid(matches, kept, rays, j.astype(np.int32), u[i], v, first, second)

    def balanced(self, segments: Segments, most: float) -> Float64:
        """(N,) sampling weights under which no instance has more than a share ``most`` of the whole weight."""
        label = segments.labels[self.image_rows[self.row], self.column]
        counts = np.bincount(label, minlength=len(segments) + 1)
        if segments.partition:
            return np.ones(label.size)
        cap = most * total_weight(counts[1:], int(counts[0]), most)
        weight = np.minimum(cap / np.maximum(counts, 1), 1.0)
        weight[0] = 1.0  # pixels of no instance
        return np.asarray(weight[label])

    def of(self, kept: NDArray[np.bool_]) -> _Grid:
        """Some of the matches."""
        planes, rays, first, second = (a[:, kept] for a in (self.planes, self.rays, self.first, self.second))
        row, column = self.row[kept], self.column[kept]
        return _Grid(self.matches, planes, rays, row, column, self.image_rows, first, second)

    def rows(self, fit: Fit) -> Float32:
        key = self.image_rows.tobytes()
        if key not in fit.rows:
            fit.rows[key] = as_rows(row_transforms(fit.T, fit.row_twist, self.image_rows, self.height))
        return fit.rows[key]

    def inverse_covariances(self, fit: Fit) -> Float32:
        """(6, N) 1/m^2; NaN where single precision cannot weigh it."""
        out = np.empty((6, self.count), np.float32)
        x = self.matches.inputs
        kernels.inverse_covariances(self.planes, self.rays, self.row, self.rows(fit), x.camera, x.model, out)
        return out

    def isotropic(self, sigma: float) -> Float32:
        out = np.zeros((6, self.count), np.float32)
        out[[0, 3, 5]] = 1.0 / sigma**2
        return out

    def whitened(self, fit: Fit, inverse: Float32) -> Float32:
        d2 = np.empty(self.count, np.float32)
        ek.whitened(self.first, self.second, inverse, self.row, self.rows(fit), d2)
        return d2


def total_weight(counts: NDArray[np.int64], others: int, most: float) -> float:
    """The total T = others + sum of min(count, most T): what is left once every instance is capped at its share.

    Where the instances are too few for it (5 masks over the whole image at 8 %), no cap: all matches.
    """
    rest = float(others + counts.sum())
    whole, kept = rest, 1.0
    for count in np.sort(counts)[::-1]:
        if count <= most * rest / kept:
            return rest / kept
        rest, kept = rest - count, kept - most
        if rest <= 0 or kept <= 0:
            return whole / most
    return rest / kept


def _consensus(
    grid: _Grid,
    inverse: Float32,
    weight: Float64,
    prior: Float64,
    cut: float,
    s: EgoSettings,
    rng: np.random.Generator,
) -> Float64:
    """The best of many three-match fits and the prior, by MSAC on a weighted sample of the matches."""
    sample = rng.choice(grid.count, s.sample, p=weight / weight.sum())
    first, second = grid.first[:, sample], grid.second[:, sample]
    triples = rng.integers(0, sample.size, (s.hypotheses, 3))
    a, b = first.T[triples].astype(np.float64), second.T[triples].astype(np.float64)
    candidates = np.concatenate([prior[None], se3.kabsch(a, b)])
    cost = np.empty(len(candidates), np.float32)
    ek.msac(np.ascontiguousarray(as_rows(candidates).T), first, second, inverse[:, sample], np.float32(cut), cost)
    return np.asarray(candidates[int(np.argmin(cost))])


def _gauss_newton(
    grid: _Grid, fit: Fit, inverse: Float32, d2: Float32, cut: float, s: EgoSettings
) -> tuple[Fit, Float64, Float64]:
    """One refit on the inliers: the fit, the step taken (12,), the normal matrix (6, 6) or (12, 12).

    Inliers weigh by Tukey's biweight in sigmas, and alike in metres (the paper's plain least squares).
    """
    moments, gradients = np.empty((3, 6, 6)), np.empty((2, 6))
    share = grid.image_rows / grid.height - 0.5
    ek.normal_equations(
        grid.first,
        grid.second,
        inverse,
        d2,
        np.float32(cut),
        s.inlier == "sigma",
        grid.row,
        grid.rows(fit),
        share,
        moments,
        gradients,
    )
    if s.model == "rigid":
        normal, side = moments[0], gradients[0]
    else:
        precision = np.repeat([s.row_prior_rad, s.row_prior_m], 3) ** -2.0
        normal = np.empty((12, 12))
        normal[:6, :6], normal[:6, 6:], normal[6:, :6] = moments[0], moments[1], moments[1]
        normal[6:, 6:] = moments[2] + np.diag(precision)
        side = np.concatenate([gradients[0], gradients[1] - precision * fit.row_twist])
    step = np.zeros(12)
    step[: side.size] = np.linalg.lstsq(normal, side, rcond=1e-12)[0]
    return Fit(_moved(fit.T, step[:6], np.ones(1))[0], fit.row_twist + step[6:]), step, normal
