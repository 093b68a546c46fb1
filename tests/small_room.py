"""The room of truth_room with every n-th row and column: quick to evaluate, and small enough to break."""

import shutil

import cv2
import numpy as np
import truth_room


def write_small_room(folder, frames=6, stride=4):
    """A log with truth/ in it, 640 / stride pixels wide."""
    truth_room.write_room(folder, frames)
    shutil.rmtree(folder / "masks")
    for path in folder.rglob("*.png"):
        image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        cv2.imwrite(str(path), image[stride // 2 :: stride, stride // 2 :: stride])
    text = (folder / "camera.txt").read_text()
    values = {name: float(value) for name, value in (line.split() for line in text.splitlines())}
    for name in ("fx", "fy", "width", "height"):
        values[name] /= stride
    for name in ("cx", "cy"):
        values[name] = (values[name] - stride // 2) / stride
    (folder / "camera.txt").write_text("".join(f"{name} {value:.10g}\n" for name, value in values.items()))


def write_masks(folder, masks):
    """Masks by frame index."""
    folder.mkdir(parents=True, exist_ok=True)
    for index, mask in masks.items():
        cv2.imwrite(str(folder / f"{index:06d}.png"), np.asarray(mask, np.uint8))
