"""Lens distortion undone: images as a pinhole camera of the same K would have taken them."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from vlmm_log.readers.intrinsics import Intrinsics, checked
from vlmm_log.types import Float32, Float64, InputError, UInt8

REMEDY = "give the values of these images with --intrinsics, or --set read.distortion=none where they are rectified"


class Rectifier:
    """The maps of a camera, made once, and what they do to its images. K, so the size of a pixel, stays as it is."""

    def __init__(self, camera: Intrinsics, size: tuple[int, int]) -> None:
        """Maps for images of ``size`` (H, W) px.

        Raises InputError where the distortion is no model of OpenCV's, is for another size, or folds the image over.
        """
        x, y = source_places(camera, size)
        inside = _inside(x, y, size)
        folded = int((inside & (_area(x, y) <= 0)).sum())
        if folded:
            raise InputError(
                f"{_name(camera)}: {camera.model} distortion {camera.distortion} folds the image over at "
                f"{folded} of {inside.size} px; {REMEDY}"
            )
        self.size = size
        self.unseen_share = float(1 - inside.mean())  # of the rectified image: the lens shows nothing there
        # Fixed point, 1/32 px: faster, and with float maps OpenCV 5.0.0 fills pixels whose place lies outside.
        self._bilinear = cv2.convertMaps(x, y, cv2.CV_16SC2)
        self._nearest = cv2.convertMaps(x, y, cv2.CV_16SC2, nninterpolation=True)

    def rgb(self, image: UInt8) -> UInt8:
        """(H, W, 3), bilinear; 0 where the lens shows nothing. Raises InputError for another size."""
        self._check(image)
        out = cv2.remap(image, *self._bilinear, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
        return np.asarray(out, np.uint8)

    def depth(self, depth: Float32) -> Float32:
        """(H, W) m, of the nearest pixel, since between two surfaces there is none; NaN where the lens shows nothing.

        Raises InputError for another size.
        """
        self._check(depth)
        nan = float("nan")
        out = cv2.remap(depth, *self._nearest, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=nan)
        return np.asarray(out, np.float32)

    def _check(self, image: UInt8 | Float32) -> None:
        if image.shape[:2] != self.size:
            (h, w), (H, W) = image.shape[:2], self.size
            raise InputError(f"image is {w}x{h}, its lens distortion is undone for {W}x{H}; record images of one size")


def source_places(camera: Intrinsics, size: tuple[int, int]) -> tuple[Float32, Float32]:
    """Where each pixel of the rectified image of ``size`` (H, W) lies in the distorted one: x, y (H, W) px.

    OpenCV's camera models: Brown-Conrady, its rational form, Kannala-Brandt (fisheye). Raises InputError.
    """
    H, W = size
    checked(camera, _name(camera))
    if camera.width and (camera.height, camera.width) != size:
        raise InputError(
            f"{_name(camera)}: for {camera.width}x{camera.height}, while images are {W}x{H}; "
            "give --intrinsics and --set read.distortion for this size"
        )
    K, D = camera.K, np.array(camera.distortion)
    if camera.model == "equidistant":
        x, y = cv2.fisheye.initUndistortRectifyMap(K, D, np.eye(3), K, (W, H), cv2.CV_32FC1)
    else:
        x, y = cv2.initUndistortRectifyMap(K, D, np.eye(3), K, (W, H), cv2.CV_32FC1)
    return np.asarray(x, np.float32), np.asarray(y, np.float32)


def _name(camera: Intrinsics) -> str:
    return camera.source or "intrinsics"


def _inside(x: Float32, y: Float32, size: tuple[int, int]) -> NDArray[np.bool_]:
    """(H, W): whether a pixel of the source is nearest there. Places at infinity have none."""
    H, W = size
    return np.asarray((x >= -0.5) & (y >= -0.5) & (x <= W - 0.5) & (y <= H - 0.5))


def _area(x: Float32, y: Float32) -> Float64:
    """(H, W) px^2 of the source that a rectified pixel shows, the Jacobian; negative where it is turned over."""
    with np.errstate(invalid="ignore", over="ignore"):  # a rational model has poles
        (x_v, x_u), (y_v, y_u) = (np.gradient(place.astype(np.float64)) for place in (x, y))
        return np.asarray(x_u * y_v - x_v * y_u)
