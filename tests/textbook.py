"""The motion channel as the paper writes it, in float64 and in the world frame: what the kernels must agree with."""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

from vlmm_log import se3
from vlmm_log.pipeline.matches import Matches
from vlmm_log.types import Ego, Validity


def motion(matches: Matches, ego: Ego) -> dict[str, np.ndarray]:
    """residual (3, H, W) m in the world, sigma (H, W, 3, 3) m^2, d_m, p_stat; gate as validity before occlusion.

    Everything is computed for every pixel; where the gate fails the values mean nothing.
    """
    first, second, m = matches.pair.first, matches.pair.second, matches.inputs.model
    H, W = first.depth.shape
    K = first.K
    v, u = np.mgrid[0:H, 0:W].astype(np.float64)
    target = np.stack([u, v], -1) + matches.flow.forward.astype(np.float64)
    za = first.depth.astype(np.float64)
    inside = ((target >= 0) & (target <= [W - 1, H - 1])).all(-1)
    at = np.where(inside[..., None], target, 0.0)
    zb = depth_at(second.depth.astype(np.float64), at, float(m.depth_band))

    Xa = back_project(K, np.stack([u, v], -1), za)
    Xb = back_project(K, at, zb)
    Ta = np.eye(4) if first.T_world_cam is None else first.T_world_cam
    Tb = np.eye(4) if second.T_world_cam is None else second.T_world_cam
    # Per image row: the refined relative pose, and with it (R^, t^) of the paper, a motion of world points.
    rows = se3.exp((np.arange(H) / H - 0.5)[:, None] * ego.row_twist) @ ego.T_second_first
    correction = Tb @ rows @ se3.inverse(Ta)
    Xa_w, Xb_w = Xa @ Ta[:3, :3].T + Ta[:3, 3], Xb @ Tb[:3, :3].T + Tb[:3, 3]
    R_hat, t_hat = correction[:, None, :3, :3], correction[:, None, :3, 3]
    moved = np.einsum("vuij,vuj->vui", np.broadcast_to(R_hat, (H, W, 3, 3)), Xa_w) + t_hat
    residual = Xb_w - moved

    half_range_a = float(m.edge_inflation) * matches.inputs.range_first.astype(np.float64)
    nearest = np.floor(at + 0.5).astype(int)
    half_range_b = (
        float(m.edge_inflation) * matches.inputs.range_second.astype(np.float64)[nearest[..., 1], nearest[..., 0]]
    )
    Sa = end_covariance(K, Xa, float(m.var_px_first) * np.eye(2), sigma_z(m, za) ** 2 + half_range_a**2)
    fb = matches.flow.fb_error.astype(np.float64)
    same = float(m.var_px_second) + float(m.fb_variance) * fb**2
    same = same + float(m.var_displacement) * (matches.flow.forward.astype(np.float64) ** 2).sum(-1)
    C = same[..., None, None] * np.eye(2)
    c = matches.inputs.flow_covariance.astype(np.float64)
    C = C + np.stack([np.stack([c[0], c[1]], -1), np.stack([c[1], c[2]], -1)], -2)
    Sb = end_covariance(K, Xb, C, sigma_z(m, zb) ** 2 + half_range_b**2)
    to_world_a = R_hat @ Ta[:3, :3]
    sigma = Tb[:3, :3] @ Sb @ Tb[:3, :3].T + to_world_a @ Sa @ np.swapaxes(to_world_a, -1, -2)
    # Uncertain pose: var_t I + var_r (|p|^2 I - p p^T), p the moved point in camera b
    p = (moved - Tb[:3, 3]) @ Tb[:3, :3]
    var_r, var_t = np.diag(ego.covariance).reshape(2, 3).mean(axis=1)
    pose = var_t * np.eye(3) + var_r * ((p**2).sum(-1)[..., None, None] * np.eye(3) - p[..., :, None] * p[..., None, :])
    sigma = sigma + Tb[:3, :3] @ pose @ Tb[:3, :3].T

    d2 = np.einsum("vui,vuij,vuj->vu", residual, np.linalg.inv(np.where(np.isnan(sigma), np.eye(3), sigma)), residual)
    gate = np.full((H, W), Validity.VALID, np.uint8)
    gate[inside & ~(fb < float(m.fb_px))] = Validity.FB_INCONSISTENT
    gate[inside & np.isnan(zb)] = Validity.NO_DEPTH
    gate[~inside] = Validity.OUT_OF_VIEW
    gate[np.isnan(za)] = Validity.NO_DEPTH
    behind = p[..., 2] - zb
    along = np.sqrt(np.einsum("i,vuij,j->vu", Tb[:3, 2], sigma, Tb[:3, 2]))
    limit = np.maximum(float(m.occlusion_sigma) * along, float(m.occlusion_m))
    seen = np.isin(gate, (Validity.VALID, Validity.FB_INCONSISTENT))
    if m.occlusion_sigma > 0:
        gate[seen & (behind > limit)] = Validity.OCCLUDED
    p_stat = chi2.sf(d2, 3)
    return {
        "p_stat": p_stat,
        "residual": np.moveaxis(residual, -1, 0),
        "sigma": sigma,
        "d_m": np.sqrt(d2),
        "gate": gate,
        "along": along,
    }


