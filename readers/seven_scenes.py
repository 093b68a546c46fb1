"""Folders of frame-000000.color.png, .depth.png and .pose.txt: 7-Scenes, 12-Scenes, BundleFusion, exported ScanNet.

Shotton et al., CVPR 2013; Valentin et al., 3DV 2016; Dai et al., TOG 2017. Poses are camera-to-world, depth is in mm.
"""

from __future__ import annotations

import re
from pathlib import Path

from vlmm_log.protocols import Log
from vlmm_log.readers import conventions, intrinsics
from vlmm_log.readers.conventions import Convention
from vlmm_log.readers.intrinsics import Intrinsics
from vlmm_log.readers.matrices import matrix_in, matrix_trajectory
from vlmm_log.readers.numbered import Counted, by_number, counted
from vlmm_log.readers.plain import log_of
from vlmm_log.readers.pose_files import of_matrices, placed
from vlmm_log.settings import ReadSettings
from vlmm_log.types import InputError, Skipped

FILES = {"color": ("png", "jpg"), "depth": ("png", "pgm"), "pose": ("txt",)}
UNSEEN = 65535  # stored where 7-Scenes has no depth
INFO_FILES = ("_info.txt", "info.txt")
SAME_PX = 1.0  # within which two calibrations are of one image


class SevenScenes:
    """The reader."""

    name = "7-scenes"

    def recognises(self, path: Path) -> bool:
        """A folder with frame-*.color.png or .jpg, or an export of Record3D, which `open` refuses with a remedy."""
        return is_record3d(path) or any(next(path.glob(f"frame-*.color.{end}"), None) for end in FILES["color"])

    def open(self, path: Path, s: ReadSettings) -> Log:
        """The log of a folder. Raises InputError where frames or intrinsics are missing, and for Record3D's EXR."""
        if is_record3d(path):
            raise InputError(
                f"{path}: a Record3D export with EXR or LZFSE depth is not read; write depth/N.png, 16 bit in mm and "
                "of the colour image's size, beside rgb/N.jpg and camera.txt"
            )
        left_out: list[Skipped] = []
        images = by_number(_frames(path, "color"), _frames(path, "depth"), path)
        poses = _frames(path, "pose").files
        left_out += [Skipped(0, f, "no image has its number") for n, f in poses.items() if n not in images.taken]
        listed = [(images.taken[n], f, matrix_in(path / f)) for n, f in poses.items() if n in images.taken]
        known = matrix_trajectory(listed, left_out)
        convention = conventions.asked(s, Convention())
        where = placed(known, "frame-*.pose.txt", of_matrices(convention))
        log = log_of(path, s, _camera(path, s), images, where, left_out)
        log.notes += _notes(s, log.units_per_meter)
        return log


def is_record3d(path: Path) -> bool:
    """Whether this is what Record3D exports: an .r3d file, or a folder with EXR_RGBD/ or rgbd/ beside its metadata."""
    if path.is_file():
        return path.suffix.lower() == ".r3d"
    metadata = (path / "metadata").is_file() or (path / "metadata.json").is_file()
    return (path / "EXR_RGBD").is_dir() or (metadata and ((path / "rgbd").is_dir() or path.name == "EXR_RGBD"))


def from_info(path: Path) -> Intrinsics:
    """The camera of an _info.txt with rows 'm_calibrationColorIntrinsic = ' and 16 numbers. Raises InputError.

    Depth that is calibrated apart from colour is refused: the folder does not say how to register it.
    """
    try:
        rows = [line.split("=", 1) for line in path.read_text("utf-8").splitlines() if "=" in line]
        values = {name.strip(): [float(word) for word in value.split()] for name, value in rows if _numbers(value)}
        colour = values["m_calibrationColorIntrinsic"]
        width, height, scale = (
            int(values.get(name, [0])[0]) for name in ("m_colorWidth", "m_colorHeight", "m_depthShift")
        )
        fx, fy, cx, cy = (colour[k] for k in (0, 5, 2, 6))
    except (OSError, ValueError, LookupError, OverflowError) as e:
        raise InputError(
            f"{path}: no row 'm_calibrationColorIntrinsic = ' and 16 numbers; give --intrinsics fx,fy,cx,cy"
        ) from e
    depth = values.get("m_calibrationDepthIntrinsic", colour)
    apart = len(depth) != len(colour) or max(abs(a - b) for a, b in zip(depth, colour, strict=True)) > SAME_PX
    if apart:
        raise InputError(
            f"{path}: depth is calibrated apart from colour (fx {depth[0]:g}, not {fx:g} px): register it to colour "
            f"and write camera.txt, or take it as it is with --intrinsics {fx:g},{fy:g},{cx:g},{cy:g}"
        )
    camera = Intrinsics(fx, fy, cx, cy, width, height, float(scale), path.name)
    return intrinsics.checked(camera, str(path))


def _frames(path: Path, kind: str) -> Counted:
    """Files of a kind by number. Raises InputError where there is none; poses may be missing."""
    form = re.compile(rf"frame-([0-9]{{1,12}})\.{kind}\.({'|'.join(FILES[kind])})")
    found = {p.name: int(m[1]) for p in sorted(path.glob(f"frame-*.{kind}.*")) if (m := form.fullmatch(p.name))}
    if not found and kind != "pose":
        raise InputError(f"{path}: no frame-000000.{kind}.{FILES[kind][0]} in it; name {kind} images so")
    return counted(found, path)


def _camera(path: Path, s: ReadSettings) -> Intrinsics | None:
    if (path / "camera.txt").is_file():
        return intrinsics.from_file(path / "camera.txt")
    found = [path / name for name in INFO_FILES if (path / name).is_file()]
    if s.intrinsics:
        return None  # what an _info.txt says of a camera that is not taken need not be right
    if found:
        return from_info(found[0])
    raise InputError(
        f"{path}: no intrinsics: neither camera.txt nor _info.txt in it; give --intrinsics fx,fy,cx,cy "
        "(7-Scenes names 585,585,320,240 for its depth camera, to which colour is not calibrated)"
    )


def _notes(s: ReadSettings, units: float) -> list[str]:
    """What becomes of the value that stands for no depth."""
    far = UNSEEN / units
    if s.depth_max_m < far:
        return [f"stored depth {UNSEEN} ({far:g} m) is unseen: beyond read.depth_max_m"]
    return [f"stored depth {UNSEEN} is read as {far:g} m, though 7-Scenes means unseen: keep read.depth_max_m below"]


def _numbers(text: str) -> bool:
    try:
        return bool([float(word) for word in text.split()])
    except ValueError:
        return False
