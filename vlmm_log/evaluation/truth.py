"""What really moved: of a simulated scene, of given masks, or by the paper's person proxy."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np

from vlmm_log import se3
from vlmm_log.image_files import decoded
from vlmm_log.protocols import Segmenter
from vlmm_log.types import Float32, Float64, Frame, FramePair, InputError, Int32, UInt8, freeze

STATIC, IGNORE, MOVING = 0, 128, 255
STILL_M, MOVED_M = 0.001, 0.01  # moved less than the one: static; at least the other: moving; between: ignored
PEOPLE = ("person", "people", "human", "man", "woman", "child")


@dataclass(frozen=True)
class ThingTruth:
    """What is true of one thing."""

    name: str
    movability: float  # rho of its type, in [0, 1]
    kind: str  # how it moves: "still", "hinge", "slide", ...


@dataclass(frozen=True, eq=False)
class PairTruth:
    """What is true of a pair, on the first frame's grid."""

    motion: UInt8  # (H, W) STATIC, IGNORE, MOVING
    instances: Int32 | None = None  # (H, W) identity of the thing, 0 none; None where the truth knows no things

    def __post_init__(self) -> None:
        freeze(self)


class Truth(Protocol):
    """Truth of a log."""

    @property
    def name(self) -> str:
        """What kind, and where from."""
        ...

    @property
    def things(self) -> Mapping[int, ThingTruth]:
        """By identity; empty where the truth is one of pixels alone."""
        ...

    def of(self, pair: FramePair) -> PairTruth | None:
        """None where there is no truth of this pair."""
        ...


class SimulatedTruth:
    """The truth/ folder of a simulated scene: exact, at any gap."""

    def __init__(self, folder: Path) -> None:
        """Raises InputError where a file of it is missing or unusable."""
        self.folder = folder
        try:
            about = json.loads((folder / "truth.json").read_text("utf-8"))
            self.name = f"exact, {about['scene']} seed {about['seed']}"
            self._units = float(about["depth_units_per_meter"])
            self.things = {
                int(r["id"]): ThingTruth(r["name"], float(r["movability"]), r["kind"])
                for r in _rows(folder / "objects.csv")
            }
            table = np.array([[float(x) for x in r.values()] for r in _rows(folder / "part_poses.csv")]).reshape(-1, 9)
            self._poses = {(int(row[0]), int(row[1])): T for row, T in zip(table, _motions(table[:, 2:]), strict=True)}
            self._cameras = _motions(_lines(folder / "poses.txt")[:, 1:])
            if not 0 < self._units < math.inf:
                raise ValueError(f"depth_units_per_meter is {self._units}")
        except (OSError, KeyError, ValueError, IndexError, TypeError, OverflowError, RecursionError, csv.Error) as e:
            told = f"no {e} in it" if isinstance(e, KeyError) else str(e)
            raise InputError(f"{folder}: no truth of a simulated scene: {told}; make it with vlmm-log simulate") from e

    def of(self, pair: FramePair) -> PairTruth | None:
        """See Truth. None for frames that were not simulated. Raises InputError where a file of it is damaged."""
        a, b = pair.first.index, pair.second.index
        if not max(a, b) < len(self._cameras):
            return None
        moved = self.displacement(pair)
        motion = np.full(moved.shape, IGNORE, np.uint8)
        motion[moved < STILL_M] = STATIC
        motion[moved >= MOVED_M] = MOVING
        return PairTruth(motion, self._image("instances", pair.first).astype(np.int32))

    def displacement(self, pair: FramePair) -> Float32:
        """(H, W) m: how far each surface point moved against the world from the first frame's time to the second's.

        NaN for what can move and is too far for the truth's own depth.
        """
        a, b = pair.first.index, pair.second.index
        stored = self._image("depth", pair.first).astype(np.float32)
        depth = np.where(stored > 0, stored / np.float32(self._units), np.float32(np.nan))
        part = self._image("parts", pair.first)
        rays = _rays(depth.shape, pair.first.K.tobytes())
        moved = np.zeros(depth.shape, np.float32)
        for k in np.unique(part[part > 0]).tolist():  # 0: what never moves
            D = self._pose(b, k) @ se3.inverse(self._pose(a, k))
            G = (D - np.eye(4)) @ self._cameras[a]
            at = part == k
            points = rays[:, at] * depth[at]
            moved[at] = np.linalg.norm(G[:3, :3] @ points + G[:3, 3:], axis=0)
        return moved

    def _pose(self, frame: int, part: int) -> Float64:
        try:
            T: Float64 = self._poses[frame, part]
        except KeyError as e:
            raise InputError(
                f"{self.folder / 'part_poses.csv'}: no pose of part {part} in frame {frame}; make the truth again"
            ) from e
        return T

    def _image(self, kind: str, frame: Frame) -> UInt8:
        path = self.folder / kind / f"{frame.index:06d}.png"
        image = _read(path)
        if image.shape != frame.depth.shape:
            (h, w), (H, W) = image.shape, frame.depth.shape
            raise InputError(f"{path}: {w}x{h} px, the log's images are {W}x{H}; take the truth of this log")
        return image


