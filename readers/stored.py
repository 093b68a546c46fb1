"""What a log holds before it becomes frames: images as stored, and the log that can hand them out."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from vlmm_log.protocols import Log
from vlmm_log.readers.intrinsics import Intrinsics
from vlmm_log.readers.poses import Poses
from vlmm_log.types import Float64, Int64, Skipped

Kind = Literal["rgb", "depth"]


@dataclass(frozen=True, eq=False)
class StoredImage:
    """An image as its log holds it.

    ``encoding`` is a name of ROS's image_encodings ("rgb8", "16UC1", ...) for bare pixels, ROS's ``format`` text for
    compressedDepth ("16UC1; compressedDepth png"), and "" for an encoded file (PNG, JPEG, ...), known by its own bytes.
    """

    data: bytes | memoryview
    encoding: str = ""
    height: int = 0  # px; of bare pixels, like the rest
    width: int = 0
    step: int = 0  # bytes a row
    big_endian: bool = False


@dataclass(frozen=True, eq=False)
class Shot:
    """One image of a log, not yet loaded."""

    kind: Kind
    stamp_ns: int
    index: int  # position among the images of its kind
    what: str  # "rgb/1305031237.029714.png", "/camera/depth/image_raw 12"
    load: Callable[[], StoredImage]  # raises ImageError


@dataclass(frozen=True)
class Stream:
    """A topic or a list, by its index alone."""

    name: str
    type: str  # "sensor_msgs/msg/Image"; "" of a list
    role: str  # "rgb", "depth", "info", "depth_info", "pose"; "" where it plays none
    count: int | None
    first_ns: int | None  # bags: when it was recorded
    last_ns: int | None
    longest_gap_s: float  # nan where it is not known

    @property
    def rate_hz(self) -> float:
        """Mean rate; nan where it is not known."""
        if not self.count or self.first_ns is None or self.last_ns is None or self.last_ns <= self.first_ns:
            return math.nan
        return (self.count - 1) * 1e9 / (self.last_ns - self.first_ns)


def stream(name: str, type_: str, role: str, stamps_ns: Int64) -> Stream:
    """A stream of known stamps, ascending."""
    gap = float(np.diff(stamps_ns).max()) / 1e9 if stamps_ns.size > 1 else math.nan
    first_ns, last_ns = (int(stamps_ns[0]), int(stamps_ns[-1])) if stamps_ns.size else (None, None)
    return Stream(name, type_, role, int(stamps_ns.size), first_ns, last_ns, gap)


class StoredLog(Log, Protocol):
    """A log whose images can also be had as they are stored: for `info`, `convert` and `doctor`."""

    @property
    def streams(self) -> tuple[Stream, ...]:
        """What the log holds, from its index alone."""
        ...

    @property
    def posed(self) -> str:
        """Where poses come from and how much they cover, from the index alone; "" where there are none."""
        ...

    @property
    def ranked(self) -> Mapping[str, tuple[str, ...]]:
        """Per role, what could have been taken, best first, with the reason; empty where there was no choice."""
        ...

    @property
    def camera(self) -> Intrinsics:
        """Of the colour images, as stored."""
        ...

    @property
    def depth_camera(self) -> tuple[Intrinsics, Float64] | None:
        """Where depth is not registered to colour: the depth camera and its ``T_rgb_depth`` (4, 4)."""
        ...

    @property
    def units_per_meter(self) -> float:
        """Stored depth value of one metre; 1 for metres."""
        ...

    @property
    def poses(self) -> Poses | None:
        """Where the camera stood."""
        ...

    def shots(self, start_ns: int, stop_ns: int) -> Iterator[Shot | Skipped]:
        """Every image with ``start_ns <= time since the first frame < stop_ns``, by time, and all that is left out."""
        ...
