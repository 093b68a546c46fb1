"""Bonn RGB-D Dynamic folders: TUM layout, own intrinsics, poses of a marker. Palazzolo et al., IROS 2019."""

from __future__ import annotations

from pathlib import Path

from vlmm_log.protocols import Log
from vlmm_log.readers import conventions
from vlmm_log.readers.intrinsics import BONN
from vlmm_log.readers.tum import is_tum_folder, open_folder
from vlmm_log.settings import ReadSettings


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
        return open_folder(path, s, BONN, conventions.bonn())
