"""Cameras: intrinsics and lens distortion, from the user, from a camera.txt, or as published for a sensor."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from vlmm_log.image_files import LARGEST
from vlmm_log.settings import ReadSettings
from vlmm_log.types import Float64, InputError

LEAST_PX, MOST_PX = 1e-9, 1e9  # of a focal length: its square, and a ray's, stay within single precision
MODELS = {"plumb_bob": (4, 5), "rational_polynomial": (8,), "equidistant": (4,)}  # -> how many numbers


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
    distortion: tuple[float, ...] = ()  # k1 k2 p1 p2 [k3 [k4 k5 k6]] as OpenCV orders them; fisheye: k1 to k4
    model: str = "plumb_bob"  # or "rational_polynomial", "equidistant" (fisheye): ROS's names

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
# Handa et al., ICRA 2014. The page prints fy = -480, for a left-handed camera: conventions.icl() mirrors poses instead.
ICL = Intrinsics(481.2, 480.0, 319.5, 239.5, 640, 480, 5000.0, "ICL-NUIM")
KINECT = Intrinsics(525.0, 525.0, 319.5, 239.5, 640, 480, 0.0, "nominal Kinect and Xtion")
PRESETS = {**FREIBURG, "bonn": BONN, "icl": ICL, "kinect": KINECT}


def asked(s: ReadSettings, own: Intrinsics | None, path: Path) -> Intrinsics:
    """The source's own camera, changed by what the settings ask for. Raises InputError where none is known."""
    camera = own
    if s.intrinsics:
        given = from_text(s.intrinsics)
        scale = given.depth_scale or (own.depth_scale if own else 0.0)  # what is not given stays as it was
        lens = given.distortion or (own.distortion if own else ())
        model = given.model if given.distortion or own is None else own.model
        camera = replace(given, depth_scale=scale, distortion=lens, model=model)
    if camera is None:
        raise InputError(
            f"{path}: no intrinsics: no camera.txt in it and no freiburg1-3 in its name; give --intrinsics fx,fy,cx,cy"
        )
    if s.distortion == "none":
        return replace(camera, distortion=())
    return _lens(camera, s.distortion) if s.distortion else camera


def from_text(text: str) -> Intrinsics:
    """Intrinsics of 'fx,fy,cx,cy' px, of a preset's name or of the path of a camera.txt. Raises InputError."""
    if text in PRESETS:
        return replace(PRESETS[text], depth_scale=0.0)
    parts = text.split(",")
    if len(parts) == 4:
        try:
            fx, fy, cx, cy = (float(p) for p in parts)
        except ValueError as e:
            raise InputError(f"--intrinsics {text}: four numbers are expected, fx,fy,cx,cy in px") from e
        return checked(Intrinsics(fx, fy, cx, cy, source="--intrinsics"), f"--intrinsics {text}")
    with suppress(OSError):  # a text too long to be a path
        if Path(text).is_file():
            return from_file(Path(text))
    raise InputError(
        f"--intrinsics {text}: neither 'fx,fy,cx,cy' in px, nor a camera.txt, nor one of {', '.join(PRESETS)}"
    )


def _lens(camera: Intrinsics, text: str) -> Intrinsics:
    try:
        numbers = tuple(_finite(word) for word in text.split(","))
    except ValueError as e:
        raise InputError(f"read.distortion = {text!r}: give 'k1,k2,p1,p2[,k3[,k4,k5,k6]]' or none") from e
    model = "rational_polynomial" if len(numbers) == 8 else "plumb_bob"
    return checked(replace(camera, distortion=numbers, model=model), f"read.distortion = {text!r}")


def from_file(path: Path) -> Intrinsics:
    """Intrinsics of a text file with rows 'fx 525.0', also fy, cx, cy, width, height, depth_scale, k1, k2, p1, ...

    A row 'distortion_model equidistant' says that k1 to k4 are a fisheye's. Raises InputError where the file cannot be
    read or lacks one of the first four.
    """
    values: dict[str, float] = {}
    model = ""
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
            if name.lower() == "distortion_model":
                model = value
            else:
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
        *_distortion(values, model),
    )
    return checked(camera, str(path))


def _distortion(values: dict[str, float], model: str) -> tuple[tuple[float, ...], str]:
    fisheye = model == "equidistant"
    names: tuple[str, ...] = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    names = ("k1", "k2", "k3", "k4") if fisheye else names
    if not any(values.get(name) for name in names):
        return (), model or "plumb_bob"
    if not any(values.get(name) for name in names[5:]):
        names = names[:5]
    numbers = tuple(values.get(name, 0.0) for name in names)
    return numbers, model or ("rational_polynomial" if len(names) == 8 else "plumb_bob")


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(text)
    return value


def is_camera(K: Float64) -> bool:
    """Whether a matrix (3, 3) is of a pinhole camera without skew that can be reckoned with."""
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    focal = LEAST_PX <= fx <= MOST_PX and LEAST_PX <= fy <= MOST_PX
    rest = np.array_equal(K, [[fx, 0, cx], [0, fy, cy], [0, 0, 1]])  # no where it holds NaN
    return bool(focal and rest and max(abs(cx), abs(cy)) <= MOST_PX)


def checked(camera: Intrinsics, where: str) -> Intrinsics:
    """The same camera. Raises InputError, which names ``where``, for what no camera can be."""
    numbers = np.array([camera.fx, camera.fy, camera.cx, camera.cy, camera.depth_scale, *camera.distortion])
    if not np.isfinite(numbers).all() or not is_camera(camera.K) or camera.depth_scale < 0:
        raise InputError(
            f"{where}: focal lengths must be positive and all values finite, {LEAST_PX:g} to {MOST_PX:g} px"
        )
    w, h = camera.width, camera.height
    if min(w, h) < 0 or max(w, h, w * h) > LARGEST:
        raise InputError(f"{where}: no image is {w:.6g}x{h:.6g} px; correct width and height")
    if camera.distortion and len(camera.distortion) not in MODELS.get(camera.model, ()):
        known = "; ".join(f"{name} takes {' or '.join(map(str, n))}" for name, n in MODELS.items())
        raise InputError(f"{where}: {len(camera.distortion)} distortion numbers for {camera.model!r}: {known}")
    return camera
