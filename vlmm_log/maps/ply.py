"""Maps as PLY, to look at: the background's voxels in their colours, elements as ellipsoids in their class's.

A vertex bears ``element_id`` (-1: background) and ``motion_class`` (255: background). Written by Open3D.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from vlmm_log.elements import CLASS_COLORS, Element, MotionClass
from vlmm_log.maps.saved import SavedMap
from vlmm_log.open3d_loading import load_open3d
from vlmm_log.types import Float32, Float64, InputError, UInt8

SURFACE = 400  # points of an ellipsoid
SIGMAS = 2.0
NO_CLASS = 255


def write(path: Path, saved: SavedMap) -> None:
    """Write the cloud. Raises InputError where Open3D is missing or there is no point, OSError if the disk refuses."""
    o3d = load_open3d("a map as PLY")
    points, colors, ids, classes = cloud(saved)
    if not len(points):
        raise InputError(f"{saved.run.source}: its map has neither voxels nor elements to show; nothing was written")
    vertices = o3d.t.geometry.PointCloud(o3d.core.Tensor(points))
    vertices.point.colors = o3d.core.Tensor(colors)
    vertices.point.element_id = o3d.core.Tensor(ids[:, None])
    vertices.point.motion_class = o3d.core.Tensor(classes[:, None])
    named = path.with_name(path.name + ".ply")  # Open3D takes the format from the suffix
    try:
        with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
            o3d.t.io.write_point_cloud(str(named), vertices)
        _check_whole(named, len(points), points[0].nbytes + colors[0].nbytes + ids.itemsize + classes.itemsize)
        named.replace(path)
    finally:
        named.unlink(missing_ok=True)


def cloud(saved: SavedMap) -> tuple[Float32, UInt8, Float64, UInt8]:
    """Points (n, 3) m, colours (n, 3), element ids (n,) as PLY can hold them (exact below 2^53), classes (n,)."""
    background = saved.world.background
    elements = [saved.world.elements[i] for i in sorted(saved.world.elements)]
    points = [background.points, *(surface(e) for e in elements)]
    lengths = [len(p) for p in points]
    colors = [CLASS_COLORS[MotionClass(e.motion_class)] for e in elements]
    return (
        np.concatenate(points),
        np.concatenate([background.colors, np.repeat(np.array(colors, np.uint8).reshape(-1, 3), SURFACE, axis=0)]),
        np.repeat(np.array([-1, *(e.id for e in elements)], np.float64), lengths),
        np.repeat(np.array([NO_CLASS, *(e.motion_class for e in elements)], np.uint8), lengths),
    )


def surface(element: Element) -> Float32:
    """(SURFACE, 3) m, world: evenly spread points on the element's ellipsoid of SIGMAS standard deviations."""
    k = np.arange(SURFACE)
    z = 1 - (2 * k + 1) / SURFACE
    turn = k * np.pi * (3 - 5**0.5)  # golden angle
    sphere = np.stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z], axis=1)
    xx, xy, xz, yy, yz, zz = element.extent.astype(np.float64)
    spread, axes = np.linalg.eigh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    offsets = SIGMAS * sphere * np.sqrt(np.maximum(spread, 0)) @ axes.T  # a median of covariances may be none
    return np.asarray(element.position + offsets, np.float32)


def _check_whole(path: Path, points: int, bytes_a_point: int) -> None:
    """Raise OSError where the file is not as long as it must be: Open3D takes a full disk for success."""
    with path.open("rb") as f:
        head = f.read(4096)
    end = head.find(b"end_header\n") + len(b"end_header\n")
    if path.stat().st_size != end + points * bytes_a_point:
        raise OSError("it is not whole, is the disk full?")
