"""What is known of a match's noise: each term against a plain float64 form, and on images made by hand."""

import numpy as np
import pytest

from vlmm_log import se3
from vlmm_log.pipeline import ego_kernels, flow_kernels
from vlmm_log.pipeline.ego import Fit, _Grid, as_rows
from vlmm_log.pipeline.matches import WINDOW, flow_covariance, flow_spread, local_depth_range, structure_tensor
from vlmm_log.settings import NoiseSettings
from worlds import random_matches

H, W = 60, 80


def gray(values):
    return np.repeat(np.asarray(values)[..., None], 3, axis=2).astype(np.uint8)


def test_depth_range_is_that_of_the_seen_neighbours():
    rng = np.random.default_rng(0)
    depth = rng.uniform(1, 3, (H, W)).astype(np.float32)
    depth[rng.random((H, W)) < 0.4] = np.nan
    ours = local_depth_range(depth)
    for v, u in rng.integers(0, [H, W], (300, 2)):
        around = depth[max(v - 1, 0) : v + 2, max(u - 1, 0) : u + 2]
        seen = around[~np.isnan(around)]
        assert ours[v, u] == pytest.approx(np.ptp(seen) if seen.size else 0, abs=1e-6)


def test_structure_tensor_sums_squared_central_differences():
    grey = np.random.default_rng(1).integers(0, 256, (H, W))
    ours = structure_tensor(gray(grey))
    gx = np.zeros((H, W))
    gy = np.zeros((H, W))
    gx[:, 1:-1] = (grey[:, 2:] - grey[:, :-2]) / 2
    gy[1:-1] = (grey[2:] - grey[:-2]) / 2
    r = WINDOW // 2
    for v, u in ((20, 30), (30, 50), (15, 12)):
        box = slice(v - r, v + r + 1), slice(u - r, u + r + 1)
        book = [(gx * gx)[box].sum(), (gx * gy)[box].sum(), (gy * gy)[box].sum()]
        np.testing.assert_allclose(ours[:, v, u], book, rtol=1e-5)


def test_flow_covariance_is_the_inverse_of_the_texture_above_noise():
    rng = np.random.default_rng(2)
    G = np.einsum("vuij,vukj->vuik", *(2 * [rng.normal(0, 20, (H, W, 2, 2))]))
    tensor = np.stack([G[..., 0, 0], G[..., 0, 1], G[..., 1, 1]]).astype(np.float32)
    spread = rng.uniform(0, 2, (H, W)).astype(np.float32)
    ours = np.empty_like(tensor)
    flow_kernels.flow_covariance(tensor, spread, np.float32(12.25), np.float32(40), np.float32(1.5), ours)
    values, vectors = np.linalg.eigh(G)
    kept = np.maximum(values - 40, 0) + 1.5
    book = np.einsum("vuij,vuj,vukj->vuik", vectors, 12.25 / kept, vectors) + spread[..., None, None] * np.eye(2)
    np.testing.assert_allclose(ours[0], book[..., 0, 0], rtol=2e-3)
    np.testing.assert_allclose(ours[1], book[..., 0, 1], rtol=2e-2, atol=2e-3)
    np.testing.assert_allclose(ours[2], book[..., 1, 1], rtol=2e-3)


