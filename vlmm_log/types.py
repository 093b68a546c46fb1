"""The nouns: what a log gives, what each stage makes of it. numpy only.

Units are metres, radians, pixels and integer nanoseconds. Camera axes: x right, y down, z forward;
pixel centres lie at integer coordinates. ``T_a_b`` maps points of frame b into frame a. Dense results
of a pair lie on the pixel grid of its first frame. Arrays inside these types are read-only.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Int32 = NDArray[np.int32]
Int64 = NDArray[np.int64]
UInt8 = NDArray[np.uint8]
UInt16 = NDArray[np.uint16]

CHI2_3_MEDIAN = 2.3659738843753377
"""Median of the chi-square distribution with 3 degrees of freedom: d_M^2 of a still point."""


class InputError(Exception):
    """The call or its input cannot be used. The message is one line: what, where, remedy; without secrets of URLs."""

    def __init__(self, message: str) -> None:
        line = " ".join(message.splitlines())  # a path or a value may hold line breaks
        line = re.sub(r"://\S*@", "://[...]@", line)  # user and password
        super().__init__(re.sub(r"(://[^\s?#]*[?#])\S*", r"\1[...]", line))


def freeze(record: object) -> None:
    """Make every array of a dataclass instance read-only."""
    for value in vars(record).values():
        if isinstance(value, np.ndarray):
            value.flags.writeable = False


@dataclass(frozen=True, eq=False)
class EncodedImage:
    """An image as the log holds it, so that a sink can pass it on without encoding it again."""

    data: bytes
    media_type: str  # "image/png", "image/jpeg"
    units_per_meter: float = 0.0  # of a depth image: stored value of one metre


@dataclass(frozen=True, eq=False)
class Frame:
    """One moment of the log: colour, registered depth, camera and where it stood."""

    stamp_ns: int  # of the depth image; the pose is interpolated at it
    index: int  # stable position in the source, the key when runs are compared
    rgb: UInt8  # (H, W, 3)
    depth: Float32  # (H, W) m, NaN where unseen
    K: Float64  # (3, 3) pinhole intrinsics, px
    T_world_cam: Float64 | None = None  # (4, 4), None where the log has no pose
    encoded_rgb: EncodedImage | None = None
    encoded_depth: EncodedImage | None = None

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True, eq=False)
class FramePair:
    """Two frames to be compared, the first one earlier."""

    first: Frame
    second: Frame

    def relative_pose(self) -> Float64:
        """``T_second_first`` (4, 4) by the log's poses; identity where either frame has none."""
        a, b = self.first.T_world_cam, self.second.T_world_cam
        if a is None or b is None:
            return np.eye(4)
        return np.asarray(np.linalg.solve(b, a), np.float64)


@dataclass(frozen=True)
class Skipped:
    """Something in the log that was not used, and why."""

    stamp_ns: int
    what: str  # "rgb/1305031237.029714.png", "pair 12-15"
    reason: str  # one of few texts, so that they can be counted
    index: int | None = None  # of the frame, where it has one


@dataclass(frozen=True, eq=False)
class Segments:
    """Instances of one frame. Where masks overlap, a pixel belongs to one of them."""

    labels: Int32  # (H, W) 0: none; k + 1: instance k of the n below
    names: tuple[str, ...]  # open-vocabulary label; "" where the segmenter knows none
    scores: Float32  # (n,) the detector's confidence in [0, 1]; 1 where it gives none
    identities: Int64  # (n,) the source's own identity, unique in a frame; -1 where it has none
    notes: tuple[str, ...] = ()  # what was left out or fell back, and why: few texts, so that they can be counted
    partition: bool = False  # pieces of all that is seen, the still world among them, rather than things before it

    def __post_init__(self) -> None:
        freeze(self)

    def __len__(self) -> int:
        return len(self.names)


@dataclass(frozen=True, eq=False)
class FlowField:
    """Dense optical flow both ways, and how far a round trip misses its start."""

    forward: Float32  # (H, W, 2) px, on the first frame's grid
    backward: Float32  # (H, W, 2) px, on the second frame's grid
    fb_error: Float32  # (H, W) px, |w_ab(u) + w_ba(u + w_ab(u))|, NaN where the target is out of view

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True, eq=False)
class Ego:
    """Camera motion between the two frames, as their static correspondences have it.

    A point p of the first camera, seen in image row v of H, lies in the second camera at
    ``exp((v / H - 1/2) row_twist) @ T_second_first @ p``.
    """

    T_second_first: Float64  # (4, 4)
    row_twist: Float64  # (6,) rotation rad, translation m, over the image's height; 0 for a rigid model
    covariance: Float64  # (6, 6) of the twist (rotation, translation) at the middle row
    correction: Float64  # (6,) twist from the log's relative pose to the refined one
    inlier_share: float  # of the matches tried; NaN where ego-refinement is off
    spread: float  # robust scale of the whitened residual: 1 when the noise model fits; NaN if off
    matches: int  # correspondences tried
    reliable: bool  # False: too few matches or inliers, or no pose where none was estimated

    def __post_init__(self) -> None:
        freeze(self)


class Validity(IntEnum):
    """Why a pixel was scored or not."""

    VALID = 0
    NO_DEPTH = 1  # at either end
    OUT_OF_VIEW = 2  # the flow leaves the second image
    FB_INCONSISTENT = 3  # forward and backward flow disagree
    OCCLUDED = 4  # hidden in the second frame by something nearer
    OUT_OF_RANGE = 5  # its noise or its residual is more, or less, than single precision can weigh


