"""A log as a TUM RGB-D folder. Sturm et al., IROS 2012."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from vlmm_log.readers.images import ImageError, decode_depth, decode_rgb, depth_values
from vlmm_log.readers.intrinsics import Intrinsics
from vlmm_log.readers.rectify import Rectifier
from vlmm_log.readers.register import register
from vlmm_log.readers.stored import Kind, Shot, StoredImage
from vlmm_log.settings import ReadSettings
from vlmm_log.types import Float32, Float64, Skipped
from vlmm_log.writers.chain import Chain, Pose
from vlmm_log.writers.depth import in_units, png_of_depth, shifted
from vlmm_log.writers.encoded import file_header, png

UNITS_PER_METER = 5000.0
TITLES = {"rgb.txt": "timestamp filename", "depth.txt": "timestamp filename"}
TITLES |= {"groundtruth.txt": "timestamp tx ty tz qx qy qz qw"}
COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")  # as OpenCV orders them


@dataclass
class TumFolder:
    """Writes one event of a log after another, images as they come and the lists in the end.

    Depth that is not registered to colour is registered here, of rectified colour images.
    """

    folder: Path
    camera: Intrinsics
    depth_camera: tuple[Intrinsics, Float64] | None  # see stored.StoredLog
    size: tuple[int, int] | None  # (H, W) of the colour images; only asked for where depth is to be registered
    units_per_meter: float
    depth_shift: tuple[int, int]  # px
    s: ReadSettings
    chain: Chain | None
    counts: Counter[str] = field(default_factory=Counter)  # rows of each list
    rounding_m: float = 0.0
    lost: int = 0  # pixels
    _rows: dict[str, dict[int, str]] = field(default_factory=dict)  # list -> stamp -> what it says

    def __post_init__(self) -> None:
        for name in ("rgb", "depth"):
            (self.folder / name).mkdir(parents=True)
            self._rows[f"{name}.txt"] = {}

    @property
    def notes(self) -> list[str]:
        """What was changed."""
        told = []
        if self.depth_camera is not None:
            told.append(
                f"depth registered to colour from {self.depth_camera[0].source}, "
                f"within {self.s.depth_min_m:g} and {self.s.depth_max_m:g} m"
            )
        if self._rectifies:
            told.append("colour rectified, since depth is registered to rectified colour")
        if self.rounding_m:
            told.append(f"depth rounded to 1/{UNITS_PER_METER:g} m, by {self.rounding_m * 1e3:.2g} mm at most")
        if self.lost:
            told.append(f"{self.lost} px of depth beyond what {UNITS_PER_METER:g} per metre can hold are unseen now")
        if self.chain is not None and self.chain.up != "+z":
            told.append(f"the world's {self.chain.up} points up, which a TUM folder cannot say")
        return told

    def write(self, event: Shot | Pose) -> Skipped | None:
        """Write one; or why it cannot be."""
        match event:
            case Pose(stamp_ns=stamp_ns, position=position, quaternion=quaternion):
                values = " ".join(repr(float(v)) for v in (*position, *quaternion))
                return self._list("groundtruth.txt", stamp_ns, values, "pose")
            case Shot():
                if event.stamp_ns in self._rows[f"{event.kind}.txt"]:
                    return Skipped(event.stamp_ns, event.what, "stamp repeated")
                try:
                    return self._write_image(event, event.load())
                except ImageError as e:
                    return Skipped(event.stamp_ns, event.what, str(e), event.index if event.kind == "rgb" else None)

    def finish(self) -> None:
        """Write the lists and the camera."""
        for name, rows in self._rows.items():
            lines = [f"{seconds(stamp_ns)} {rows[stamp_ns]}\n" for stamp_ns in sorted(rows)]
            (self.folder / name).write_text("".join([f"# {TITLES[name]}\n", *lines]), "utf-8")
        camera = replace(self.camera, distortion=()) if self._rectifies else self.camera
        (self.folder / "camera.txt").write_text(camera_text(camera), "utf-8")

    def _write_image(self, shot: Shot, image: StoredImage) -> Skipped | None:
        suffix, data = self._rgb(image) if shot.kind == "rgb" else (".png", self._depth(image))
        name = f"{shot.kind}/{seconds(shot.stamp_ns)}{suffix}"
        (self.folder / name).write_bytes(data)
        return self._list(_LISTS[shot.kind], shot.stamp_ns, name, shot.what)

    def _rgb(self, image: StoredImage) -> tuple[str, bytes | memoryview]:
        """Suffix and bytes: those of the log itself where they are PNG or JPEG, damaged or not; else a PNG."""
        header = None if image.encoding or self._rectifies else file_header(image.data)
        if header is not None:
            return {"png": ".png", "jpeg": ".jpg"}[header.kind], image.data
        pixels = decode_rgb(image)
        if self._rectifies:
            pixels = self._lens(self.camera, (pixels.shape[0], pixels.shape[1])).rgb(pixels)
        return ".png", png(pixels)

    def _depth(self, image: StoredImage) -> bytes | memoryview:
        as_stored = self.depth_camera is None and self.depth_shift == (0, 0)
        if as_stored and self.units_per_meter == UNITS_PER_METER and (data := png_of_depth(image)) is not None:
            return data
        if self.depth_camera is None:
            stored = in_units(shifted(depth_values(image), *self.depth_shift), self.units_per_meter, UNITS_PER_METER)
        else:
            stored = in_units(self._registered(image, *self.depth_camera), 1.0, UNITS_PER_METER)
        self.rounding_m = max(self.rounding_m, stored.rounding_m)
        self.lost += stored.lost
        return png(stored.values)

    def _registered(self, image: StoredImage, camera: Intrinsics, T_rgb_depth: Float64) -> Float32:
        """Depth (H, W) m on the rectified colour image's grid, as frames have it."""
        assert self.size is not None
        metres = decode_depth(image, self.units_per_meter, self.s.depth_min_m, self.s.depth_max_m)
        metres = np.asarray(shifted(metres, *self.depth_shift), np.float32)
        size = (metres.shape[0], metres.shape[1])
        if camera.height and size != (camera.height, camera.width):
            raise ImageError(f"depth is {size[1]}x{size[0]}, its intrinsics are for {camera.width}x{camera.height}")
        if camera.distortion:
            metres = self._lens(camera, size).depth(metres)
        return register(metres, camera.K, self.camera.K, T_rgb_depth, self.size)

    def _list(self, name: str, stamp_ns: int, row: str, what: str) -> Skipped | None:
        rows = self._rows.setdefault(name, {})
        if stamp_ns in rows:
            return Skipped(stamp_ns, what, "stamp repeated")
        rows[stamp_ns] = row
        self.counts[name] += 1
        return None

    @property
    def _rectifies(self) -> bool:
        return self.depth_camera is not None and bool(self.camera.distortion)

    @cached_property
    def _lenses(self) -> dict[tuple[Intrinsics, tuple[int, int]], Rectifier]:
        return {}

    def _lens(self, camera: Intrinsics, size: tuple[int, int]) -> Rectifier:
        if (camera, size) not in self._lenses:
            self._lenses[camera, size] = Rectifier(camera, size)
        return self._lenses[camera, size]


_LISTS: dict[Kind, str] = {"rgb": "rgb.txt", "depth": "depth.txt"}


def seconds(stamp_ns: int) -> str:
    """A stamp in decimal seconds, exact."""
    whole, rest = divmod(abs(stamp_ns), 1_000_000_000)
    return f"{'-' if stamp_ns < 0 else ''}{whole}.{rest:09d}"


def camera_text(camera: Intrinsics) -> str:
    """What intrinsics.from_file reads."""
    rows: list[tuple[str, object]] = [("fx", camera.fx), ("fy", camera.fy), ("cx", camera.cx), ("cy", camera.cy)]
    if camera.width:
        rows += [("width", camera.width), ("height", camera.height)]
    rows.append(("depth_scale", UNITS_PER_METER))
    if camera.distortion:
        names = ("k1", "k2", "k3", "k4") if camera.model == "equidistant" else COEFFICIENTS
        rows += [("distortion_model", camera.model), *zip(names, camera.distortion, strict=False)]
    return "".join(f"{name} {value!r}\n" if isinstance(value, float) else f"{name} {value}\n" for name, value in rows)
