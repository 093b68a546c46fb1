"""``simulate``: a room rendered into a log, and all that is true about it."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vlmm_log import se3
from vlmm_log.models.prior import read_table
from vlmm_log.protocols import Progress
from vlmm_log.simulation import folder
from vlmm_log.simulation.noise import DepthNoise, sensor
from vlmm_log.simulation.raycast import build
from vlmm_log.simulation.scenes import drawn
from vlmm_log.simulation.things import Scene
from vlmm_log.simulation.view import FPS, Shutter, Studio, studio, taken
from vlmm_log.types import Float64, InputError, Int64
from vlmm_log.version import __version__
from vlmm_log.writers.staging import claim_folder, replacing_folder

VISIBLE_PX = 500  # in some frame: the thing counts as seen
SIZE = (480, 640)


@dataclass(frozen=True)
class Simulated:
    """What ``simulate`` leaves."""

    out: Path
    scene: str
    frames: int
    things: int  # instances in the scene
    visible: tuple[str, ...]  # names of the instances with at least 500 px in some frame
    movers: tuple[str, ...]  # "name (kind)" of those that move
    moving_share: float  # of the pixels, those that move at least 1 cm until the partner frame; NaN without pairs

    def report(self) -> dict[str, object]:
        """As plain values, for JSON."""
        return {
            "out": str(self.out),
            "scene": self.scene,
            "frames": self.frames,
            "things": self.things,
            "visible": len(self.visible),
            "names": sorted(set(self.visible)),
            "movers": list(self.movers),
            "moving_share": None if np.isnan(self.moving_share) else round(self.moving_share, 4),
        }


def simulate(
    scene: str,
    out: str | Path,
    *,
    frames: int = 90,
    seed: int = 0,
    noise: str | DepthNoise = "clean",
    readout_s: float = 0.0,
    depth_offset_s: float = 0.0,
    pose_noise: tuple[float, float] = (0.0, 0.0),
    gap: int = 3,
    size: tuple[int, int] = SIZE,
    force: bool = False,
    progress: Progress | None = None,
) -> Simulated:
    """Render "kitchen", "living_room" or "bedroom" as a TUM RGB-D folder at 30 frames/s, with ``truth/`` in it.

    ``seed`` decides what stands where, how it looks and moves, and all noise: equal calls give equal bytes. ``noise``
    is a DepthNoise, or "clean", "kinect_quadratic", "nguyen" or "disparity" with what usually goes with it. Row v of
    H is exposed at ``t + (v / H - 1/2) readout_s``, and the depth image ``depth_offset_s`` after the colour image.
    ``pose_noise`` are sigmas (degrees, cm) about and along each camera axis of groundtruth.txt, frame by frame; the
    truth is exact. Flow and motion lead to the frame ``gap`` later. ``size`` is (H, W) px. The folder is written
    beside and renamed; an existing one is replaced only with ``force``. Raises InputError where Open3D is missing, an
    argument cannot be used, or the folder cannot be written.
    """
    out = Path(out)
    _check(frames, seed, readout_s, depth_offset_s, pose_noise, gap, size)
    sensed = sensor(noise) if isinstance(noise, str) else noise
    shutter = Shutter(readout_s, depth_offset_s)
    room = drawn(scene, seed, frames / FPS)
    claim_folder(out, [], force=force)
    world = build(room)
    at = studio(world, size, shutter, sensed, seed)
    rho = read_table()
    with replacing_folder(out) as staged:
        folder.make_folders(staged)
        pixels, moving = _write_views(at, staged, frames, gap, progress)
        poses = _perturbed(world.camera(np.arange(frames) / FPS), pose_noise, np.random.default_rng([seed, 3]))
        folder.write_log(staged, at.lens, size, poses)
        about = folder.described(scene, seed, frames, gap, sensed, shutter, pose_noise) | {"vlmm_log": __version__}
        folder.write_truth(staged, about, room.things, [rho[thing.name].rho for thing in room.things], world, frames)
    return _closing(out, room, frames, pixels, moving)


def parse_pose_noise(text: str) -> tuple[float, float]:
    """Sigmas in degrees and cm of "DEG,CM". Raises InputError."""
    try:
        degrees, centimetres = (float(word) for word in text.split(","))
    except ValueError as e:
        raise InputError(f"--pose-noise {text}: two numbers are expected, DEG,CM") from e
    return degrees, centimetres


def _write_views(
    at: Studio, staged: Path, frames: int, gap: int, progress: Progress | None
) -> tuple[Int64, list[float]]:
    """All frames, several at once; most pixels of every instance in a frame, and shares that move."""

    def one(index: int) -> tuple[Int64, float | None]:
        view = taken(at, index, index + gap if index + gap < frames else None)
        folder.write_view(staged, index, view)
        count = np.bincount(view.instances.ravel(), minlength=at.world.instance.max() + 1)
        return count, None if view.motion is None else float(np.mean(view.motion == 255))

    pixels, moving = np.zeros(int(at.world.instance.max()) + 1, np.int64), []
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        try:
            for done, (count, share) in enumerate(pool.map(one, range(frames)), 1):
                pixels = np.maximum(pixels, count)
                moving += [] if share is None else [share]
                if progress is not None:
                    progress(done, frames)
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    return pixels, moving


def _perturbed(poses: Float64, sigmas: tuple[float, float], rng: np.random.Generator) -> Float64:
    """Poses (n, 4, 4) with noise about and along the camera's axes, independent from frame to frame."""
    twists = rng.standard_normal((len(poses), 6))
    twists *= np.repeat([np.deg2rad(sigmas[0]), sigmas[1] / 100], 3)
    shifts = np.tile(np.eye(4), (len(poses), 1, 1))
    shifts[:, :3, 3] = twists[:, 3:]
    twists[:, 3:] = 0
    return np.asarray(poses @ shifts @ se3.exp(twists))


def _closing(out: Path, room: Scene, frames: int, pixels: Int64, moving: list[float]) -> Simulated:
    visible = tuple(thing.name for thing, count in zip(room.things, pixels[1:], strict=True) if count >= VISIBLE_PX)
    movers = tuple(f"{thing.name} ({thing.kind})" for thing in room.things if thing.kind != "still")
    share = float(np.mean(moving)) if moving else float("nan")
    return Simulated(out, room.name, frames, len(room.things), visible, movers, share)


def _check(
    frames: int,
    seed: int,
    readout_s: float,
    offset_s: float,
    pose_noise: tuple[float, float],
    gap: int,
    size: tuple[int, int],
) -> None:
    if not 1 <= frames <= 100_000:
        raise InputError(f"frames = {frames}: from 1 to 100000")
    if seed < 0:
        raise InputError(f"seed = {seed}: a number from 0 on")
    if gap < 1:
        raise InputError(f"gap = {gap}: frames from 1 on")
    if not 0 <= readout_s <= 1 / FPS or not abs(offset_s) <= 1.0:
        raise InputError(f"readout is from 0 to {1 / FPS:.4f} s, the depth's offset within a second of 0")
    if not all(0 <= sigma <= 45 for sigma in pose_noise):
        raise InputError("pose noise: sigmas in degrees and cm, from 0 to 45")
    if not all(16 <= side <= 4096 for side in size):
        raise InputError(f"size = {size}: height and width from 16 to 4096 px")
