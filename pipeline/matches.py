"""A pair's matches with what is known of their noise: what ego-refinement and the motion channel both start from."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from vlmm_log.pipeline.kernels import Camera, Model
from vlmm_log.settings import EgoSettings, GateSettings, NoiseSettings
from vlmm_log.types import FlowField, Float32, FramePair, UInt8

f32 = np.float32


@dataclass(frozen=True, eq=False)
class Matches:
    """Every pixel of a pair's first frame, its match in the second, and the noise of both."""

    pair: FramePair
    flow: FlowField
    range_first: Float32  # (H, W) m, local 3x3 depth range
    range_second: Float32  # (H, W) m
    tensor: Float32  # (3, H, W) structure tensor of the first image, xx, xy, yy, grey levels^2/px^2
    camera: Camera
    model: Model
    alpha: float  # of the chi-square test

    def arrays(self) -> tuple[Float32, Float32, Float32, Float32, Float32, Float32, Float32]:
        """What the kernels read, in their order."""
        first, second = self.pair.first, self.pair.second
        return (
            first.depth,
            second.depth,
            self.range_first,
            self.range_second,
            self.flow.forward,
            self.flow.fb_error,
            self.tensor,
        )


def match(pair: FramePair, flow: FlowField, gate: GateSettings, noise: NoiseSettings, ego: EgoSettings) -> Matches:
    """Attach the gate and the noise model to the correspondences that the flow found."""
    first, second = pair.first, pair.second
    model = Model(
        fb_px=f32(gate.fb_px),
        depth_band=f32(gate.depth_band),
        occlusion_sigma=f32(gate.occlusion_sigma),
        occlusion_m=f32(gate.occlusion_m),
        z_a=f32(noise.sigma_z_a),
        z_b=f32(noise.sigma_z_b),
        z_z0=f32(noise.sigma_z_z0),
        var_px_first=f32(noise.sigma_px_first**2),
        var_px_second=f32(noise.sigma_px_second**2),
        fb_variance=f32(noise.fb_variance),
        edge_inflation=f32(noise.edge_inflation),
        var_grey=f32(noise.flow_sigma**2),
        flow_lambda=f32(noise.flow_lambda),
        var_rotation=f32(ego.pose_sigma_rad**2 if ego.model == "off" else 0.0),
        var_translation=f32(ego.pose_sigma_m**2 if ego.model == "off" else 0.0),
    )
    K = first.K
    return Matches(
        pair,
        flow,
        local_depth_range(first.depth),
        local_depth_range(second.depth),
        structure_tensor(first.rgb),
        Camera(f32(K[0, 0]), f32(K[1, 1]), f32(K[0, 2]), f32(K[1, 2])),
        model,
        noise.alpha,
    )


def local_depth_range(depth: Float32) -> Float32:
    """Largest minus smallest seen depth (H, W) m in each 3x3 neighbourhood; 0 where nothing is seen."""
    kernel = np.ones((3, 3), np.uint8)
    unseen = np.isnan(depth)
    far = cv2.dilate(np.where(unseen, f32(-1), depth), kernel)
    near = cv2.erode(np.where(unseen, f32(1e4), depth), kernel)
    return np.maximum(far - near, f32(0))


def structure_tensor(rgb: UInt8) -> Float32:
    """Sum of grad grad^T over 9x9 pixels (3, H, W): xx, xy, yy in squared grey levels per squared pixel."""
    grey = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
    gx = cv2.Sobel(grey, cv2.CV_32F, 1, 0, ksize=1, scale=0.5)
    gy = cv2.Sobel(grey, cv2.CV_32F, 0, 1, ksize=1, scale=0.5)
    planes = np.empty((3, *grey.shape), np.float32)
    for plane, product in zip(planes, (gx * gx, gx * gy, gy * gy), strict=True):
        cv2.boxFilter(product, cv2.CV_32F, (9, 9), dst=plane, normalize=False)
    return planes
