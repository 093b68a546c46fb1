"""How far two values of an entity are apart."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vlmm_log.comparison.difference import NAN, Figures
from vlmm_log.comparison.rows import table_figures
from vlmm_log.depth_pixels import metres
from vlmm_log.entries import (
    Arrows,
    Boxes,
    Camera,
    Cloud,
    DepthMap,
    LabelNames,
    Labels,
    LogLine,
    Look,
    Picture,
    Pose,
    Raster,
    Scalar,
    StateNames,
    States,
    Table,
    Value,
)
from vlmm_log.image_files import decoded
from vlmm_log.types import EncodedImage

SAME = Figures()
VECTORS = (("u", "v"), ("x", "y", "z"))  # channels whose distance is that of vectors
UNITS = {"d_m": "sigma", "norm": "m", "sigma_z": "m", "fb_error": "px", "tensor": "px", "covariance": "as logged"}


def figures(entity: str, a: Value, b: Value, atol: float, rtol: float) -> Figures:
    """How far B is from A, where it is more than the tolerance; ``SAME`` otherwise."""
    match a, b:
        case Raster(), Raster():
            found = _raster(a, b, atol, rtol, UNITS.get(entity.rsplit("/", 1)[-1], ""))
        case DepthMap(), DepthMap():
            found = _depth(a, b, atol, rtol)
        case Picture(), Picture():
            found = _picture(a, b, atol, rtol)
        case Labels(), Labels():
            found = _labels(a.values, b.values)
        case Pose(), Pose():
            found = _pose(a, b, atol, rtol)
        case Camera(), Camera():
            found = _camera(a, b, atol, rtol)
        case Scalar(), Scalar():
            found = _of_numbers(np.array([a.value]), np.array([b.value]), atol, rtol, "")
        case Arrows(), Arrows():
            found = _arrows(a, b, atol, rtol)
        case Boxes(), Boxes():
            found = table_figures(_columns(a), _columns(b), atol, rtol)
        case Cloud(), Cloud():
            found = _cloud(a, b)
        case Table(), Table():
            found = table_figures(a.columns, b.columns, atol, rtol)
        case LogLine() | States() | LabelNames() | StateNames() | Look(), _:
            found = SAME if a == b else Figures(1, 1, told=f"{_said(a)} -> {_said(b)}")
        case _:
            found = Figures(0, 0, 1, told=f"{type(a).__name__} -> {type(b).__name__}")
    return found


def _raster(a: Raster, b: Raster, atol: float, rtol: float, unit: str) -> Figures:
    if same_bits(a.values, b.values):
        return SAME
    if a.values.shape != b.values.shape or a.channels != b.channels:
        return _shapes(a.values, b.values)
    x, y = a.values.astype(np.float32), b.values.astype(np.float32)
    if a.channels not in VECTORS:
        return _of_numbers(x, y, atol, rtol, unit)
    apart = np.sqrt(np.sum(_apart(x, y) ** 2, axis=0))
    nan_x, nan_y = np.isnan(x), np.isnan(y)
    one_side, either = (np.asarray(nans.any(axis=0)) for nans in (nan_x != nan_y, nan_x | nan_y))
    return _of_distances(apart, np.sqrt(np.sum(y * y, axis=0)), one_side, either, atol, rtol, unit)


def same_bits(a: NDArray[Any], b: NDArray[Any]) -> bool:
    """Whether two arrays are one to the bit, NaN and all."""
    if a.dtype != b.dtype or a.shape != b.shape:
        return False
    bits = f"u{a.dtype.itemsize}"
    return bool(np.array_equal(np.ascontiguousarray(a).view(bits), np.ascontiguousarray(b).view(bits)))


def _shapes(a: NDArray[Any], b: NDArray[Any]) -> Figures:
    """Fields of different sizes: nothing of them can be compared."""
    return Figures(0, 0, max(a.size, b.size), told=f"size {_size(a)} -> {_size(b)}")


def _size(a: NDArray[Any]) -> str:
    return " x ".join(map(str, a.shape))


def _of_numbers(a: NDArray[Any], b: NDArray[Any], atol: float, rtol: float, unit: str) -> Figures:
    nan_a, nan_b = np.asarray(np.isnan(a)), np.asarray(np.isnan(b))
    return _of_distances(
        _apart(a, b), np.abs(b), np.asarray(nan_a != nan_b), np.asarray(nan_a | nan_b), atol, rtol, unit
    )


def _apart(a: NDArray[Any], b: NDArray[Any]) -> NDArray[Any]:
    """|a - b|; of one infinity from itself, 0."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.where(a == b, 0.0, np.abs(a - b)))


def _of_distances(
    distance: NDArray[Any],
    size: NDArray[Any],
    one_side: NDArray[np.bool_],
    either: NDArray[np.bool_],
    atol: float,
    rtol: float,
    unit: str,
) -> Figures:
    """Figures of distances. ``size`` is B's, which rtol is relative to; NaN may stand on one side, or on either."""
    unmatched = int(np.count_nonzero(one_side))
    both = ~either
    apart = distance[both]
    over = int(np.count_nonzero((apart > (atol + rtol * size[both] if rtol else atol)) | np.isinf(apart)))
    if not over and not unmatched:
        return SAME
    told = f"{unmatched} NaN on one side" if unmatched else ""
    if not apart.size:
        return Figures(0, 0, unmatched, unit=unit, told=told)
    k = [int(q * (apart.size - 1)) for q in (0.5, 0.95)]
    parted = np.partition(apart, k)
    p50, p95 = (float(parted[i]) for i in k)
    return Figures(apart.size, over, unmatched, p50, p95, float(apart.max()), unit, told)


