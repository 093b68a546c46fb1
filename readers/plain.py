"""Plain folders: rgb/ and depth/ with images, poses beside them in whichever text form; ICL-NUIM is one of them."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from vlmm_log.protocols import Log
from vlmm_log.readers import conventions, intrinsics, tum
from vlmm_log.readers.conventions import Convention
from vlmm_log.readers.folder import FolderLog, associated
from vlmm_log.readers.intrinsics import Intrinsics
from vlmm_log.readers.numbered import COLOURS, DEPTHS, Timed, named_in, timed
from vlmm_log.readers.pose_files import found_poses
from vlmm_log.readers.poses import Poses
from vlmm_log.settings import ReadSettings
from vlmm_log.types import InputError, Skipped

UNITS_PER_METER = 1000.0  # of Record3D, ScanNet, 7-Scenes, Redwood
COLOUR_FOLDERS = ("rgb", "color", "colour", "image", "images")
ICL_NAME = r"(living_room|office_room)_traj|traj\d_frei_png"
ICL_NOTE = "poses mirrored as ICL-NUIM's page describes its left-handed axes; not checked on its data"


class Plain:
    """The reader."""

    name = "folder"

    def recognises(self, path: Path) -> bool:
        """A folder with depth/ and one of rgb/, color/, colour/, image/, images/."""
        return (path / "depth").is_dir() and any((path / name).is_dir() for name in COLOUR_FOLDERS)

    def open(self, path: Path, s: ReadSettings) -> Log:
        """The log of a folder. Raises InputError where images, times, poses or intrinsics are missing or unclear."""
        found = re.search(r"freiburg[123]", path.resolve().name)
        return open_folder(path, s, intrinsics.FREIBURG[found[0]] if found else None, Convention())


class Icl:
    """The reader of ICL-NUIM's PNG sequences. Handa et al., ICRA 2014."""

    name = "icl"

    def recognises(self, path: Path) -> bool:
        """A folder of images called living_room_traj*, office_room_traj* or traj?_frei_png*."""
        named = re.match(ICL_NAME, path.resolve().name)
        return named is not None and (Plain().recognises(path) or tum.is_tum_folder(path))

    def open(self, path: Path, s: ReadSettings) -> Log:
        """The log of a folder, with rgb.txt and depth.txt or without. Raises InputError as Plain and Tum do."""
        known = (path, s, intrinsics.ICL, conventions.icl())
        log = tum.open_folder(*known) if tum.is_tum_folder(path) else open_folder(*known, up="+y")
        if log.poses is not None:
            log.poses = replace(log.poses, up="+y")  # as listed: before it is mirrored
            log.notes.append(ICL_NOTE)
        return log


def open_folder(
    path: Path, s: ReadSettings, known: Intrinsics | None, convention: Convention, up: str = ""
) -> FolderLog:
    """A plain folder as a log; its sensor's published intrinsics and its poses' convention and up, where known."""
    left_out: list[Skipped] = []
    own = intrinsics.from_file(path / "camera.txt") if (path / "camera.txt").is_file() else known
    names = [named_in(path, folder, kinds, left_out) for folder, kinds in ((_colour(path), COLOURS), ("depth", DEPTHS))]
    images = timed(path, names[0], names[1], left_out)
    poses = found_poses(path, images, conventions.asked(s, convention), left_out)
    return log_of(path, s, own, images, poses and replace(poses, up=up), left_out)


def log_of(
    path: Path, s: ReadSettings, own: Intrinsics | None, images: Timed, poses: Poses | None, left_out: list[Skipped]
) -> FolderLog:
    """A folder's log, and notes of what was assumed. Raises InputError where no intrinsics are known.

    Where the up of the poses' world is not known (""), the axis nearest to the cameras' own is taken.
    """
    camera = intrinsics.asked(s, own, path)
    notes = [images.note]
    if not (s.depth_units_per_meter or camera.depth_scale):
        camera = replace(camera, depth_scale=UNITS_PER_METER)
        notes.append(f"depth {UNITS_PER_METER:g} per metre, assumed: run doctor")
    if poses is not None and not poses.up:
        poses = replace(poses, up=_mean_up(poses))
        notes.append(f"world's up {poses.world_up}: the axis nearest to the cameras' mean up")
    log = associated(path, s, camera, images.rgb, images.depth, poses, left_out)
    log.notes += notes
    return log


def _mean_up(poses: Poses) -> str:
    """Axis of the world, as it is listed, nearest to the mean up of some hundred cameras."""
    listed = replace(poses, convention=replace(poses.convention, world=None))
    stamps = listed.stamps_ns[:: 1 + listed.stamps_ns.size // 100]
    mean = np.mean([-T[:3, 1] for t in stamps if (T := listed.at(int(t), 0)) is not None], axis=0)
    k = int(np.argmax(np.abs(mean)))
    return ("+" if mean[k] > 0 else "-") + "xyz"[k]


def _colour(path: Path) -> str:
    found = [name for name in COLOUR_FOLDERS if (path / name).is_dir()]
    if len(found) > 1:
        raise InputError(f"{path}: both {found[0]}/ and {found[1]}/ could be the colour images; keep one")
    return found[0]