def test_a_wall_leaves_flow_open_an_edge_along_itself_and_texture_none():
    noise = NoiseSettings(flow_spread=0)
    still = np.zeros((H, W, 2), np.float32)
    edge = np.where(np.arange(W) < W // 2, 50, 200) * np.ones((H, 1))
    checker = (np.indices((H, W)) // 3).sum(axis=0) % 2 * 120 + 60
    middle = (slice(None), H // 2, W // 2)
    wall, along, none = (flow_covariance(gray(i), still, noise)[middle] for i in (np.full((H, W), 99), edge, checker))
    assert wall[0] == pytest.approx(noise.flow_sigma**2 / noise.flow_lambda)
    assert along[0] < 0.01 < 1 < along[2]
    assert max(none[0], none[2]) < 0.01


def test_flow_spread_sees_a_moving_patch_and_not_the_camera():
    v, u = np.mgrid[0:240, 0:320].astype(np.float32)
    x, y = u / 320, v / 240
    camera = np.stack([9 + 6 * x - 4 * y + 3 * x * y, -5 + 2 * x + 7 * y + 2 * y * y], axis=-1)
    assert flow_spread(camera, 0.75).max() < 0.02
    moving = camera.copy()
    moving[80:160, 100:200] += [6, 0]
    spread = np.sqrt(flow_spread(moving, 1.0))
    assert 2 < spread[120, 100] < 4  # at the border, half of it 6 px and half of it 0: 3
    assert spread[20, 300] < 0.3
    np.testing.assert_allclose(flow_spread(moving, 0.5), 0.25 * flow_spread(moving, 1.0), rtol=1e-3, atol=1e-5)
    assert not flow_spread(moving, 0).any()


def grid_and_fit():
    rng = np.random.default_rng(3)
    grid = _Grid.gather(random_matches(rng), 4)
    fit = Fit(se3.exp(rng.normal(0, 0.02, 6)), rng.normal(0, 0.02, 6))
    return grid, fit


@pytest.mark.parametrize("biweight", [True, False])
def test_gauss_newton_sums_are_the_derivatives_of_the_cost(biweight):
    grid, fit = grid_and_fit()
    inverse = grid.inverse_covariances(fit)
    d2 = grid.whitened(fit, inverse)
    cut = np.float32(np.quantile(d2, 0.7))
    weight = np.where(d2 < cut, (1 - d2 / cut) ** 2 if biweight else 1.0, 0.0)
    share = grid.image_rows / grid.height - 0.5
    moments, gradients = np.empty((3, 6, 6)), np.empty((2, 6))
    ego_kernels.normal_equations(
        grid.first, grid.second, inverse, d2, cut, biweight, grid.row, grid.rows(fit), share, moments, gradients
    )
    r = share[grid.row]
    T = se3.exp(r[:, None] * fit.row_twist) @ fit.T
    p = np.einsum("nij,jn->ni", T[:, :3, :3], grid.first.astype(float)) + T[:, :3, 3]
    miss = grid.second.T - p
    J = np.concatenate([-se3.skew(p), np.broadcast_to(np.eye(3), (grid.count, 3, 3))], axis=2)
    M = inverse.T[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3).astype(float)
    JtM = np.einsum("nki,nkl->nil", J, M)
    for k in range(3):
        book = np.einsum("n,nil,nlj->ij", weight * r**k, JtM, J)
        np.testing.assert_allclose(moments[k], book, rtol=1e-4, atol=1e-4 * np.abs(book).max())
    for k in range(2):
        book = np.einsum("n,nil,nl->i", weight * r**k, JtM, miss)
        np.testing.assert_allclose(gradients[k], book, rtol=1e-3, atol=1e-4 * np.abs(book).max())
    d2 = np.einsum("ni,nij,nj->n", miss, M, miss)
    np.testing.assert_allclose(grid.whitened(fit, inverse), d2, rtol=1e-3, atol=1e-3)


def test_msac_caps_what_an_outlier_costs():
    grid, fit = grid_and_fit()
    inverse = grid.inverse_covariances(fit)
    rigid = Fit(fit.T, np.zeros(6))
    d2 = grid.whitened(rigid, inverse).astype(float)
    cost = np.empty(1, np.float32)
    rows = np.concatenate([fit.T[:3, :3].ravel(), fit.T[:3, 3]]).astype(np.float32)[:, None]
    ego_kernels.msac(rows, grid.first, grid.second, inverse, np.float32(9), cost)
    assert cost[0] == pytest.approx(np.minimum(d2, 9).sum(), rel=1e-4)


def test_msac_scores_every_hypothesis_as_the_textbook_does():
    grid, fit = grid_and_fit()
    inverse = grid.inverse_covariances(fit)  # full 3x3: all six of its numbers weigh
    moves = [fit.T, se3.exp(np.array([0.004, -0.003, 0.002, 0.01, -0.02, 0.01])) @ fit.T, np.eye(4)]
    cost = np.empty(3, np.float32)
    ego_kernels.msac(
        np.ascontiguousarray(as_rows(np.array(moves)).T), grid.first, grid.second, inverse, np.float32(9), cost
    )
    xx, xy, xz, yy, yz, zz = inverse.astype(float)
    M = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    for T, told in zip(moves, cost, strict=True):
        miss = grid.second - (T[:3, :3] @ grid.first + T[:3, 3:])
        assert told == pytest.approx(np.minimum(np.einsum("in,ijn,jn->n", miss, M, miss), 9).sum(), rel=1e-4)
