"""Record AI2-THOR: colour, depth, poses, instance masks and the truth about every object, as a folder to process.

    pip install ai2thor; python examples/record_ai2thor.py OUT [SCENE [FRAMES]]
    vlmm-log process OUT --segmenter masks:OUT/masks

Unity's world is left-handed: x right, y up, z ahead at yaw 0. What is written is right-handed, z up: (x, z, y). Our
camera has y down, so a pose is mirrored on both sides, and rotations stay rotations. Depth is stored 5000 per metre
(0.1 mm off at most). Frames are steps of the simulator, which has no clock: their stamps are numbers.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

UNITS = 5000  # of stored depth, a metre
WORLD = np.array([[1.0, 0, 0], [0, 0, 1], [0, 1, 0]])  # Unity's (x, y, z) -> (x, z, y)
CAMERA = np.diag([1.0, -1.0, 1.0])  # x right, y down, z ahead -> Unity's y up
CLIP_M = (0.1, 20.0)  # near and far plane of the simulator's camera
FLAGS = ("moveable", "pickupable", "openable", "visible")


def record(events: Iterable[Any], folder: Path, clip_m: tuple[float, float] = CLIP_M) -> int:
    """Write events (``ai2thor.server.Event``) with depth and instance masks as a folder; how many there were.

    The simulator's depth is z (far - near) / far (github.com/allenai/ai2thor/issues/1301), which is undone; where a
    version gives z itself, say ``clip_m=(0, far)``. Raises ValueError for an event without images, or another camera.
    """
    for name in ("rgb", "depth", "masks", "truth"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    identities: dict[str, int] = {}  # by objectId, in order of appearance
    camera, poses, frames = "", [], 0
    with (folder / "truth/objects.jsonl").open("w") as truth:
        for frames, event in enumerate(events, 1):
            if event.depth_frame is None or event.instance_segmentation_frame is None:
                raise ValueError(
                    "no depth or masks: Controller(renderDepthImage=True, renderInstanceSegmentation=True)"
                )
            if camera not in ("", text := camera_text(event)):
                raise ValueError(f"frame {frames - 1}: the camera's size or field of view has changed")
            camera, name = text, f"{frames - 1:06d}.png"
            cv2.imwrite(str(folder / "rgb" / name), np.ascontiguousarray(event.frame[..., ::-1]))
            cv2.imwrite(str(folder / "depth" / name), stored_depth(event.depth_frame, clip_m))
            for thing in event.metadata["objects"]:
                truth.write(json.dumps(object_row(thing, frames - 1, identities)) + "\n")
            cv2.imwrite(str(folder / "masks" / name), mask(event, identities))
            position, quaternion = camera_pose(event.metadata)
            poses.append(" ".join(str(float(x)) for x in (*position, *quaternion)))
    (folder / "camera.txt").write_text(camera)
    labels = (f"{k} {words(name.split('|')[0])}\n" for name, k in identities.items())
    (folder / "masks/labels.txt").write_text("".join(labels))
    rows = (f"{k} {pose}\n" for k, pose in enumerate(poses))
    (folder / "groundtruth.txt").write_text("# frame tx ty tz qx qy qz qw\n" + "".join(rows))
    return frames


def camera_pose(metadata: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Position (3,) m and quaternion x y z w (4,) of the camera: yaw of the agent, pitch by which it looks down."""
    turn = {**metadata["agent"]["rotation"], "x": metadata["agent"]["cameraHorizon"]}
    R = WORLD @ unity_rotation(turn) @ CAMERA
    return WORLD @ vector(metadata["cameraPosition"]), Rotation.from_matrix(R).as_quat()


def unity_rotation(degrees: dict[str, float]) -> np.ndarray:
    """(3, 3) of Unity's Euler angles: about z, then x, then y. Numbers are as in right-handed axes."""
    return Rotation.from_euler("YXZ", [degrees["y"], degrees["x"], degrees["z"]], degrees=True).as_matrix()


def stored_depth(depth: np.ndarray, clip_m: tuple[float, float]) -> np.ndarray:
    """16-bit depth of the simulator's (H, W) m; 0, unseen, at the far plane and beyond what 16 bits hold."""
    near, far = clip_m
    z = np.asarray(depth, np.float64) * (far / (far - near))
    units = np.round(z * UNITS)
    return np.where((z < far * 0.999) & (units < 65535), units, 0).astype(np.uint16)


def mask(event: Any, identities: dict[str, int]) -> np.ndarray:
    """Identities (H, W), 0 where the simulator names nothing."""
    out = np.zeros(event.depth_frame.shape, np.uint16)
    for name, where in event.instance_masks.items():
        out[where] = identities.setdefault(name, len(identities) + 1)
    return out


def object_row(thing: dict[str, Any], frame: int, identities: dict[str, int]) -> dict[str, Any]:
    """One line of truth/objects.jsonl: see vlmm_log/readers/thor_truth.py."""
    R = WORLD @ unity_rotation(thing["rotation"]) @ WORLD
    row = {"frame": frame, "identity": identities.setdefault(thing["objectId"], len(identities) + 1)}
    row |= {"id": thing["objectId"], "type": thing["objectType"], "openness": thing.get("openness", 0.0)}
    row |= {
        "position": (WORLD @ vector(thing["position"])).tolist(),
        "rotation": Rotation.from_matrix(R).as_quat().tolist(),
    }
    return row | {name: thing[name] for name in FLAGS}


def camera_text(event: Any) -> str:
    """camera.txt: square pixels, the vertical field of view, the centre between the middle pixels."""
    height, width = event.depth_frame.shape
    f = height / 2 / np.tan(np.radians(event.metadata["fov"]) / 2)
    rows = {"fx": f, "fy": f, "cx": (width - 1) / 2, "cy": (height - 1) / 2, "width": width, "height": height}
    return "".join(f"{name} {value}\n" for name, value in {**rows, "depth_scale": UNITS}.items())


def vector(xyz: dict[str, float]) -> np.ndarray:
    """(3,) of Unity's x, y, z."""
    return np.array([xyz["x"], xyz["y"], xyz["z"]])


def words(name: str) -> str:
    """Words of a name in one: of CoffeeMachine, coffee machine."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name).lower().replace("_", " ")


def walk(scene: str, frames: int) -> Iterable[Any]:
    """Events of a walk in which things are pushed."""
    from ai2thor.controller import Controller

    controller = Controller(scene=scene, width=640, height=480, renderDepthImage=True, renderInstanceSegmentation=True)
    for k in range(frames):
        yield controller.step(action="RotateRight", degrees=3)
        things = [x for x in controller.last_event.metadata["objects"] if x["visible"] and x["moveable"]]
        if k % 10 == 9 and things:
            yield controller.step(
                action="DirectionalPush", objectId=things[0]["objectId"], moveMagnitude=20, pushAngle=0
            )
    controller.stop()


if __name__ == "__main__":
    _, out, *rest = sys.argv
    count = record(walk(rest[0] if rest else "FloorPlan1", int(rest[1]) if len(rest) > 1 else 60), Path(out))
    print(f"wrote {count} frames to {out}")
