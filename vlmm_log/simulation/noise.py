"""What a depth camera makes of exact depth. numpy and a few filters; every random number from the caller's generator.

Sigmas are those of the single pixel, m, at depth z m. Neighbours within 3 px are correlated.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from vlmm_log.simulation.kernels import shadow
from vlmm_log.types import Float32, InputError

BASELINE_M = 0.075
STEP_PX = 0.125  # of the disparity
STEP_NOISE = 0.5  # steps, before they are rounded
KERNEL = cv2.getGaussianKernel(3, 0.6, cv2.CV_32F)
GAIN = float(np.sum(KERNEL**2))  # of the blur, both ways: it leaves this much standard deviation
EDGE = 0.04  # of the depth: a step between neighbours beyond it is an edge
JITTER_PX = 0.8  # lateral sigma. Nguyen et al. 2012, eq. 1
FLAT_RAD = np.deg2rad(82.0)  # Nguyen et al. 2012 measured up to it
GRAZING_RAD = np.deg2rad(80.0)
BLOB_PX = (2, 5)  # radii of holes at random places


@dataclass(frozen=True)
class DepthNoise:
    """A model of the noise, and what share of doubtful pixels goes wrong."""

    model: str = "clean"  # clean, kinect_quadratic, nguyen or disparity
    flying: float = 0.0  # share of the pixels at depth edges that lie between fore- and background
    holes: float = 0.0  # share of what is shadowed or grazed that is unseen
    blobs: float = 0.0  # holes at random places, an image on average

    def __post_init__(self) -> None:
        if self.model not in MODELS:
            raise InputError(f"noise {self.model!r}: there are {', '.join(MODELS)}")
        if not (0 <= self.flying <= 1 and 0 <= self.holes <= 1):
            raise InputError("flying pixels and holes are shares, from 0 to 1")
        if not 0 <= self.blobs <= 1000:
            raise InputError("blobs are holes an image, from 0 to 1000")


def sensor(
    model: str, flying: float | None = None, holes: float | None = None, blobs: float | None = None
) -> DepthNoise:
    """A model with what usually goes with it, where it is not given: nothing with "clean", else a Kinect's edges.

    Raises InputError for a model that is not known or a share out of range.
    """
    usual = (0.0, 0.0, 0.0) if model == "clean" else (0.3, 0.9, 4.0)
    given = [u if g is None else g for g, u in zip((flying, holes, blobs), usual, strict=True)]
    return DepthNoise(model, *given)


def measured(exact: Float32, cosine: Float32, noise: DepthNoise, focal_px: float, rng: np.random.Generator) -> Float32:
    """Depth (H, W) m as the sensor gives it, 0 unseen. ``exact`` is inf where nothing is."""
    depth = np.where(np.isfinite(exact), exact, np.float32(0))
    hidden = _holes(depth, cosine, noise, focal_px, rng)
    flown = _flying(depth, noise.flying, rng)
    noisy = MODELS[noise.model](flown, cosine, focal_px, rng)
    return np.where(hidden | (depth <= 0), np.float32(0), np.maximum(noisy, 0)).astype(np.float32)


def quadratic_sigma(z: Float32) -> Float32:
    """Sigma m of "kinect_quadratic": 0.0012 + 0.0028 z^2."""
    return np.asarray(0.0012 + 0.0028 * z * z, np.float32)


def nguyen_sigma(z: Float32, cosine: Float32) -> Float32:
    """Axial sigma m. Nguyen, Izadi, Lovell, 3DIMPVT 2012, eq. 2 and 3; the angle's term up to 82 degrees."""
    theta = np.minimum(np.arccos(np.clip(cosine, 0.0, 1.0)), FLAT_RAD)
    angle = 0.0001 / np.sqrt(np.maximum(z, 0.1)) * (theta / (np.pi / 2 - theta)) ** 2
    return np.asarray(0.0012 + 0.0019 * (z - 0.4) ** 2 + angle, np.float32)


def _clean(z: Float32, _cosine: Float32, _focal_px: float, _rng: np.random.Generator) -> Float32:
    return z


def _quadratic(z: Float32, _cosine: Float32, _focal_px: float, rng: np.random.Generator) -> Float32:
    return z + quadratic_sigma(z) * _correlated(z.shape, rng)


def _nguyen(z: Float32, cosine: Float32, _focal_px: float, rng: np.random.Generator) -> Float32:
    wobbly = _jittered(z, rng)
    return wobbly + nguyen_sigma(wobbly, cosine) * _correlated(z.shape, rng)


def _disparity(z: Float32, _cosine: Float32, focal_px: float, rng: np.random.Generator) -> Float32:
    """Khoshelham, Elberink, Sensors 2012: disparity in steps of 1/8 px."""
    reach = np.float32(BASELINE_M * focal_px)
    steps = reach / np.maximum(z, np.float32(0.1)) / np.float32(STEP_PX)
    rounded = np.maximum(np.rint(steps + np.float32(STEP_NOISE) * _correlated(z.shape, rng)), 1)
    return np.asarray(reach / (rounded * np.float32(STEP_PX)), np.float32)


MODELS: dict[str, Callable[[Float32, Float32, float, np.random.Generator], Float32]] = {
    "clean": _clean,
    "kinect_quadratic": _quadratic,
    "nguyen": _nguyen,
    "disparity": _disparity,
}


def _correlated(shape: tuple[int, ...], rng: np.random.Generator) -> Float32:
    """Gaussian of sigma 1, correlated over 3 px."""
    white = rng.standard_normal(shape, np.float32)
    return np.asarray(cv2.sepFilter2D(white, -1, KERNEL, KERNEL, borderType=cv2.BORDER_REFLECT) / GAIN, np.float32)


def _jittered(z: Float32, rng: np.random.Generator) -> Float32:
    """Depth with its edges displaced; surfaces stay, since the axial sigma holds what happens on them."""
    H, W = z.shape
    v, u = np.mgrid[0:H, 0:W].astype(np.float32)
    du, dv = JITTER_PX * _correlated(z.shape, rng), JITTER_PX * _correlated(z.shape, rng)
    other = cv2.remap(z, u + du, v + dv, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)
    return np.where(np.abs(other - z) > EDGE * z, other, z).astype(np.float32)


def _flying(z: Float32, share: float, rng: np.random.Generator) -> Float32:
    if share == 0:
        return z
    near, far = cv2.erode(z, np.ones((3, 3), np.uint8)), cv2.dilate(z, np.ones((3, 3), np.uint8))
    edge = (far - near > EDGE * near) & (near > 0)
    v, u = np.nonzero(edge)
    chosen = rng.random(v.size) < share
    v, u = v[chosen], u[chosen]
    out = z.copy()
    out[v, u] = near[v, u] + rng.random(v.size, np.float32) * (far[v, u] - near[v, u])
    return out


def _holes(
    z: Float32, cosine: Float32, noise: DepthNoise, focal_px: float, rng: np.random.Generator
) -> NDArray[np.bool_]:
    lost = np.zeros(z.shape, bool)
    if noise.holes > 0:
        shadow(lost, z, BASELINE_M * focal_px)
        lost |= cosine < np.cos(GRAZING_RAD)
        v, u = np.nonzero(lost)
        lost[v, u] = rng.random(v.size) < noise.holes
    if noise.blobs > 0:
        spots = lost.astype(np.uint8)
        for _ in range(rng.poisson(noise.blobs)):
            at = (int(rng.integers(z.shape[1])), int(rng.integers(z.shape[0])))
            cv2.circle(spots, at, int(rng.integers(*BLOB_PX, endpoint=True)), 1, -1)
        lost = spots > 0
    return lost
