"""From a stored colour image and a stored depth image to a frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from vlmm_log.readers.compressed_depth import png_of
from vlmm_log.readers.images import ImageError, decode_depth, decode_rgb, media_type
from vlmm_log.readers.intrinsics import Intrinsics
from vlmm_log.readers.poses import Poses
from vlmm_log.readers.rectify import Rectifier
from vlmm_log.readers.register import register
from vlmm_log.readers.stamps import limit_ns
from vlmm_log.readers.stored import Shot, StoredImage
from vlmm_log.settings import ReadSettings
from vlmm_log.types import EncodedImage, Float32, Float64, Frame, InputError, Skipped


@dataclass
class Assembly:
    """What turns the images of one log into frames; the first frame fixes their size."""

    camera: Intrinsics
    units_per_meter: float
    poses: Poses | None
    s: ReadSettings
    depth_camera: tuple[Intrinsics, Float64] | None = None  # see stored.StoredLog
    size: tuple[int, int] | None = field(default=None, init=False)  # (H, W) of the first frame
    _lenses: dict[tuple[Intrinsics, tuple[int, int]], Rectifier] = field(default_factory=dict, init=False)

    def frames(self, rgb: Shot, depth: Shot) -> Iterator[Frame | Skipped]:
        """The frame of two images that belong together, or why there is none; and its pose, if that is missing."""
        what = f"{rgb.what}, {depth.what}"
        try:
            frame = self._frame(rgb, depth)
        except ImageError as e:
            yield Skipped(depth.stamp_ns, what, str(e), rgb.index)
            return
        self.size = self.size or (frame.depth.shape[0], frame.depth.shape[1])
        if frame.depth.shape != self.size:
            yield Skipped(depth.stamp_ns, what, "image size differs from the first frame's", rgb.index)
            return
        if self.poses is not None and frame.T_world_cam is None:
            reason = f"no two poses around it within {self.s.pose_gap_s:g} s"
            yield Skipped(depth.stamp_ns, f"pose of frame {rgb.index}", reason, rgb.index)
        yield frame

    def notes(self) -> list[str]:
        """What it does to images, and with which camera."""
        c = self.camera
        units = "in metres" if self.units_per_meter == 1 else f"{self.units_per_meter:g} per metre"
        told = [f"intrinsics {c.fx:g}, {c.fy:g}, {c.cx:g}, {c.cy:g} px from {c.source}", f"depth {units}"]
        if c.distortion:
            told.append(f"lens distortion undone: {c.model} {', '.join(f'{d:g}' for d in c.distortion)}")
        if self.depth_camera:
            d = self.depth_camera[0]
            told.append(f"depth registered to colour from {d.fx:g}, {d.fy:g}, {d.cx:g}, {d.cy:g} px of {d.source}")
        return told

    def _frame(self, rgb: Shot, depth: Shot) -> Frame:
        colour_stored, depth_stored = rgb.load(), depth.load()
        colour = decode_rgb(colour_stored)
        metres = decode_depth(depth_stored, self.units_per_meter, self.s.depth_min_m, self.s.depth_max_m)
        size = (colour.shape[0], colour.shape[1])
        aligned = self._aligned(metres, size)
        self._check_size(size, (aligned.shape[0], aligned.shape[1]))
        as_stored = aligned is metres
        lens = self._lens(self.camera, size) if self.camera.distortion else None
        if lens is not None:
            colour = lens.rgb(colour)
            aligned = aligned if self.depth_camera else lens.depth(aligned)
        T = None if self.poses is None else self.poses.at(depth.stamp_ns, limit_ns(self.s.pose_gap_s))
        return Frame(
            depth.stamp_ns,
            rgb.index,
            colour,
            aligned,
            self.camera.K,
            T,
            None if lens else encoded(colour_stored),
            encoded(depth_stored, self.units_per_meter) if as_stored and lens is None else None,
        )

    def _aligned(self, metres: Float32, size: tuple[int, int]) -> Float32:
        """Depth on the colour image's grid."""
        if self._shift != (0, 0):
            metres = shifted(metres, *self._shift)
        if self.depth_camera is None:
            return metres
        camera, T_rgb_depth = self.depth_camera
        if camera.height and metres.shape != (camera.height, camera.width):
            raise ImageError(
                f"depth is {metres.shape[1]}x{metres.shape[0]}, its intrinsics are for {camera.width}x{camera.height}"
            )
        if camera.distortion:
            metres = self._lens(camera, (metres.shape[0], metres.shape[1])).depth(metres)
        return register(metres, camera.K, self.camera.K, T_rgb_depth, size)

    @cached_property
    def _shift(self) -> tuple[int, int]:
        return parse_shift(self.s.depth_shift_px)

    def _lens(self, camera: Intrinsics, size: tuple[int, int]) -> Rectifier:
        if (camera, size) not in self._lenses:
            self._lenses[camera, size] = Rectifier(camera, size)
        return self._lenses[camera, size]

    def _check_size(self, rgb: tuple[int, int], depth: tuple[int, int]) -> None:
        if rgb != depth:
            raise ImageError(
                f"colour is {rgb[1]}x{rgb[0]}, depth is {depth[1]}x{depth[0]}; register depth to colour first"
            )
        c = self.camera
        if c.width and (c.height, c.width) != rgb:
            raise ImageError(
                f"image is {rgb[1]}x{rgb[0]}, intrinsics ({c.source}) are for {c.width}x{c.height}; "
                "give --intrinsics fx,fy,cx,cy"
            )


def encoded(image: StoredImage, units_per_meter: float = 0.0) -> EncodedImage | None:
    """The image's own PNG or JPEG bytes, for sinks to pass on; None where it is stored otherwise."""
    if image.encoding.startswith("16UC1; compressedDepth"):
        data = png_of(image.data)
    else:
        data = None if image.encoding else image.data
    media = None if data is None else media_type(data)
    return EncodedImage(bytes(data), media, units_per_meter) if data is not None and media else None


def parse_shift(text: str) -> tuple[int, int]:
    """Columns and rows of 'dx,dy'. Raises InputError."""
    try:
        dx, dy = (int(word) for word in text.split(","))
    except ValueError as e:
        raise InputError(f"read.depth_shift_px = {text!r}: give two whole numbers, 'dx,dy' in px") from e
    return dx, dy


def shifted(depth: Float32, dx: int, dy: int) -> Float32:
    """Depth (H, W) moved right by dx and down by dy; NaN where nothing comes from."""
    H, W = depth.shape
    out = np.full_like(depth, np.nan)
    if abs(dx) < W and abs(dy) < H:
        out[max(dy, 0) : H + min(dy, 0), max(dx, 0) : W + min(dx, 0)] = depth[
            max(-dy, 0) : H + min(-dy, 0), max(-dx, 0) : W + min(-dx, 0)
        ]
    return out
