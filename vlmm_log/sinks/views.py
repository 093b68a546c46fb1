"""What a recording shows of dense results: thinner grids, half precision, colours."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from vlmm_log.types import Float32, Float64, Frame, Motion, Outcome, UInt8, Validity

VALIDITY_COLORS: dict[Validity, tuple[int, int, int]] = {  # told apart also by the colour-blind (Okabe and Ito)
    Validity.VALID: (0, 114, 178),
    Validity.NO_DEPTH: (40, 40, 40),
    Validity.OUT_OF_VIEW: (204, 121, 167),
    Validity.FB_INCONSISTENT: (230, 159, 0),
    Validity.OCCLUDED: (240, 228, 66),
    Validity.OUT_OF_RANGE: (213, 94, 0),
}


TRUTH_COLORS: dict[int, tuple[str, tuple[int, int, int]]] = {
    0: ("static", (0, 114, 178)),
    128: ("ignored", (120, 120, 120)),
    255: ("moving", (213, 94, 0)),
}
OUTCOME_COLORS: dict[Outcome, tuple[int, int, int]] = {
    Outcome.QUIET: (40, 40, 40),
    Outcome.HIT: (0, 158, 115),
    Outcome.MISS: (213, 94, 0),
    Outcome.LOST: (230, 159, 0),
    Outcome.FALSE_FLAG: (204, 121, 167),
    Outcome.IGNORED: (120, 120, 120),
}


def half(values: NDArray[np.floating], factor: float = 1.0) -> NDArray[np.float16]:
    """``factor`` times the values in half precision, clipped to what it can hold."""
    most = 65504.0 / factor
    return np.asarray(np.clip(np.ascontiguousarray(values), -most, most) * factor, np.float16)


def flow_color(flow: Float32) -> UInt8:
    """(h, w, 3) RGB at half the resolution: direction as hue, length as saturation, 99th percentile full."""
    size = (-(-flow.shape[1] // 2), -(-flow.shape[0] // 2))
    u, v = cv2.split(cv2.resize(flow, size, interpolation=cv2.INTER_NEAREST))
    length, angle = cv2.cartToPolar(u, v, angleInDegrees=True)
    longest = max(float(np.percentile(length[::4, ::4], 99)), 1.0)
    hue, saturation = cv2.convertScaleAbs(angle, alpha=0.5), cv2.convertScaleAbs(length, alpha=255.0 / longest)
    hsv = cv2.merge([hue, saturation, np.full_like(hue, 255)])
    return np.asarray(cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB), np.uint8)


def arrows(flow: Float32, spacing: int = 16) -> tuple[Float32, Float32]:
    """Origins and vectors (N, 2) px of the flow on a grid."""
    v, u = np.mgrid[spacing // 2 : flow.shape[0] : spacing, spacing // 2 : flow.shape[1] : spacing]
    origins = np.stack([u.ravel(), v.ravel()], axis=1).astype(np.float32)
    return origins, _drawn(flow[v.ravel(), u.ravel()])


def moved_arrows(motion: Motion, frame: Frame, second: Frame, spacing: int = 16) -> tuple[Float32, Float32]:
    """Origins and vectors (N, 2) px: where flagged pixels went against the static world, across the image."""
    flagged = motion.d_m[::spacing, ::spacing] > motion.tau_px  # False where NaN
    v, u = np.nonzero(flagged)
    v, u = v * spacing, u * spacing
    R_b_world: Float64 = np.eye(3) if second.T_world_cam is None else second.T_world_cam[:3, :3].T
    in_camera = R_b_world @ motion.residual[:, v, u].astype(np.float64)
    focal = np.array([frame.K[0, 0], frame.K[1, 1]])
    vectors = (in_camera[:2] / frame.depth[v, u]).T * focal
    return np.stack([u, v], axis=1).astype(np.float32), _drawn(vectors)


def _drawn(vectors: NDArray[np.floating]) -> Float32:
    """Vectors to a millionth of a pixel: their ends, which MCAP holds instead, give them back to the bit."""
    return np.asarray(np.round(vectors * 2.0**20) * 2.0**-20, np.float32)
