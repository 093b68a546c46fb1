"""What a recording holds: typed values on entities. Sinks write them, `recording` reads them back. numpy only.

Entities are named as in Rerun, without a leading slash: "world/camera/image/residual/d_m". What is told once for a
whole recording has no time.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlmm_log.types import EncodedImage, Float32, Float64, Int64, UInt8, UInt16, freeze

Column = NDArray[Any] | tuple[str, ...]
"""Numbers (n,) or (n, k), or texts: one row each."""


@dataclass(frozen=True, eq=False)
class Picture:
    """An encoded colour image."""

    data: bytes
    media_type: str  # "image/png", "image/jpeg"


@dataclass(frozen=True, eq=False)
class DepthMap:
    """Depth as it is stored; 0 or NaN where unseen."""

    stored: EncodedImage | UInt16 | Float32  # (H, W)
    units_per_meter: float  # stored value of one metre


@dataclass(frozen=True, eq=False)
class Raster:
    """A dense field of numbers, NaN where there is none."""

    values: NDArray[np.floating[Any]]  # (H, W), or (C, H, W) with C channels
    channels: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True, eq=False)
class Steps:
    """A dense field of numbers to the nearest step, of ``rvl.encode_steps``. Read back, it is a Raster."""

    image: bytes
    step: float


@dataclass(frozen=True, eq=False)
class Labels:
    """A class or an identity at each pixel."""

    values: UInt8 | UInt16  # (H, W)

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True)
class LabelNames:
    """Names and colours of the classes of an entity's Labels."""

    classes: tuple[tuple[int, str, tuple[int, ...]], ...]  # class, name, RGB or RGBA


@dataclass(frozen=True, eq=False)
class Pose:
    """A camera in the world."""

    translation: Float32  # (3,) m
    quaternion: Float32  # (4,) x y z w

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera."""

    K: Float32  # (3, 3) px
    width: int
    height: int

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True, eq=False)
class Arrows:
    """Arrows on an image."""

    origins: Float32  # (n, 2) px
    vectors: Float32  # (n, 2) px
    color: tuple[int, int, int] | None = None

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True, eq=False)
class Boxes:
    """Boxes around instances on an image."""

    corners: Float32  # (n, 4) px: left, top, right, bottom
    ids: Int64  # (n,) of elements
    names: tuple[str, ...]

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True, eq=False)
class Ellipsoids:
    """How rows of a table look in space."""

    centers: Float32  # (n, 3) m
    half_sizes: Float64  # (n, 3) m
    quaternions: Float64  # (n, 4) x y z w
    colors: tuple[tuple[int, int, int], ...]
    labels: tuple[str, ...]
    labelled: bool = True  # labels are shown unasked


@dataclass(frozen=True, eq=False)
class Table:
    """Rows of figures. All columns have the same length; the first one is (n,)."""

    columns: Mapping[str, Column]
    shown: Ellipsoids | None = None  # a view: not read back

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()), ()))


@dataclass(frozen=True, eq=False)
class Cloud:
    """Coloured points."""

    points: Float32  # (n, 3) m
    colors: UInt8  # (n, 3)
    radius: float  # m

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True)
class Scalar:
    """A figure that is plotted."""

    value: float


EGO_UNRELIABLE = "ego_unreliable"
"""How the line begins that tells of a pair whose camera motion is not to be trusted."""


@dataclass(frozen=True)
class LogLine:
    """What was left out, and why; what a model told."""

    text: str
    level: str  # "INFO", "WARN"


@dataclass(frozen=True)
class States:
    """What an element is and does at present: fused class; moves, still or unseen."""

    lanes: tuple[str, ...]


@dataclass(frozen=True)
class StateNames:
    """What the lanes of an element's States are called."""

    label: str


@dataclass(frozen=True)
class Look:
    """Something that only decides how a viewer draws, read back: known by what it is and a digest of it."""

    component: str
    digest: str


Value = (
    Picture
    | DepthMap
    | Raster
    | Steps
    | Labels
    | LabelNames
    | Pose
    | Camera
    | Arrows
    | Boxes
    | Table
    | Cloud
    | Scalar
    | LogLine
    | States
    | StateNames
    | Look
)


@dataclass(frozen=True, eq=False)
class Entry:
    """A value at a time. ``stamp_ns`` None: it holds for the whole recording. ``index`` None: of no frame."""

    entity: str
    value: Value
    stamp_ns: int | None
    index: int | None