@dataclass(frozen=True, eq=False)
class Motion:
    """How far each pixel moved against the static world, in metres and in sigmas."""

    residual: Float32  # (3, H, W) m, in the world frame (camera b's where the log has no poses); NaN: not valid
    d_m: Float32  # (H, W) Mahalanobis magnitude of the residual; NaN where not valid
    p_stat: Float32  # (H, W) chi-square tail probability of d_m**2, 3 degrees of freedom; NaN: not valid
    validity: UInt8  # (H, W) Validity
    tau_px: float  # d_m above it rejects "static" at the settings' alpha
    covariances: Callable[[int], Covariances] = field(repr=False)  # at every n-th row and column

    def __post_init__(self) -> None:
        freeze(self)

    @cached_property
    def valid_share(self) -> float:
        """Share of all pixels that were scored (coverage)."""
        return float(np.count_nonzero(self.validity == Validity.VALID)) / self.validity.size

    @cached_property
    def flagged_share(self) -> float:
        """Share of scored pixels above tau_px; NaN if none was scored."""
        flagged = np.count_nonzero(self.d_m > self.tau_px) / self.validity.size
        return flagged / self.valid_share if self.valid_share else float("nan")

    @cached_property
    def static_d_m2_median(self) -> float:
        """Median of d_m**2: 2.366 where the noise model fits and most of the view is still.

        Of every fourth row and column, as all medians here; NaN if none was scored.
        """
        return self._median(self.d_m) ** 2

    @cached_property
    def norm(self) -> Float32:
        """(H, W) m, length of the residual; NaN where not valid."""
        return np.asarray(np.sqrt(np.einsum("kvu,kvu->vu", self.residual, self.residual)))

    @cached_property
    def median_norm(self) -> float:
        """Median of ``norm``, m; NaN if none was scored."""
        return self._median(self.norm)

    def _median(self, values: Float32) -> float:
        some = values[::4, ::4]
        some = some[~np.isnan(some)]
        return float(np.median(some)) if some.size else float("nan")


@dataclass(frozen=True, eq=False)
class Posterior:
    """How likely each pixel moved, by a calibration."""

    p_moving: Float32  # (H, W) in [0, 1]; NaN where not valid

    def __post_init__(self) -> None:
        freeze(self)


class Outcome(IntEnum):
    """What became of a pixel whose truth is known."""

    QUIET = 0  # static, not flagged
    HIT = 1  # moving, flagged
    MISS = 2  # moving, scored, not flagged
    LOST = 3  # moving, not scored
    FALSE_FLAG = 4  # static, flagged
    IGNORED = 5  # no truth


@dataclass(frozen=True, eq=False)
class Judgement:
    """A pair's score against the truth, on the first frame's grid."""

    truth: UInt8  # (H, W) 0 static, 128 ignored, 255 moving
    outcome: UInt8  # (H, W) Outcome
    score: Float32  # (H, W) what was judged, in its own unit; NaN where not scored
    figures: Mapping[str, float]  # metrics of the pair by name

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True, eq=False)
class Covariances:
    """Sigma_m on a coarser grid: row i, column j speaks of pixel (i * stride, j * stride)."""

    stride: int
    upper: Float32  # (6, h, w) m^2: xx, xy, xz, yy, yz, zz in the frame of Motion.residual; NaN: not valid
    sigma_z: Float32  # (h, w) m, standard deviation along the second camera's optical axis

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True, eq=False)
class Span:
    """Camera-to-world poses (4, 4) at two times."""

    start_ns: int
    stop_ns: int
    T_start: Float64
    T_stop: Float64

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True, eq=False)
class Odometry:
    """Where the cameras of a pair stood: by the log's poses, else by chained ego-motion from the first frame."""

    pair: Span  # of the pair's frames
    link: Span  # the chain's last link
    from_log: bool  # whether the log gave the first frame's pose
    anchored: bool  # whether the world is that of the log's poses

    @property
    def T_world_first(self) -> Float64:
        """(4, 4) of the pair's first frame."""
        return self.pair.T_start

    @property
    def T_world_second(self) -> Float64:
        """(4, 4) of the pair's second frame."""
        return self.pair.T_stop


@dataclass(frozen=True, eq=False)
class Features:
    """Semantic features of a frame's instances."""

    vectors: Float32  # (n, D) unit; 0 where nothing is known

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True)
class Run:
    """What was asked for: enough to do it again."""

    source: str  # name of the log
    reader: str
    settings: str  # TOML, whole
    versions: dict[str, str]
    has_poses: bool
    world_up: str  # see protocols.Log
    notes: tuple[str, ...]  # what the reader decided

    @property
    def recording_id(self) -> str:
        """The same for the same source, settings and versions, so that equal runs give equal recordings."""
        versions = (f"{name} {version}" for name, version in sorted(self.versions.items()))
        text = "\n".join([self.source, *self.notes, self.settings, *versions])
        return f"{self.source}-{hashlib.sha256(text.encode()).hexdigest()[:12]}"


@dataclass(frozen=True)
class RunEnd:
    """What came of it."""

    complete: bool  # False: interrupted
    input_hash: str  # SHA-256 over the content of every frame read
    frames: int
    pairs: int
    told: tuple[str, ...] = field(default=(), compare=False)  # by the models: an endpoint's cost, a cache's use
