"""Render a small room with a rolling ball and a sliding box to a folder in TUM RGB-D layout.

    python examples/render_room.py OUT [FRAMES]

Analytic ray casting in numpy: exact depth, poses, flow and instance masks (OUT/masks). Noise is Kinect-like, from a
seed.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from scipy.ndimage import map_coordinates

WIDTH, HEIGHT, FOCAL = 640, 480, 525.0
K = np.array([[FOCAL, 0, (WIDTH - 1) / 2], [0, FOCAL, (HEIGHT - 1) / 2], [0, 0, 1]])
ROOM = np.array([[-2.2, -1.4, -0.5], [2.2, 1.2, 4.0]])  # m: x right, y down, z ahead
SPEED = {1: np.array([0.5, 0.0, -0.15]), 2: np.array([0.0, 0.0, 0.0]), 3: np.array([-0.4, 0.0, 0.0])}  # m/s by label
NAMES = {1: "ball", 2: "shelf", 3: "box"}
FRAME_S = 1 / 30


@dataclass(frozen=True)
class View:
    """One rendered image."""

    rgb: np.ndarray  # (H, W, 3) u8
    depth: np.ndarray  # (H, W) m
    labels: np.ndarray  # (H, W) 0 room, 1 ball, 2 shelf (still), 3 sliding box
    points: np.ndarray  # (H, W, 3) m, in the world


def pose(time_s: float) -> np.ndarray:
    """Camera-to-world (4, 4) of a hand-held camera: it sways, and its world has z up."""
    yaw, pitch = 0.12 * np.sin(1.3 * time_s), 0.05 * np.sin(1.9 * time_s + 1)
    cy, sy, cp, sp = np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch)
    T = np.eye(4)
    T[:3, :3] = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]]) @ np.array([[1, 0, 0], [0, cp, -sp], [0, sp, cp]])
    T[:3, 3] = 0.15 * np.sin(1.1 * time_s), 0.05 * np.sin(1.7 * time_s), 0.1 * np.sin(0.9 * time_s)
    return T


def render(T_world_cam: np.ndarray, time_s: float, *, moving: bool = True) -> View:
    """The room from a camera pose, its movers where they are at a time."""
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH].astype(np.float64)
    rays = np.stack([(u - K[0, 2]) / FOCAL, (v - K[1, 2]) / FOCAL, np.ones_like(u)], -1) @ T_world_cam[:3, :3].T
    origin = T_world_cam[:3, 3]
    moment = time_s if moving else 0.0
    shift = {label: speed * moment for label, speed in SPEED.items()}
    depth = _slabs(origin, rays, *ROOM)[1]
    labels = np.zeros(depth.shape, np.uint8)
    solids = {
        1: _ball(origin, rays, np.array([-0.6, 0.85, 2.2]) + shift[1], 0.3),
        2: _box(origin, rays, np.array([-1.9, -0.4, 2.6]), np.array([-1.1, 1.2, 3.3])),
        3: _box(origin, rays, np.array([0.5, 0.3, 2.3]) + shift[3], np.array([1.1, 1.2, 2.8]) + shift[3]),
    }
    for label, hit in solids.items():
        nearer = hit < depth
        depth, labels = np.where(nearer, hit, depth), np.where(nearer, np.uint8(label), labels)
    points = origin + rays * depth[..., None]
    own = points - sum((labels == label)[..., None] * shift[label] for label in shift)  # texture moves along
    return View(_texture(own, labels), depth, labels, points)


def flow(first: View, T_world_second: np.ndarray, elapsed_s: float) -> np.ndarray:
    """Exact optical flow (H, W, 2) px from a view to a later camera."""
    moved = first.points + sum((first.labels == k)[..., None] * speed * elapsed_s for k, speed in SPEED.items())
    seen = (moved - T_world_second[:3, 3]) @ T_world_second[:3, :3] @ K.T
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH]
    return seen[..., :2] / seen[..., 2:] - np.stack([u, v], -1)


def noisy_depth(depth: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Depth m with axial noise (Nguyen et al. 2012), correlated over 3 px, and holes at depth edges."""
    noise = cv2.GaussianBlur(rng.standard_normal(depth.shape), (3, 3), 0.8)
    noisy = depth + noise / noise.std() * (0.0012 + 0.0019 * (depth - 0.4) ** 2)
    kernel = np.ones((3, 3), np.uint8)
    edge = cv2.dilate(depth, kernel) - cv2.erode(depth, kernel) > 0.1 * depth
    return np.where(edge & (rng.random(depth.shape) < 0.5), 0.0, noisy)