def _depth(a: DepthMap, b: DepthMap, atol: float, rtol: float) -> Figures:
    files = [d.stored.data for d in (a, b) if isinstance(d.stored, EncodedImage)]
    if len(files) == 2 and files[0] == files[1] and a.units_per_meter == b.units_per_meter:
        return SAME
    try:
        x, y = metres(a), metres(b)
    except ValueError as e:
        return Figures(0, 0, 1, told=str(e))
    return _raster(Raster(x), Raster(y), atol, rtol, "m")


def _picture(a: Picture, b: Picture, atol: float, rtol: float) -> Figures:
    """Pictures are their pixels: the same ones in another file are the same."""
    if a.data == b.data:
        return SAME
    x, y = (decoded(p.data, cv2.IMREAD_COLOR) for p in (a, b))
    if x is None or y is None:
        return Figures(0, 0, 1, told="cannot be decoded")
    if x.shape != y.shape:
        return _shapes(x, y)
    apart = np.abs(x.astype(np.float32) - y.astype(np.float32)).max(axis=-1)
    never = np.zeros(apart.shape, bool)
    return _of_distances(apart, y.max(axis=-1).astype(np.float32), never, never, atol, rtol, "grey levels")


def _labels(a: NDArray[Any], b: NDArray[Any]) -> Figures:
    """Flipped pixels, and how well the classes or identities overlap (intersection over union)."""
    if same_bits(a, b):
        return SAME
    if a.shape != b.shape:
        return _shapes(a, b)
    x, y = a.astype(np.int64), b.astype(np.int64)
    flipped = int(np.count_nonzero(x != y))
    if not flipped:
        return SAME
    counts = [np.bincount(v.ravel(), minlength=int(max(x.max(), y.max())) + 1) for v in (x, y, x[x == y])]
    present = np.flatnonzero(counts[0] + counts[1])
    iou = counts[2][present] / (counts[0] + counts[1] - counts[2])[present]
    worst = int(np.argmin(iou))
    told = f"mean IoU {iou.mean():.3f}, least {iou[worst]:.3f} (label {present[worst]})"
    return Figures(x.size, flipped, 0, unit="px flipped", told=told)


def _pose(a: Pose, b: Pose, atol: float, rtol: float) -> Figures:
    if same_bits(a.translation, b.translation) and same_bits(a.quaternion, b.quaternion):
        return SAME
    cm = 100 * float(np.linalg.norm(a.translation.astype(float) - b.translation.astype(float)))
    p, q = a.quaternion.astype(float), b.quaternion.astype(float)
    q = q if p @ q >= 0 else -q
    angle = 2 * np.degrees(2 * np.arcsin(min(float(np.linalg.norm(p - q)) / 2, 1.0)))  # exact also for tiny angles
    near = cm <= atol + rtol * 100 * float(np.linalg.norm(b.translation)) and angle <= atol + rtol * 180
    if near:  # never of a pose that is not a number
        return SAME
    return Figures(1, 1, 0, cm, cm, cm, "cm", f"{angle:.4g} degrees")


def _camera(a: Camera, b: Camera, atol: float, rtol: float) -> Figures:
    if (a.width, a.height) != (b.width, b.height):
        return Figures(0, 0, 1, told=f"image {a.width} x {a.height} -> {b.width} x {b.height}")
    return _of_numbers(a.K.astype(float), b.K.astype(float), atol, rtol, "px")


def _arrows(a: Arrows, b: Arrows, atol: float, rtol: float) -> Figures:
    n, m = len(a.origins), len(b.origins)
    if n != m:
        return Figures(min(n, m), 0, abs(n - m), told=f"{n} arrows -> {m}")
    x, y = (np.hstack([arrows.origins, arrows.vectors]) for arrows in (a, b))
    return SAME if same_bits(x, y) else _of_numbers(x.astype(float), y.astype(float), atol, rtol, "px")


def _columns(boxes: Boxes) -> dict[str, Any]:
    return {"element_id": boxes.ids, "name": boxes.names, "corners": boxes.corners}


def _cloud(a: Cloud, b: Cloud) -> Figures:
    """Points as sets: one that moved or has another colour is one lost and one new."""
    if same_bits(a.points, b.points) and same_bits(a.colors, b.colors):
        return SAME
    x, y = (np.unique(_keys(cloud)) for cloud in (a, b))
    common = np.intersect1d(x, y, assume_unique=True).size
    lost, new = x.size - common, y.size - common
    return Figures(common, 0, lost + new, NAN, NAN, NAN, "points", f"{lost} points only in A, {new} only in B")


def _keys(cloud: Cloud) -> NDArray[Any]:
    """A point and its colour as one key each."""
    rows = np.hstack([np.ascontiguousarray(cloud.points).view(np.uint8).reshape(-1, 12), cloud.colors])
    return np.ascontiguousarray(rows).view("V15").ravel()


def _said(value: Value) -> str:
    match value:
        case LogLine(text, level):
            return f"{level} {text!r}"
        case States(lanes):
            return ", ".join(lanes)
        case Look(component, _):
            return f"look of {component}"
        case _:
            return repr(value)[:80]
