"""Tiny logs in TUM layout: plain functions with keyword options."""

import shutil

import cv2
import numpy as np

CAMERA = "fx 60\nfy 60\ncx 31.5\ncy 23.5\n"
ORIGIN_NS = 1_305_031_237_000_000_000  # of the first depth image


def text_of(ns):
    """Seconds with nine decimals."""
    return f"{ns // 10**9}.{ns % 10**9:09d}"


def png(image):
    ok, data = cv2.imencode(".png", image)
    assert ok
    return data.tobytes()


def rows(stamps_ns, values):
    lines = [f"{text_of(t)} {v}\n" for t, v in zip(stamps_ns, values, strict=True)]
    return "".join(["# seconds value\n", *lines])


def write_tum_folder(
    folder,
    *,
    frames=4,
    size=(64, 48),
    step_ns=100_000_000,
    offset_ns=2_000_000,
    shift_px=0,
    depth_m=2.0,
    depth_dtype=np.uint16,
    camera=CAMERA,
    groundtruth=None,
    files=(),
):
    """A log of ``frames`` images of random texture, moving right by ``shift_px`` a frame, on a plane.

    Depth image k lies at ORIGIN_NS + k step_ns, its colour image offset_ns later. ``camera`` and
    ``groundtruth`` are texts (None: no such file). ``files`` maps names to what is written in the end: bytes,
    text, or None to remove the file or folder.
    """
    width, height = size
    (folder / "rgb").mkdir(parents=True)
    (folder / "depth").mkdir()
    texture = np.random.default_rng(1).integers(0, 256, (height, width, 3), np.uint8)
    texture = cv2.GaussianBlur(texture, (0, 0), 1.2)
    units = 5000 if depth_dtype == np.uint16 else 50
    depth = np.full((height, width), round(depth_m * units), depth_dtype)
    for k in range(frames):
        (folder / f"rgb/{k}.png").write_bytes(png(np.roll(texture, k * shift_px, axis=1)))
        (folder / f"depth/{k}.png").write_bytes(png(depth))
    stamps = [ORIGIN_NS + k * step_ns for k in range(frames)]
    for kind, late in (("rgb", offset_ns), ("depth", 0)):
        listed = rows([t + late for t in stamps], [f"{kind}/{k}.png" for k in range(frames)])
        (folder / f"{kind}.txt").write_text(listed)
    texts = {"camera.txt": camera, "groundtruth.txt": groundtruth}
    for name, content in [*((n, t) for n, t in texts.items() if t is not None), *dict(files).items()]:
        if content is None:
            shutil.rmtree(folder / name) if (folder / name).is_dir() else (folder / name).unlink()
        else:
            (folder / name).write_bytes(content.encode() if isinstance(content, str) else content)
    return folder
