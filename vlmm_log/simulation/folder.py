"""The folder of a rendered sequence: a TUM RGB-D log, and ``truth/`` beside it. No file tells when it was written."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vlmm_log import se3
from vlmm_log.simulation.kernels import Lens
from vlmm_log.simulation.noise import DepthNoise
from vlmm_log.simulation.raycast import World
from vlmm_log.simulation.things import Thing
from vlmm_log.simulation.view import FPS, Shutter, View
from vlmm_log.types import Float32, Float64, UInt16

LOG_UNITS, TRUTH_UNITS = 5000, 10_000  # of depth images, stored values of a metre
START_S = 1000  # stamp of frame 0
SMOOTH = [cv2.IMWRITE_PNG_COMPRESSION, 1]
GRAINY = [*SMOOTH, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE]  # faster, and smaller where all is noise
FOLDERS = ("rgb", "depth", *(f"truth/{name}" for name in ("instances", "parts", "depth", "flow", "motion")))


def stamp(index: int) -> str:
    """Of a frame, decimal seconds."""
    return f"{START_S + index / FPS:.6f}"


def make_folders(out: Path) -> None:
    """All that images go into."""
    for name in FOLDERS:
        (out / name).mkdir(parents=True)


def write_view(out: Path, index: int, view: View) -> None:
    """The images of one frame."""
    truth, name = out / "truth", f"{index:06d}.png"
    _png(out / f"rgb/{stamp(index)}.png", cv2.cvtColor(view.rgb, cv2.COLOR_RGB2BGR), GRAINY)
    _png(out / f"depth/{stamp(index)}.png", _stored(view.depth, LOG_UNITS), GRAINY)
    _png(truth / "instances" / name, view.instances)
    _png(truth / "parts" / name, view.parts)
    _png(truth / "depth" / name, _stored(view.exact, TRUTH_UNITS))
    if view.flow is not None and view.motion is not None:
        _png(truth / "flow" / name, view.flow)
        _png(truth / "motion" / name, view.motion)


def write_log(out: Path, lens: Lens, size: tuple[int, int], poses: Float64) -> None:
    """Lists, camera and poses (n, 4, 4) of the log."""
    rows = range(len(poses))
    for kind in ("rgb", "depth"):
        _text(out / f"{kind}.txt", ["# timestamp filename", *(f"{stamp(i)} {kind}/{stamp(i)}.png" for i in rows)])
    head = "# timestamp tx ty tz qx qy qz qw"
    _text(out / "groundtruth.txt", [head, *(f"{stamp(i)} {_pose(poses[i])}" for i in rows)])
    numbers = [*lens._asdict().items(), ("width", size[1]), ("height", size[0]), ("depth_scale", LOG_UNITS)]
    _text(out / "camera.txt", [f"{name} {value}" for name, value in numbers])


def write_truth(
    out: Path, about: dict[str, Any], things: Sequence[Thing], rhos: Sequence[float], world: World, frames: int
) -> None:
    """All of ``truth/`` that is no image: poses, parts, instances and what was asked for."""
    truth, t = out / "truth", np.arange(frames) / FPS
    (truth / "truth.json").write_text(json.dumps(about, indent=1) + "\n", "utf-8")
    _text(truth / "instances/labels.txt", [f"{i} {thing.name}" for i, thing in enumerate(things, 1)])
    _text(truth / "parts.csv", ["part,instance", *(f"{p},{i}" for p, i in enumerate(world.instance_of_part, 1))])
    _text(truth / "poses.txt", [f"{stamp(i)} {_pose(T)}" for i, T in enumerate(world.camera(t))])
    at = np.stack([motion(t) for motion in world.motions]) if world.motions else np.zeros((0, frames, 4, 4))
    rows = (f"{i},{p},{_pose(at[p - 1, i]).replace(' ', ',')}" for i in range(frames) for p in range(1, len(at) + 1))
    _text(truth / "part_poses.csv", ["frame,part,tx,ty,tz,qx,qy,qz,qw", *rows])
    kinds = zip(things, rhos, strict=True)
    told = (f"{i},{x.name},{rho:g},{x.kind},{way(x, frames):.6f}" for i, (x, rho) in enumerate(kinds, 1))
    _text(truth / "objects.csv", ["id,name,movability,kind,path_m", *told])


def way(thing: Thing, frames: int) -> float:
    """Length m of the line that the thing's mark draws from frame to frame."""
    motion = thing.bodies[0].motion
    moving = motion or next((body.motion for body in thing.bodies if body.motion), None)
    if moving is None:
        return 0.0
    points = moving(np.arange(frames) / FPS) @ np.array([*thing.mark, 1.0])
    return float(np.linalg.norm(np.diff(points[:, :3], axis=0), axis=1).sum())


def described(
    scene: str, seed: int, frames: int, gap: int, noise: DepthNoise, shutter: Shutter, pose_noise: tuple[float, float]
) -> dict[str, Any]:
    """truth.json but for the version of the project."""
    return {
        "format": "vlmm-log truth",
        "version": 1,
        "scene": scene,
        "seed": seed,
        "frames": frames,
        "gap": gap,
        "fps": FPS,
        "noise": asdict(noise),
        "readout_s": shutter.readout_s,
        "depth_offset_s": shutter.depth_offset_s,
        "pose_noise_deg": pose_noise[0],
        "pose_noise_cm": pose_noise[1],
        "depth_units_per_meter": TRUTH_UNITS,
        "flow_of_occluded_pixels": "valid",
    }


def _stored(depth: Float32, units: int) -> UInt16:
    """Rounded; 0 where nothing is or it is too far for 16 bit."""
    values = np.rint(np.where(np.isfinite(depth), depth, 0) * np.float32(units))
    return np.where(values < 65536, values, 0).astype(np.uint16)


def _png(path: Path, image: NDArray[Any], how: Sequence[int] = SMOOTH) -> None:
    done, data = cv2.imencode(".png", image, how)
    assert done, "every image is one that PNG can hold"
    path.write_bytes(data.data)


def _pose(T: Float64) -> str:
    return " ".join(f"{x:.9f}" for x in (*T[:3, 3], *se3.quaternion(T)))


def _text(path: Path, lines: Iterable[str]) -> None:
    path.write_text("\n".join(lines) + "\n", "utf-8", newline="\n")
