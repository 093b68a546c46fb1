"""Logs of one's own, made of frames in memory: a wall of random texture 2 m ahead, a box 1.2 m ahead before it."""

import cv2
import numpy as np

from vlmm_log.types import Frame

SIZE = (120, 160)
K = np.array([[150.0, 0, 79.5], [0, 150, 59.5], [0, 0, 1]])
HERE = np.eye(4)
ORIGIN_NS, STEP_NS = 10**18, 33_000_000


class OwnLog:
    """What protocols.Log asks for."""

    name, world_up, notes = "own", "+z", ()

    def __init__(self, frames):
        self.held = frames
        self.has_poses = any(f.T_world_cam is not None for f in frames)

    def count(self, start_ns, stop_ns):
        return len(self.held)

    def frames(self, start_ns, stop_ns):
        yield from self.held


def texture(size=SIZE):
    values = np.random.default_rng(1).integers(0, 256, (*size, 3), np.uint8)
    return cv2.GaussianBlur(values, (0, 0), 1.2)


def room_depth(size=SIZE):
    H, W = size
    depth = np.full(size, 2.0, np.float32)
    depth[H // 3 : 2 * H // 3, W // 3 : 2 * W // 3] = 1.2
    return depth


def own_frame(k, *, size=SIZE, rgb=None, depth=None, K=K, T=HERE, stamp_ns=None):
    """Frame k; its texture has moved right by k px."""
    rgb = np.roll(texture(size), k, axis=1) if rgb is None else rgb
    depth = room_depth(size) if depth is None else depth
    stamp_ns = ORIGIN_NS + k * STEP_NS if stamp_ns is None else stamp_ns
    return Frame(stamp_ns, k, rgb.copy(), depth.copy(), K.copy(), None if T is None else T.copy())


def own_frames(n=3, **options):
    return [own_frame(k, **options) for k in range(n)]


def posed(poses):
    return [own_frame(k, T=T) for k, T in enumerate(poses)]


def at(x=0.0, y=0.0, z=0.0, R=None):
    T = np.eye(4)
    T[:3, :3] = np.eye(3) if R is None else R
    T[:3, 3] = x, y, z
    return T
