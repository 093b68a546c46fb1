"""The rendered room with its exact truth, in the layout that ``vlmm-log simulate`` writes; without Open3D."""

import json

import cv2
import numpy as np

import render_room as room
from vlmm_log import se3

Z_UP = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
THINGS = {1: ("wall", 0.0, "still"), 2: ("ball", 1.0, "roll"), 3: ("shelf", 0.0, "still"), 4: ("box", 1.0, "slide")}
GAP = 3


def write_room(folder, frames, seed=0):
    """A log with truth/ in it. Things: the room, the ball, the shelf, the box."""
    room.write_tum(folder, frames, seed)
    truth = folder / "truth"
    for name in ("instances", "parts", "depth"):
        (truth / name).mkdir(parents=True, exist_ok=True)
    poses, parts = [], []
    for i in range(frames):
        T = room.pose(i * room.FRAME_S)
        view = room.render(T, i * room.FRAME_S)
        cv2.imwrite(str(truth / f"instances/{i:06d}.png"), view.labels.astype(np.uint16) + 1)
        part = np.where(np.isin(view.labels, (1, 3)), view.labels, 0)
        cv2.imwrite(str(truth / f"parts/{i:06d}.png"), part.astype(np.uint16))
        cv2.imwrite(str(truth / f"depth/{i:06d}.png"), np.rint(view.depth * 10000).astype(np.uint16))
        poses.append([1000 + i * room.FRAME_S, *row(Z_UP @ T)])
        for part in (1, 3):
            D = np.eye(4)
            D[:3, 3] = room.SPEED[part] * i * room.FRAME_S
            parts.append([i, part, *row(Z_UP @ D)])
    np.savetxt(truth / "poses.txt", poses, fmt="%.9f")
    (truth / "instances/labels.txt").write_text("".join(f"{k} {n}\n" for k, (n, _, _) in THINGS.items()))
    write_csv(truth / "parts.csv", "part,instance", [[1, 2], [3, 4]])
    write_csv(truth / "part_poses.csv", "frame,part,tx,ty,tz,qx,qy,qz,qw", parts)
    write_csv(truth / "objects.csv", "id,name,movability,kind", [[k, *t] for k, t in THINGS.items()])
    about = {"format": "vlmm-log truth", "version": 1, "scene": "room", "seed": seed, "gap": GAP}
    (truth / "truth.json").write_text(json.dumps(about | {"depth_units_per_meter": 10000}))


def row(T):
    return [*T[:3, 3], *se3.quaternion(T)]


def write_csv(path, head, rows):
    path.write_text("\n".join([head, *(",".join(map(str, r)) for r in rows)]) + "\n")