def back_project(K: np.ndarray, pixels: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Points (..., 3) of pixels (..., 2) at depth z. Paper, Eq. 2."""
    return z[..., None] * (np.concatenate([pixels, np.ones_like(pixels[..., :1])], -1) @ np.linalg.inv(K).T)


def end_covariance(K: np.ndarray, X: np.ndarray, lateral: np.ndarray, var_z: np.ndarray) -> np.ndarray:
    """J diag(lateral, var_z) J^T, J = [z/fx e1, z/fy e2, X/z]. Paper, Eq. 6."""
    z = X[..., 2]
    J = np.zeros((*z.shape, 3, 3))
    J[..., 0, 0], J[..., 1, 1] = z / K[0, 0], z / K[1, 1]
    J[..., :, 2] = X / z[..., None]
    inner = np.zeros_like(J)
    inner[..., :2, :2], inner[..., 2, 2] = lateral, var_z
    return np.einsum("...ij,...jk,...lk->...il", J, inner, J)


def sigma_z(m, z: np.ndarray) -> np.ndarray:
    """Axial noise a + b (z - z0)^2 m. Nguyen, Izadi, Lovell 2012."""
    return float(m.z_a) + float(m.z_b) * (z - float(m.z_z0)) ** 2


def depth_at(depth: np.ndarray, at: np.ndarray, band: float) -> np.ndarray:
    """Bilinear over the neighbours within band * z of the nearest one's depth z; NaN where that is unseen."""
    H, W = depth.shape
    x0, y0 = np.minimum(at[..., 0].astype(int), W - 2), np.minimum(at[..., 1].astype(int), H - 2)
    ax, ay = at[..., 0] - x0, at[..., 1] - y0
    nearest = depth[y0 + (ay >= 0.5), x0 + (ax >= 0.5)]
    total, weight = np.zeros(nearest.shape), np.zeros(nearest.shape)
    for dy, wy in ((0, 1 - ay), (1, ay)):
        for dx, wx in ((0, 1 - ax), (1, ax)):
            z = depth[y0 + dy, x0 + dx]
            w = np.where(np.abs(z - nearest) <= band * nearest, wx * wy, 0.0)
            total, weight = total + np.where(w > 0, w * z, 0.0), weight + w
    with np.errstate(invalid="ignore"):
        return np.where(np.isnan(nearest), np.nan, total / np.where(weight > 0, weight, np.nan))


def round_trip(forward: np.ndarray, backward: np.ndarray) -> np.ndarray:
    """|w_ab(u) + w_ba(u + w_ab(u))| with w_ba bilinear, NaN out of view."""
    H, W = forward.shape[:2]
    v, u = np.mgrid[0:H, 0:W].astype(np.float64)
    at = np.stack([u, v], -1) + forward
    inside = ((at >= 0) & (at <= [W - 1, H - 1])).all(-1)
    at = np.where(inside[..., None], at, 0.0)
    x0, y0 = np.minimum(at[..., 0].astype(int), W - 2), np.minimum(at[..., 1].astype(int), H - 2)
    ax, ay = (at[..., 0] - x0)[..., None], (at[..., 1] - y0)[..., None]
    top = (1 - ax) * backward[y0, x0] + ax * backward[y0, x0 + 1]
    bottom = (1 - ax) * backward[y0 + 1, x0] + ax * backward[y0 + 1, x0 + 1]
    return np.where(inside, np.linalg.norm(forward + (1 - ay) * top + ay * bottom, axis=-1), np.nan)


def aggregate(pair, segments, motion, s) -> list[dict[str, object]]:
    """What a pair shows of each instance, mask by mask in float64 (paper, Eqs. 9 to 11)."""
    rows = []
    K = pair.first.K
    for k in range(len(segments)):
        mask = segments.labels == k + 1
        scored = mask & np.isfinite(motion.d_m)
        d, m = motion.d_m[scored].astype(float), motion.residual[:, scored].astype(float)
        unit = m / np.where(np.linalg.norm(m, axis=0) > 0, np.linalg.norm(m, axis=0), 1.0)
        above = d > motion.tau_px
        n = max(d.size, 1)
        gamma_all = np.linalg.norm(unit.sum(axis=1)) / n
        gamma = np.linalg.norm(unit[:, above].sum(axis=1)) / max(above.sum(), 1)
        phi = above.sum() / n
        coherence = gamma if s.coherence == "flagged" else gamma_all
        v, u = np.nonzero(mask & np.isfinite(pair.first.depth))
        z = pair.first.depth[v, u].astype(float)
        row = {"pixels": mask.sum(), "scored": d.size, "phi": phi, "gamma": coherence, "gamma_all": gamma_all}
        row |= {"kappa": phi * coherence, "o": np.quantile(d, s.quantile) if d.size else np.nan}
        row["part"] = _part(mask, motion) / max(mask.sum(), 1)
        row["drift"] = m[:, above].mean(axis=1) if above.any() else np.zeros(3)
        if z.size:
            low, high = np.quantile(z, [0.25, 0.75])
            reach = 1.5 * (high - low) + 0.02
            kept = (z >= low - reach) & (z <= high + reach)
            X = back_project(K, np.stack([u, v], axis=1)[kept].astype(float), z[kept])
            row |= {"mean": X.mean(axis=0), "cov": np.cov(X.T, bias=True).reshape(3, 3)}
        rows.append(row)
    return rows


def _part(mask: np.ndarray, motion) -> int:
    """Scored pixels in 16x16 tiles that a mask all but fills with scored pixels, most of them above tau_px."""
    total = 0
    for v in range(0, mask.shape[0], 16):
        for u in range(0, mask.shape[1], 16):
            d = motion.d_m[v : v + 16, u : u + 16][mask[v : v + 16, u : u + 16]]
            d = d[np.isfinite(d)]
            if 10 * d.size >= 9 * 256 and (d > motion.tau_px).sum() > d.size / 2:
                total += d.size
    return total