class MotionMasks:
    """A folder of masks by frame index, 0 static, 128 ignored, 255 moving, as ``000012.png``."""

    def __init__(self, folder: Path) -> None:
        """Raises InputError where there is none."""
        self.folder = folder
        if not any(folder.glob("[0-9]*.png")):
            raise InputError(
                f"{folder}: neither a simulated scene's truth (truth.json) nor masks by frame index (000012.png); "
                "give a folder of either"
            )

    @property
    def name(self) -> str:
        """See Truth."""
        return f"masks, {self.folder.name}"

    @property
    def things(self) -> Mapping[int, ThingTruth]:
        """None: they speak of pixels."""
        return {}

    def of(self, pair: FramePair) -> PairTruth | None:
        """See Truth. Raises InputError for other values and sizes."""
        path = self.folder / f"{pair.first.index:06d}.png"
        if not path.exists():
            return None
        mask = _read(path)
        if mask.shape != pair.first.depth.shape or not np.isin(mask, (STATIC, IGNORE, MOVING)).all():
            raise InputError(f"{path}: write masks of the images' size, 0 static, 128 ignored, 255 moving")
        return PairTruth(mask.astype(np.uint8))


@dataclass(frozen=True)
class People:
    """The paper's proxy: what a segmenter calls a person moves, all else does not."""

    segment: Segmenter
    name: str = "proxy: people move, all else is static"

    @property
    def things(self) -> Mapping[int, ThingTruth]:
        """None: it speaks of pixels."""
        return {}

    def of(self, pair: FramePair) -> PairTruth | None:
        """See Truth. None where nobody was found: such a frame has nothing to rank."""
        segments = self.segment(pair.first)
        people = [k + 1 for k, name in enumerate(segments.names) if name in PEOPLE]
        if not people:
            return None
        return PairTruth(np.where(np.isin(segments.labels, people), np.uint8(MOVING), np.uint8(STATIC)))


def _rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as f:
        return list(csv.DictReader(f))


def _lines(path: Path) -> Float64:
    """(n, 8) of lines of numbers: a stamp and a pose."""
    return np.array([line.split() for line in path.read_text("utf-8").splitlines()], np.float64).reshape(-1, 8)


def _motions(rows: Float64) -> Float64:
    """(n, 4, 4) of rows tx ty tz qx qy qz qw. Raises ValueError where a quaternion is none of unit length."""
    if not (np.abs(np.linalg.norm(rows[:, 3:7], axis=1) - 1) < 1e-3).all() or not np.isfinite(rows).all():
        raise ValueError("a row is no pose")
    return se3.from_quaternion(rows[:, :3], rows[:, 3:7])


def _read(path: Path) -> UInt8:
    """A one-channel image of 8 or 16 bit."""
    image = decoded(path.read_bytes(), cv2.IMREAD_UNCHANGED) if path.is_file() else None
    if image is None or image.ndim != 2:
        raise InputError(f"{path}: no image of one channel; make the truth again")
    return image  # type: ignore[return-value]


@lru_cache(maxsize=1)
def _rays(shape: tuple[int, ...], K_bytes: bytes) -> Float32:
    """(3, H, W) rays of unit depth."""
    K = np.frombuffer(K_bytes).reshape(3, 3)
    v, u = np.mgrid[0 : shape[0], 0 : shape[1]]
    return np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(shape)]).astype(np.float32)
