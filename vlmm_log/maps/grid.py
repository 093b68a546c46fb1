"""Occupancy grids as numpy's .npz or as the YAML and PGM pair of ROS's map_server."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from vlmm_log.maps.occupancy import FREE, OCCUPIED, Grid
from vlmm_log.outputs import replacing
from vlmm_log.types import InputError, UInt8

BLACK, WHITE, GREY = 0, 254, 205  # occupied, free, unknown, as map_saver writes them
OCCUPIED_THRESH, FREE_THRESH = 0.65, 0.196  # (255 - grey) / 255 is 1, .004 and .19608


def save_grid(path: Path, grid: Grid, *, force: bool) -> None:
    """Write ``F.npz``, or ``F.yaml`` and ``F.pgm``.

    Raises InputError where the suffix is another one, a file exists (without ``force``) or the disk refuses.
    """
    match path.suffix.lower():
        case ".npz":
            with replacing(path, force=force) as (partial,):
                _write_npz(partial, grid)
        case ".yaml":
            image = path.with_suffix(".pgm")
            with replacing(image, path, force=force) as (partial_image, partial):
                partial_image.write_bytes(pgm(grid))
                partial.write_text(yaml(grid, image.name), "utf-8")
        case _:
            raise InputError(f"{path}: a grid is written as .npz, or as .yaml with its .pgm; name it so")


def _write_npz(path: Path, grid: Grid) -> None:
    with path.open("wb") as f:
        np.savez_compressed(
            f,
            data=grid.data,
            motion_class=grid.motion_class,
            element_id=grid.element_id,
            resolution_m=grid.resolution_m,
            origin=grid.origin,
            floor_m=grid.floor_m,
            R_grid_world=grid.R_grid_world,
        )


def pgm(grid: Grid) -> bytes:
    """The image: its first row is the grid's highest y."""
    grey: UInt8 = np.full(grid.data.shape, GREY, np.uint8)
    grey[grid.data == OCCUPIED] = BLACK
    grey[grid.data == FREE] = WHITE
    return f"P5\n{grey.shape[1]} {grey.shape[0]}\n255\n".encode() + grey[::-1].tobytes()


def yaml(grid: Grid, image: str) -> str:
    """What map_server reads. JSON's texts are YAML's too."""
    x, y = (float(v) for v in grid.origin)
    return (
        f"image: {json.dumps(image)}\nmode: trinary\nresolution: {float(grid.resolution_m)!r}\n"
        f"origin: [{x!r}, {y!r}, 0.0]\nnegate: 0\n"
        f"occupied_thresh: {OCCUPIED_THRESH}\nfree_thresh: {FREE_THRESH}\n"
    )
