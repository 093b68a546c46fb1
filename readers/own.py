"""A log of the caller's own: its frames are checked once, here, so that no stage need ask."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from vlmm_log.protocols import Log
from vlmm_log.readers.images import FARTHEST_M, ImageError, check_size, in_range
from vlmm_log.readers.intrinsics import is_camera
from vlmm_log.readers.matrices import pose_of_matrix
from vlmm_log.readers.stamps import LATEST_NS
from vlmm_log.types import Float64, Frame, Skipped


@dataclass
class Own:
    """The log, as it is; of its frames those that can be used, and why the others cannot."""

    log: Log
    _size: tuple[int, ...] | None = None  # (H, W) of the first frame

    def __getattr__(self, name: str) -> Any:
        """All else is the log's own: stored images, too, where it has them."""
        return getattr(self.log, name)

    def frames(self, start_ns: int, stop_ns: int) -> Iterator[Frame | Skipped]:
        """See protocols.Log. Depth that is 0, negative or not finite is unseen, as in stored images."""
        for item in self.log.frames(start_ns, stop_ns):
            told = replace(item, stamp_ns=min(max(item.stamp_ns, -LATEST_NS), LATEST_NS))
            if isinstance(item, Skipped) or isinstance(told, Skipped):
                yield told
                continue
            what = f"frame {item.index}"
            reason = "stamp is beyond what nanoseconds in 64 bits hold" if told.stamp_ns != item.stamp_ns else None
            if reason := reason or self._unusable(item):
                yield Skipped(told.stamp_ns, what, reason, item.index)
                continue
            if reason := _no_pose(item.T_world_cam):
                yield Skipped(item.stamp_ns, f"pose of {what}", reason, item.index)
            depth = in_range(item.depth, 1.0, 0.0, FARTHEST_M)
            yield replace(item, depth=depth, T_world_cam=None if reason else item.T_world_cam)

    def _unusable(self, frame: Frame) -> str | None:
        if frame.rgb.dtype != np.uint8 or frame.rgb.ndim != 3 or frame.rgb.shape[2] != 3:
            return "colour is not (H, W, 3) of uint8"
        if frame.depth.dtype.kind != "f" or frame.depth.shape != frame.rgb.shape[:2]:
            return "depth is not (H, W) of floats, as colour is"
        try:
            check_size(frame.depth.shape[0], frame.depth.shape[1], "frame's")
        except ImageError as e:
            return str(e)
        self._size = self._size or frame.depth.shape
        if frame.depth.shape != self._size:
            return "image size differs from the first frame's"
        return None if frame.K.shape == (3, 3) and is_camera(frame.K) else "K is of no pinhole camera"


def _no_pose(T: Float64 | None) -> str | None:
    if T is None:
        return None
    pose = pose_of_matrix(T) if T.shape == (4, 4) else "pose is not four rows of four numbers"
    return pose if isinstance(pose, str) else None
