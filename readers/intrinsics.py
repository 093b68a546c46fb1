"""Pinhole intrinsics: from the user, from a camera.txt, or from what is published about a sensor."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vlmm_log.types import Float64, InputError


@dataclass(frozen=True)
class Intrinsics:
    """A pinhole camera; 0 where a value is not known."""

    fx: float  # px
    fy: float
    cx: float
    cy: float
    width: int = 0  # px
    height: int = 0
    depth_scale: float = 0.0  # stored depth value of one metre
    source: str = ""  # where the values come from

    @property
    def K(self) -> Float64:
        """(3, 3) matrix."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])


# Sturm et al., IROS 2012, and the benchmark's page: calibrated colour cameras, registered depth, 5000 per metre.
FREIBURG = {
    "freiburg1": Intrinsics(517.3, 516.5, 318.6, 255.3, 640, 480, 5000.0, "TUM RGB-D freiburg1"),
    "freiburg2": Intrinsics(520.9, 521.0, 325.1, 249.7, 640, 480, 5000.0, "TUM RGB-D freiburg2"),
    "freiburg3": Intrinsics(535.4, 539.2, 320.1, 247.6, 640, 480, 5000.0, "TUM RGB-D freiburg3"),
}
# Palazzolo et al., IROS 2019, and the dataset's page. Its lens distortion (k1 = 0.04) is not undone.
BONN = Intrinsics(542.822841, 542.576870, 315.593520, 237.756098, 640, 480, 5000.0, "Bonn RGB-D Dynamic")


def from_text(text: str) -> Intrinsics:
    """Intrinsics of 'fx,fy,cx,cy' px or of the path of a camera.txt. Raises InputError."""
    parts = text.split(",")
    if len(parts) == 4:
        try:
            fx, fy, cx, cy = (float(p) for p in parts)
        except ValueError as e:
            raise InputError(f"--intrinsics {text}: four numbers are expected, fx,fy,cx,cy in px") from e
        return _checked(Intrinsics(fx, fy, cx, cy, source="--intrinsics"), f"--intrinsics {text}")
    with suppress(OSError):  # a text too long to be a path
        if Path(text).is_file():
            return from_file(Path(text))
    raise InputError(f"--intrinsics {text}: neither 'fx,fy,cx,cy' in px nor a camera.txt")


def from_file(path: Path) -> Intrinsics:
    """Intrinsics of a text file with rows 'fx 525.0', also fy, cx, cy, width, height, depth_scale.

    Raises InputError where the file cannot be read or lacks one of the first four.
    """
    values: dict[str, float] = {}
    try:
        rows = path.read_text("utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as e:
        raise InputError(f"{path}: cannot read the intrinsics: {e}") from e
    for number, row in enumerate(rows, 1):
        words = row.split("#")[0].replace("=", " ").replace(":", " ").split()
        if not words:
            continue
        try:
            name, value = words
            values[name.lower()] = _finite(value)
        except ValueError as e:
            raise InputError(f"{path}:{number}: write a name and a number, for example 'fx 525.0'") from e
    missing = [name for name in ("fx", "fy", "cx", "cy") if name not in values]
    if missing:
        raise InputError(f"{path}: lacks {', '.join(missing)}; add them or give --intrinsics fx,fy,cx,cy")
    camera = Intrinsics(
        values["fx"],
        values["fy"],
        values["cx"],
        values["cy"],
        int(values.get("width", 0)),
        int(values.get("height", 0)),
        values.get("depth_scale", 0.0),
        path.name,
    )
    return _checked(camera, str(path))


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(text)
    return value


def _checked(camera: Intrinsics, where: str) -> Intrinsics:
    numbers = np.array([camera.fx, camera.fy, camera.cx, camera.cy, camera.depth_scale])
    if not np.isfinite(numbers).all() or camera.fx <= 0 or camera.fy <= 0 or camera.depth_scale < 0:
        raise InputError(f"{where}: focal lengths must be positive and all values finite")
    return camera
