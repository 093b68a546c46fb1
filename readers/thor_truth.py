"""What AI2-THOR says of its objects: identities, poses, how they may move, and how far they did.

``truth/objects.jsonl`` of a folder that examples/record_ai2thor.py wrote has one JSON object a line for each object of
each frame. Positions (m) and rotations are in the right-handed world of the folder's poses, z up.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vlmm_log import se3
from vlmm_log.types import Float64, InputError, freeze

FILE = "truth/objects.jsonl"
STILL_M, STILL_RAD = 1e-3, 1e-3  # below both an object has not moved: a settled simulation jitters


@dataclass(frozen=True, eq=False)
class ThorObject:
    """An object in one frame."""

    frame: int  # index of the frame
    identity: int  # of its mask in masks/, 1 and up; the same in all frames
    id: str  # the simulator's own: "Apple|-00.47|+01.15|+00.48"
    type: str  # "CoffeeMachine"
    T_world_object: Float64  # (4, 4)
    moveable: bool  # can be pushed
    pickupable: bool  # can be carried
    openable: bool
    openness: float  # 0 closed to 1 open: a door that opens leaves T_world_object as it is
    visible: bool  # the simulator's word: near enough to be acted on

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def movable(self) -> bool:
        """Whether it can change its place at all."""
        return self.moveable or self.pickupable


@dataclass(frozen=True, eq=False)
class ThorMotion:
    """How an object moved in the world from one frame to another."""

    identity: int
    displacement: Float64  # (3,) m
    turn_rad: float
    opened: float  # change of openness

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def moved(self) -> bool:
        """Whether it changed its place, turned or was opened."""
        shifted = float(np.linalg.norm(self.displacement)) > STILL_M
        return shifted or self.turn_rad > STILL_RAD or self.opened != 0


def read_truth(folder: Path) -> tuple[ThorObject, ...]:
    """All objects of all frames, in the file's order. Raises InputError where there is no truth, or a bad line."""
    path = folder / FILE
    try:
        lines = path.read_text("utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as e:
        raise InputError(f"{path}: cannot be read: {e}; record with examples/record_ai2thor.py") from e
    return tuple(_object(line, f"{path}:{number}") for number, line in enumerate(lines, 1) if line.strip())


def motion(truth: Iterable[ThorObject], first: int, second: int) -> tuple[ThorMotion, ...]:
    """Motion of every object that both frames (by index) have, by ascending identity."""
    at: dict[int, dict[int, ThorObject]] = {first: {}, second: {}}
    for thing in truth:
        if thing.frame in at:
            at[thing.frame][thing.identity] = thing
    return tuple(_between(at[first][k], at[second][k]) for k in sorted(at[first].keys() & at[second].keys()))


def movers(truth: Sequence[ThorObject], first: int, second: int) -> frozenset[int]:
    """Identities of what moved between two frames."""
    return frozenset(m.identity for m in motion(truth, first, second) if m.moved)


def _between(a: ThorObject, b: ThorObject) -> ThorMotion:
    turn = se3.log(se3.inverse(a.T_world_object) @ b.T_world_object)[:3]
    shift = b.T_world_object[:3, 3] - a.T_world_object[:3, 3]
    return ThorMotion(a.identity, shift, float(np.linalg.norm(turn)), b.openness - a.openness)


def _object(line: str, where: str) -> ThorObject:
    try:
        row = json.loads(line)
        position, quaternion = np.array(row["position"], float), np.array(row["rotation"], float)
        if position.shape != (3,) or quaternion.shape != (4,) or not abs(np.linalg.norm(quaternion) - 1) < 0.01:
            raise ValueError("position is not x y z, or rotation no unit quaternion x y z w")
        T = se3.from_quaternion(position, quaternion / np.linalg.norm(quaternion))
        return ThorObject(
            int(row["frame"]),
            int(row["identity"]),
            str(row["id"]),
            str(row["type"]),
            T,
            bool(row["moveable"]),
            bool(row["pickupable"]),
            bool(row["openable"]),
            float(row["openness"]),
            bool(row["visible"]),
        )
    except (ValueError, TypeError, LookupError, OverflowError, RecursionError) as e:
        raise InputError(f"{where}: not an object as examples/record_ai2thor.py writes it: {e!r}; record again") from e
