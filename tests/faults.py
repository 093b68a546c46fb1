"""Faults that a log in TUM layout can have, made one at a time in a copy of it, and the remedy that is right."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from vlmm_log import se3
from vlmm_log.readers import conventions
from vlmm_log.readers.stamps import seconds_to_ns

MOUNT = se3.exp(np.array([0.5, -0.3, 0.2, 0.05, -0.12, 0.08]))  # of the camera on a tracked body


@dataclass(frozen=True)
class Fault:
    """What goes wrong, and what mends it."""

    name: str
    make: Callable[[Path], object]  # changes a folder in TUM layout
    check: tuple[str, ...]  # under which it may be told
    knob: str = ""  # of read, that mends it; "": only the user can
    values: tuple[str | float, ...] = ()  # it is to have: any of the texts, or all of the numbers within
    within: float = 0.0

    def mended_by(self, remedy: str) -> bool:
        """Whether a remedy is the right one."""
        if not self.knob:
            return not remedy.startswith("--")
        flag, given = (f"--set read.{self.knob}=", remedy) if self.knob != "intrinsics" else ("--intrinsics ", remedy)
        if not given.startswith(flag) or " --" in given:
            return False
        value = given.removeprefix(flag)
        if value in self.values:
            return True
        wanted = [x for x in self.values if not isinstance(x, str)]
        try:
            numbers = [float(x) for x in value.split(",")]
        except ValueError:
            return False
        last = numbers[-len(wanted) :]  # of a mounting, the quaternion: its position is not well told
        return bool(wanted) and all(abs(x - y) <= self.within for x, y in zip(last, wanted, strict=False))


def linked(source: Path, target: Path) -> Path:
    """A copy of a folder whose images are links, so that replacing one leaves the source's alone."""
    shutil.copytree(source, target, copy_function=lambda a, b: os.link(a, b))
    for listed in target.glob("*.txt"):
        _write(listed, listed.read_text("utf-8"))
    return target


def _write(path: Path, content: str | bytes) -> None:
    path.unlink(missing_ok=True)  # a link's other end stays as it is
    path.write_bytes(content.encode() if isinstance(content, str) else content)


def _rows(path: Path) -> list[list[str]]:
    lines = path.read_text("utf-8").splitlines()
    return [line.split() for line in lines if line.strip() and not line.startswith("#")]


def _list(path: Path, rows: list[list[str]]) -> None:
    _write(path, "".join(" ".join(row) + "\n" for row in rows))


def _later(text: str, s: float) -> str:
    ns = seconds_to_ns(text) + round(s * 1e9)
    return f"{ns // 10**9}.{ns % 10**9:09d}"


def of_rows(name: str, change: Callable[[int, list[str]], list[str] | None]) -> Callable[[Path], None]:
    """A fault that changes rows of a list, by their number; None takes a row out."""

    def make(folder: Path) -> None:
        changed = [change(k, row) for k, row in enumerate(_rows(folder / name))]
        _list(folder / name, [row for row in changed if row is not None])

    return make


def of_poses(
    change: Callable[[np.ndarray], np.ndarray], order: tuple[int, ...] = (0, 1, 2, 3)
) -> Callable[[Path], None]:
    """A fault that lists ``change(T_world_cam)`` with the quaternion in some order of x, y, z, w."""

    def row_of(_: int, row: list[str]) -> list[str]:
        numbers = np.array([float(x) for x in row[1:8]])
        T = change(se3.from_quaternion(numbers[:3], numbers[3:] / np.linalg.norm(numbers[3:])))
        quaternion = se3.quaternion(T)[list(order)]
        return [row[0], *(f"{x:.6f}" for x in (*T[:3, 3], *quaternion))]

    return of_rows("groundtruth.txt", row_of)


def of_depth(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Path], None]:
    """A fault that rewrites every depth image (H, W) u16."""

    def make(folder: Path) -> None:
        for path in sorted((folder / "depth").iterdir()):
            raw = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
            ok, data = cv2.imencode(".png", change(raw).astype(np.uint16), [cv2.IMWRITE_PNG_COMPRESSION, 1])
            assert ok
            _write(path, data.tobytes())

    return make


def moved(dx: int, dy: int) -> Callable[[np.ndarray], np.ndarray]:
    """Depth moved right and down, 0 where nothing comes from."""
    return lambda raw: cv2.warpAffine(
        raw, np.float32([[1, 0, dx], [0, 1, dy]]), raw.shape[::-1], flags=cv2.INTER_NEAREST
    )


def camera(text: str) -> Callable[[Path], None]:
    """Another camera.txt."""
    return lambda folder: _write(folder / "camera.txt", text)


def stamps(name: str, s: float) -> Callable[[Path], None]:
    """A list whose stamps are late."""
    return of_rows(name, lambda _, row: [_later(row[0], s), *row[1:]])


def _repeated(folder: Path) -> None:
    """Every fourth image is the one before once more, as a stalled driver gives it."""
    for kind in ("rgb", "depth"):
        rows = _rows(folder / f"{kind}.txt")
        for k in range(3, len(rows), 4):
            _write(folder / rows[k][1], (folder / rows[k - 1][1]).read_bytes())


def _restamped(folder: Path) -> None:
    """Every sixteenth colour image has the stamp of the one before."""
    rows = _rows(folder / "rgb.txt")
    _list(folder / "rgb.txt", [[rows[k - (k % 16 == 15)][0], row[1]] for k, row in enumerate(rows)])


