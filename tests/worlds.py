"""Pairs of frames with known truth, for the tests of the method."""

from __future__ import annotations

import numpy as np

import render_room
from textbook import sigma_z
from vlmm_log import se3
from vlmm_log.pipeline.matches import Matches, match
from vlmm_log.settings import Settings
from vlmm_log.types import FlowField, Frame, FramePair

# The noise that a pure geometric test can draw exactly: no term that is read off the images.
GEOMETRIC = ("noise.fb_variance=0", "noise.displacement=0", "noise.flow_sigma=0", "noise.flow_spread=0")
PLAIN = (*GEOMETRIC, "noise.edge_inflation=0", "noise.sigma_px_first=0.5", "noise.sigma_px_second=0.5")


def room_pair(
    twist, rng: np.random.Generator | None = None, *, sets=PLAIN, elapsed_s=0.0, poses=True
) -> tuple[Matches, np.ndarray]:
    """The rendered room from two cameras ``twist`` apart, with noise as the settings' model has it, and the labels.

    Flow is exact, with the lateral noise of both ends in it. With ``elapsed_s`` the movers move.
    """
    s = Settings.load(sets=sets)
    T_a = render_room.pose(0.3)
    T_b = T_a @ se3.exp(np.asarray(twist, float))
    a, b = render_room.render(T_a, 0.0), render_room.render(T_b, elapsed_s)
    forward = render_room.flow(a, T_b, elapsed_s)
    depth_a, depth_b = a.depth.copy(), b.depth.copy()
    if rng is not None:
        n = s.noise
        lateral = rng.normal(0, np.hypot(n.sigma_px_first, n.sigma_px_second), forward.shape)
        forward = forward + lateral
        model = match(_pair(a, b, depth_a, depth_b, None, None), _still(forward), s.gate, n).inputs.model
        depth_a += rng.standard_normal(depth_a.shape) * sigma_z(model, depth_a)
        depth_b += rng.standard_normal(depth_b.shape) * sigma_z(model, depth_b)
    pair = _pair(a, b, depth_a, depth_b, T_a if poses else None, T_b if poses else None)
    return match(pair, _still(forward), s.gate, s.noise), a.labels


def random_matches(rng: np.random.Generator, *, sets=(), poses=True, profile="default") -> Matches:
    """Anything goes: random depth with holes, random flow that also leaves the image, random images."""
    H, W = 96, 128
    s = Settings.load(profile, sets=sets)
    K = np.array([[110.0, 0, 63.2], [0, 108.0, 47.9], [0, 0, 1]])

    def frame(k):
        depth = (1.5 + 0.3 * rng.random((H, W))).astype(np.float32)
        depth[rng.random((H, W)) < 0.05] = np.nan
        rgb = rng.integers(0, 256, (H, W, 3), np.uint8)
        T = se3.exp(rng.normal(0, 0.5, 6)) if poses else None
        return Frame(k, k, rgb, depth, K, T)

    forward = rng.normal(0, 3, (H, W, 2)).astype(np.float32)
    flow = FlowField(forward, -forward, np.abs(rng.normal(0, 1.2, (H, W))).astype(np.float32))
    return match(FramePair(frame(0), frame(1)), flow, s.gate, s.noise)


def _still(forward: np.ndarray) -> FlowField:
    forward = forward.astype(np.float32)
    return FlowField(forward, -forward, np.zeros(forward.shape[:2], np.float32))


def _pair(a, b, depth_a, depth_b, T_a, T_b) -> FramePair:
    K = render_room.K
    first = Frame(0, 0, a.rgb, depth_a.astype(np.float32), K, T_a)
    return FramePair(first, Frame(10**8, 3, b.rgb, depth_b.astype(np.float32), K, T_b))
