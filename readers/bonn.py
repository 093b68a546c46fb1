"""Bonn RGB-D Dynamic folders: TUM layout, own intrinsics, poses of a marker. Palazzolo et al., IROS 2019.

The dataset's page (https://www.ipb.uni-bonn.de/data/rgbd-dynamic-dataset) gives the camera's pose as
``T_ros T_0 T_ros T_m`` for a listed pose T_0. No sequence could be had to check it on.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from vlmm_log.protocols import Log
from vlmm_log.readers.intrinsics import BONN
from vlmm_log.readers.tum import is_tum_folder, open_folder
from vlmm_log.settings import ReadSettings
from vlmm_log.types import Float64

T_ROS: Float64 = np.array([[-1.0, 0, 0, 0], [0, 0, 1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
T_M: Float64 = np.array(
    [
        [1.0157, 0.1828, -0.2389, 0.0113],
        [0.0009, -0.8431, -0.6413, -0.0098],
        [-0.3009, 0.6147, -0.8085, 0.0111],
        [0, 0, 0, 1],
    ]
)


class Bonn:
    """The reader."""

    name = "bonn"

    def recognises(self, path: Path) -> bool:
        """A folder in TUM layout that is called rgbd_bonn_*, or lies in one called bonn or rgbd_bonn_dataset."""
        full = path.resolve()
        inside = full.parent.name.lower() in ("bonn", "rgbd_bonn_dataset") and "freiburg" not in full.name
        return (full.name.startswith("rgbd_bonn_") or inside) and is_tum_folder(path)

    def open(self, path: Path, s: ReadSettings) -> Log:
        """The log of a folder. Raises InputError where lists are missing."""
        return open_folder(path, s, BONN, world=T_ROS, marker=T_ROS @ _rigid(T_M))


def _rigid(T: Float64) -> Float64:
    """The motion nearest to a published matrix whose 3x3 block is 1.06 times a rotation."""
    U, _, Vt = np.linalg.svd(T[:3, :3])
    out = T.copy()
    out[:3, :3] = U @ Vt
    return out
