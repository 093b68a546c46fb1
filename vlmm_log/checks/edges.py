"""Whether depth lies where colour says: depth discontinuities on image edges, under shifts, flips and delays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from vlmm_log.types import Float32, Frame, UInt8

SHIFT = 24  # px, largest shift tried
HALF = SHIFT // 2  # at the half size that edges are compared at
JUMP = 0.06  # a depth discontinuity, as a share of depth
FEWEST = 80  # edge pixels at half size; with fewer, nothing is said
FLIPS = {"left and right": 1, "top and bottom": 0, "both": -1}  # cv2.flip's codes


@dataclass(frozen=True, eq=False)
class Alignment:
    """Correlations of a colour image's edges with those of depth images; in [-1, 1], NaN where depth has none."""

    delays_s: tuple[float, ...]  # stamps of the depth images minus the colour image's, ascending
    own: int  # which of them is the frame's own
    shifts: Float32  # (delays, 2 HALF + 1, 2 HALF + 1) depth moved down and right by 2 (row - HALF, column - HALF) px
    flipped: dict[str, float]  # best over all shifts of the own depth image, by name of FLIPS
    flow_px_s: float = 0.0  # how fast the image moves there


def align(frame: Frame, depths: Mapping[int, tuple[float, Float32]]) -> Alignment:
    """Correlate a frame's colour with depth images: by their distance in frames, with their delay in s."""
    image = _image_edges(frame.rgb)
    steps = sorted(depths)
    edges = {k: _depth_edges(depths[k][1]) for k in steps}
    shifts = np.stack([_correlation(image, edges[k]) for k in steps])
    flipped = {
        name: float(np.max(_correlation(image, np.asarray(cv2.flip(edges[0], code), np.float32))))
        for name, code in FLIPS.items()
    }
    return Alignment(tuple(depths[k][0] for k in steps), steps.index(0), shifts, flipped)


def _image_edges(rgb: UInt8) -> Float32:
    """(H / 2, W / 2) strength in [0, 1]."""
    grey = cv2.GaussianBlur(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), (0, 0), 1.0)
    strength = cv2.magnitude(cv2.Sobel(grey, cv2.CV_32F, 1, 0), cv2.Sobel(grey, cv2.CV_32F, 0, 1))
    strong = np.quantile(strength[::4, ::4], 0.9) + 1e-6
    return _halved(np.minimum(strength / np.float32(strong), np.float32(1)))


def _depth_edges(depth: Float32) -> Float32:
    """(H / 2, W / 2) share of pixels on the nearer side of a jump: it is there that colour changes too."""
    kernel = np.ones((3, 3), np.uint8)
    seen = np.isfinite(depth)
    far = cv2.dilate(np.where(seen, depth, np.float32(-1)), kernel)
    return _halved((seen & (far - depth > JUMP * depth)).astype(np.float32))


def _halved(image: NDArray[np.float32]) -> Float32:
    return np.asarray(cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), np.float32)


def _correlation(image: Float32, edges: Float32) -> Float32:
    inner = edges[HALF:-HALF, HALF:-HALF]
    if edges.shape != image.shape or min(inner.shape, default=0) < HALF or np.count_nonzero(inner) < FEWEST:
        return np.full((2 * HALF + 1, 2 * HALF + 1), np.nan, np.float32)
    return np.asarray(cv2.matchTemplate(image, inner, cv2.TM_CCOEFF_NORMED), np.float32)
