"""A pair's matches with what is known of their noise: what ego-refinement and the motion channel both start from."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from vlmm_log.pipeline import flow_kernels
from vlmm_log.pipeline.kernels import Camera, Inputs, Model
from vlmm_log.settings import GateSettings, NoiseSettings
from vlmm_log.types import Float32, FlowField, FramePair, UInt8

f32 = np.float32


@dataclass(frozen=True, eq=False)
class Matches:
    """Every pixel of a pair's first frame, its match in the second, and the noise of both."""

    pair: FramePair
    flow: FlowField
    inputs: Inputs  # for the kernels: depths, flow, and the noise of both
    alpha: float  # of the chi-square test


def match(pair: FramePair, flow: FlowField, gate: GateSettings, noise: NoiseSettings) -> Matches:
    """Attach the gate and the noise model to the correspondences that the flow found."""
    first, second = pair.first, pair.second
    k = noise.scale
    model = Model(
        fb_px=f32(gate.fb_px),
        depth_band=f32(gate.depth_band),
        occlusion_sigma=f32(gate.occlusion_sigma),
        occlusion_m=f32(gate.occlusion_m),
        z_a=f32(k * noise.sigma_z_a),
        z_b=f32(k * noise.sigma_z_b),
        z_z0=f32(noise.sigma_z_z0),
        var_px_first=f32((k * noise.sigma_px_first) ** 2),
        var_px_second=f32((k * noise.sigma_px_second) ** 2),
        fb_variance=f32(k**2 * noise.fb_variance),
        var_displacement=f32((k * noise.displacement) ** 2),
        edge_inflation=f32(k * noise.edge_inflation),
        var_rotation=f32(0),  # of the relative pose: known once it is refined
        var_translation=f32(0),
    )
    K = first.K
    inputs = Inputs(
        first.depth,
        second.depth,
        local_depth_range(first.depth),
        local_depth_range(second.depth),
        flow.forward,
        flow.fb_error,
        flow_covariance(first.rgb, flow.forward, noise),
        Camera(f32(K[0, 0]), f32(K[1, 1]), f32(K[0, 2]), f32(K[1, 2])),
        model,
    )
    return Matches(pair, flow, inputs, noise.alpha)


def local_depth_range(depth: Float32) -> Float32:
    """Largest minus smallest seen depth (H, W) m in each 3x3 neighbourhood; 0 where nothing is seen."""
    kernel = np.ones((3, 3), np.uint8)
    far, near = depth.copy(), depth.copy()
    cv2.patchNaNs(far, -1.0)
    cv2.patchNaNs(near, 1e4)
    cv2.dilate(far, kernel, dst=far)
    cv2.erode(near, kernel, dst=near)
    return np.asarray(np.maximum(far - near, f32(0)), np.float32)


def flow_covariance(rgb: UInt8, forward: Float32, noise: NoiseSettings) -> Float32:
    """Covariance (3, H, W) px^2 of the flow, xx, xy, yy, from the image's texture and the flow around.

    Lucas and Kanade 1981, Simoncelli et al. 1991: s_I^2 (G - N + lambda I)^-1 with G the structure tensor and N the
    energy that sensor noise adds to it. And flow that changes fast nearby is flow whose borders are uncertain.
    """
    out = np.empty((3, *forward.shape[:2]), np.float32)
    floor = WINDOW**2 / 2 * noise.grey_sigma**2  # a central difference halves the variance
    flow_kernels.flow_covariance(
        structure_tensor(rgb),
        flow_spread(forward, noise.scale * noise.flow_spread),
        f32((noise.scale * noise.flow_sigma) ** 2),
        f32(floor),
        f32(noise.flow_lambda),
        out,
    )
    return out


WINDOW = 9  # px, of the structure tensor


def structure_tensor(rgb: UInt8) -> Float32:
    """Sum of grad grad^T over 9x9 pixels (3, H, W): xx, xy, yy in squared grey levels per squared pixel."""
    grey = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
    gx = cv2.Sobel(grey, cv2.CV_32F, 1, 0, ksize=1, scale=0.5)
    gy = cv2.Sobel(grey, cv2.CV_32F, 0, 1, ksize=1, scale=0.5)
    planes = np.empty((3, *grey.shape), np.float32)
    for plane, product in zip(planes, (gx * gx, gx * gy, gy * gy), strict=True):
        cv2.boxFilter(product, cv2.CV_32F, (WINDOW, WINDOW), dst=plane, normalize=False)
    return planes


def flow_spread(forward: Float32, factor: float) -> Float32:
    """Variance (H, W) px^2: ``factor`` squared times that of the flow over about 36x36 pixels.

    The camera's own part, smooth over the whole image, is taken out first as a robust quadratic polynomial.
    """
    H, W = forward.shape[:2]
    if factor == 0:
        return np.zeros((H, W), np.float32)
    coarse = cv2.resize(forward, (W // 4, H // 4), interpolation=cv2.INTER_AREA)
    basis = _quadratic(*coarse.shape[:2])
    some, seen = basis[::4, ::4].reshape(-1, 6), coarse[::4, ::4].reshape(-1, 2)
    weight = np.ones(len(some), np.float32)
    for _ in range(5):
        trend = np.linalg.lstsq(some * weight[:, None], seen * weight[:, None], rcond=None)[0]
        miss = np.linalg.norm(seen - some @ trend, axis=1)
        weight = 1.0 / (1.0 + miss / (np.median(miss) + f32(1e-3)))
    rest = coarse - basis @ trend
    mean = cv2.blur(rest, (9, 9))
    variance = np.maximum(cv2.blur(rest * rest, (9, 9)) - mean * mean, 0).sum(axis=-1)
    return np.asarray(cv2.resize(variance * f32(factor**2), (W, H), interpolation=cv2.INTER_LINEAR), np.float32)


@lru_cache(maxsize=4)
def _quadratic(h: int, w: int) -> Float32:
    """(h, w, 6) the terms of a quadratic polynomial over an image, from -1 to 1."""
    y, x = np.mgrid[-1 : 1 : h * 1j, -1 : 1 : w * 1j].astype(np.float32)
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)