def write_tum(folder: Path, frames: int, seed: int = 0) -> None:
    """A sequence at 30 frames/s in TUM RGB-D layout, poses and intrinsics beside it."""
    rng = np.random.default_rng(seed)
    for name in ("rgb", "depth", "masks"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    (folder / "masks/labels.txt").write_text("".join(f"{i} {name}\n" for i, name in NAMES.items()))
    rows: dict[str, list[str]] = {"rgb": [], "depth": [], "groundtruth": []}
    z_up = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    for i in range(frames):
        stamp, T = f"{1000 + i * FRAME_S:.6f}", pose(i * FRAME_S)
        view = render(T, i * FRAME_S)
        grain = rng.normal(0, 2, view.rgb.shape)
        cv2.imwrite(str(folder / f"rgb/{stamp}.png"), np.clip(view.rgb + grain, 0, 255).astype(np.uint8)[..., ::-1])
        cv2.imwrite(str(folder / f"depth/{stamp}.png"), (noisy_depth(view.depth, rng) * 5000).astype(np.uint16))
        cv2.imwrite(str(folder / f"masks/{i:06d}.png"), view.labels)
        for name in ("rgb", "depth"):
            rows[name].append(f"{stamp} {name}/{stamp}.png")
        W = z_up @ T
        rows["groundtruth"].append(" ".join([stamp, *(f"{x:.6f}" for x in (*W[:3, 3], *_quaternion(W[:3, :3])))]))
    for name, lines in rows.items():
        (folder / f"{name}.txt").write_text("# rendered by examples/render_room.py\n" + "\n".join(lines) + "\n")
    camera = {
        "fx": FOCAL,
        "fy": FOCAL,
        "cx": K[0, 2],
        "cy": K[1, 2],
        "width": WIDTH,
        "height": HEIGHT,
        "depth_scale": 5000,
    }
    (folder / "camera.txt").write_text("".join(f"{name} {value}\n" for name, value in camera.items()))


def _slabs(origin: np.ndarray, rays: np.ndarray, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    with np.errstate(divide="ignore"):
        a, b = (low - origin) / rays, (high - origin) / rays
    return np.minimum(a, b).max(-1), np.maximum(a, b).min(-1)


def _box(origin: np.ndarray, rays: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    enter, leave = _slabs(origin, rays, low, high)
    return np.where((enter < leave) & (enter > 0), enter, np.inf)


def _ball(origin: np.ndarray, rays: np.ndarray, centre: np.ndarray, radius: float) -> np.ndarray:
    a, b = (rays**2).sum(-1), rays @ (origin - centre)
    root = b**2 - a * (((origin - centre) ** 2).sum() - radius**2)
    return np.where(root > 0, (-b - np.sqrt(np.maximum(root, 0))) / a, np.inf)


def _texture(points: np.ndarray, labels: np.ndarray) -> np.ndarray:
    lattice = np.random.default_rng(1).standard_normal((64, 64, 64)).astype(np.float32)
    shade = np.zeros(points.shape[:2])
    for cells in (2.1, 5.3, 12.7, 31.0, 67.0):  # a metre; value noise repeats only where all octaves do
        shade += map_coordinates(lattice, (points * cells).reshape(-1, 3).T, order=1, mode="grid-wrap").reshape(
            shade.shape
        )
    base = np.array([[150, 140, 125], [200, 80, 60], [90, 120, 90], [70, 110, 190]])[labels]
    return np.clip(base * (1 + 0.25 * shade[..., None]), 0, 255).astype(np.uint8)


def _quaternion(R: np.ndarray) -> np.ndarray:
    w = np.sqrt(max(1 + np.trace(R), 1e-12)) / 2
    return np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1], 4 * w * w]) / (4 * w)


if __name__ == "__main__":
    out = Path(sys.argv[1] if len(sys.argv) > 1 else "room")
    write_tum(out, int(sys.argv[2]) if len(sys.argv) > 2 else 30)
    print(f"wrote {out}")
