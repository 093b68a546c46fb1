"""When the images of a log were taken, and which of them belong together."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from vlmm_log.readers.stamps import LATEST_NS, associate, limit_ns
from vlmm_log.readers.stored import StoredLog
from vlmm_log.settings import ReadSettings
from vlmm_log.types import Int64, Skipped


@dataclass(frozen=True, eq=False)
class Timeline:
    """Stamps in ascending order; nothing of an image itself."""

    rgb_ns: Int64  # (n,)
    depth_ns: Int64  # (m,)
    pairs: Int64  # (k, 2) indices of rgb and depth that belong together
    origin_ns: int  # time of the log's first frame, from which its windows are counted
    left_out: Counter[str]  # reasons

    @property
    def frame_ns(self) -> Int64:
        """(k,) stamps of the frames: those of their depth images."""
        return np.asarray(self.depth_ns[self.pairs[:, 1]])

    @property
    def colour_ns(self) -> Int64:
        """(k,) stamps of the frames' colour images."""
        return np.asarray(self.rgb_ns[self.pairs[:, 0]])

    @property
    def period_ns(self) -> float:
        """Usual time from frame to frame; infinite where there is one frame."""
        return float(np.median(np.diff(self.frame_ns))) if len(self.pairs) > 1 else np.inf


def read_timeline(log: StoredLog, s: ReadSettings) -> Timeline:
    """The stamps of a log within the settings' window. No image is loaded."""
    stamps: dict[str, list[int]] = {"rgb": [], "depth": []}
    left_out: Counter[str] = Counter()
    _ = log.poses  # what they lose is told with the images
    for shot in log.shots(-LATEST_NS, LATEST_NS):
        if isinstance(shot, Skipped):
            left_out[shot.reason] += 1
        else:
            stamps[shot.kind].append(shot.stamp_ns)
    rgb, depth = (np.unique(np.array(stamps[kind], np.int64)) for kind in ("rgb", "depth"))
    pairs = np.array(associate(rgb.tolist(), depth.tolist(), limit_ns(s.association_s)), np.int64).reshape(-1, 2)
    first_ns = int(depth[pairs[0, 1]]) if len(pairs) else 0
    origin_ns = getattr(log, "origin_ns", first_ns)  # where a clock was set back, not the earliest stamp
    since = depth[pairs[:, 1]] - origin_ns
    pairs = pairs[(since >= limit_ns(s.start_s)) & (since < limit_ns(s.stop_s))]
    return Timeline(rgb, depth, pairs, origin_ns, left_out)