def _as_bonn_lists(T: np.ndarray) -> np.ndarray:
    c = conventions.bonn()
    assert c.world is not None and c.to_camera is not None
    return se3.inverse(c.world) @ T @ se3.inverse(c.to_camera)


def _turned(axes: str) -> Callable[[np.ndarray], np.ndarray]:
    return lambda T: T @ se3.inverse(conventions.AXES[axes])


def _frozen() -> Callable[[Path], None]:
    first: list[list[str]] = []

    def row_of(k: int, row: list[str]) -> list[str]:
        if k == 0:
            first[:] = [row]
        return [row[0], *first[0][1:]]

    return of_rows("groundtruth.txt", row_of)


def _millimetres(_: int, row: list[str]) -> list[str]:
    return [row[0], *(f"{1000 * float(x):.3f}" for x in row[1:4]), *row[4:]]


def _careless(_: int, row: list[str]) -> list[str]:
    return [*row[:4], *(f"{float(x):.1f}" for x in row[4:])]


def camera_text(fx: float, fy: float, cx: float, cy: float, scale: float = 5000) -> str:
    """A camera.txt."""
    return f"fx {fx}\nfy {fy}\ncx {cx}\ncy {cy}\ndepth_scale {scale}\n"


POSES, CLOCK, SCALE = ("pose convention",), ("pose clock",), ("depth scale",)
SHIFT, LATE, CAMERA = ("registration",), ("depth clock", "synchronisation"), ("intrinsics", "camera")
ROWS, UNITS, MOUNTED = ("unusable rows",), "depth_units_per_meter", ("pose to camera",)
FR1 = (517.3, 516.5, 318.6, 255.3)
FR3 = (535.4, 539.2, 320.1, 247.6)
ICL = (481.2, 480.0, 319.5, 239.5)
HALF = tuple(x / 2 for x in FR1)
KINDS = ("freiburg1", "freiburg2", "freiburg3", "kinect")  # of one sensor: the slice does not tell them apart
IN_MM = of_rows("groundtruth.txt", _millimetres)
ON_BODY = of_poses(lambda T: T @ se3.inverse(MOUNT))
CARELESS = of_rows("groundtruth.txt", _careless)
THINNED = of_rows("depth.txt", lambda k, row: row if k % 3 else None)
FAULTS = (
    Fault("poses inverted", of_poses(se3.inverse), POSES, "poses", ("world_to_camera",)),
    Fault("quaternions w first", of_poses(lambda T: T, (3, 0, 1, 2)), POSES, "quaternion", ("wxyz",)),
    Fault("poses of the body, x forward", of_poses(_turned("body")), POSES, "camera_axes", ("body",)),
    Fault("poses in OpenGL axes", of_poses(_turned("opengl")), POSES, "camera_axes", ("opengl",)),
    Fault("poses of Bonn's marker", of_poses(_as_bonn_lists), POSES, "pose_to_camera", ("bonn",)),
    Fault("poses of a body 35 deg off", ON_BODY, MOUNTED, "pose_to_camera", tuple(se3.quaternion(MOUNT)), 0.05),
    Fault("positions in mm", IN_MM, POSES, "position_units_per_meter", ("1000",)),
    Fault("poses 100 ms late", stamps("groundtruth.txt", 0.1), CLOCK, "pose_offset_s", (-0.1,), 0.02),
    Fault("poses 60 ms early", stamps("groundtruth.txt", -0.06), CLOCK, "pose_offset_s", (0.06,), 0.02),
    Fault("poses frozen", _frozen(), ("pose motion",), "poses", ("none",)),
    Fault("poses of another clock", stamps("groundtruth.txt", 7200.0), ("pose coverage",)),
    Fault("quaternions of one decimal", CARELESS, ROWS),
    Fault("depth in mm", of_depth(lambda z: np.rint(z / 5.0)), SCALE, UNITS, ("1000",)),
    Fault("depth at 10000 per metre", of_depth(lambda z: np.minimum(2.0 * z, 65535)), SCALE, UNITS, ("10000",)),
    Fault("depth scale 1 in camera.txt", camera(camera_text(*FR1, 1)), SCALE, UNITS, ("5000",)),
    Fault("depth 8 px to the right", of_depth(moved(8, 0)), SHIFT, "depth_shift_px", (-8.0, 0.0), 3),
    Fault("depth 6 px too high", of_depth(moved(0, -6)), SHIFT, "depth_shift_px", (0.0, 6.0), 3),
    Fault("depth 12 px left, 9 px down", of_depth(moved(-12, 9)), SHIFT, "depth_shift_px", (12.0, -9.0), 3),
    Fault("depth mirrored", of_depth(lambda z: z[:, ::-1]), ("mirrored depth",)),
    Fault("depth all zero", of_depth(np.zeros_like), ("depth coverage",)),
    Fault("depth 100 ms late", stamps("depth.txt", 0.1), LATE, "depth_offset_s", (-0.1,), 0.03),
    Fault("depth 300 ms late", stamps("depth.txt", 0.3), LATE, "depth_offset_s", (-0.3,), 0.03),
    Fault("every third depth image missing", THINNED, ("gaps",)),
    Fault("images repeated", _repeated, ("repeated images",)),
    Fault("stamps repeated", _restamped, ROWS),
    Fault("camera of freiburg3", camera(camera_text(*FR3)), CAMERA, "intrinsics", ("freiburg1",)),
    Fault("camera of ICL-NUIM", camera(camera_text(*ICL)), CAMERA, "intrinsics", KINDS),
    Fault("camera of half the resolution", camera(camera_text(*HALF)), CAMERA, "intrinsics", FR1, 2.0),
)
