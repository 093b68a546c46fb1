"""The map's nouns: what was seen of an element, what that makes of it, and the map that holds them. numpy only."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from vlmm_log.background import Background, merged
from vlmm_log.types import Float32, Float64, Int32, Int64, Segments, UInt8, freeze

OBSERVATION = np.dtype(
    [
        ("first_ns", np.int64),  # stamps of the pair
        ("second_ns", np.int64),
        ("index", np.int32),  # of the pair's first frame
        ("pixels", np.int32),  # in the mask
        ("scored", np.int32),  # of them, valid in the motion channel
        ("o", np.float32),  # quantile of d_M over the scored pixels, in sigmas
        ("phi", np.float32),  # share of the scored pixels above tau_px
        ("gamma", np.float32),  # mean resultant length of their residuals' directions
        ("kappa", np.float32),  # reliability, phi * gamma
        ("gamma_all", np.float32),  # mean resultant length over all scored pixels, as the paper prints it
        ("part", np.float32),  # share of the mask's pixels in patches most of whose pixels are above tau_px
        ("position", np.float32, 3),  # m, world: mean of the mask's points near its median depth
        ("extent", np.float32, 6),  # m^2, covariance of those points: xx, xy, xz, yy, yz, zz, world axes
        ("drift", np.float32, 3),  # m, mean residual of the pixels above tau_px, world axes; 0 if there is none
    ]
)
"""One row: what one pair shows of one element."""

Observations = NDArray[np.void]  # of dtype OBSERVATION


@dataclass(frozen=True, eq=False)
class Instances:
    """What a pair shows of each instance by itself: wherever its cameras stand."""

    segments: Segments
    rows: Observations  # (n,) but for position, extent and drift
    boxes: Int32  # (n, 4) see Sightings
    mean: Float64  # (n, 3) m, of the points, in the first camera; NaN if there is none
    covariance: Float64  # (n, 6) m^2
    drift: Float64  # (n, 3) m, in the axes of Motion.residual

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True, eq=False)
class Sightings:
    """What a pair shows of each instance of its first frame."""

    segments: Segments
    rows: Observations  # (n,) one an instance
    boxes: Int32  # (n, 4) px, u and v of the first and the last column and row; the last before the first: no pixel
    observed: NDArray[np.bool_]  # (n,) enough scored pixels in a reliable pair: an observation for the map

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True, eq=False)
class Tracked:
    """Which element each instance is."""

    sightings: Sightings
    features: Float32  # (n, D)
    ids: Int64  # (n,)
    similarity: Float32  # (n,) of the assignment, in [0, 1]; 1 for the source's own identities, 0 for new elements

    def __post_init__(self) -> None:
        freeze(self)


class MotionClass(IntEnum):
    """The fused class y (paper, fusion rule)."""

    STATIC = 0
    MOVABLE_STATIC = 1
    MOVING = 2


def class_posterior(p_moving: Float32, rho: Float64) -> Float32:
    """(3, ...) probabilities of the classes in their order: moving, else movable by the prior, else static."""
    still = 1.0 - p_moving
    return np.array([still * (1.0 - rho), still * rho, p_moving], np.float32)


CLASS_COLORS: dict[MotionClass, tuple[int, int, int]] = {  # told apart also by the colour-blind (Okabe and Ito)
    MotionClass.STATIC: (0, 114, 178),
    MotionClass.MOVABLE_STATIC: (230, 159, 0),
    MotionClass.MOVING: (213, 94, 0),
}


@dataclass(frozen=True)
class Movability:
    """Whether things of a label can move."""

    rho: float  # in [0, 1]
    source: str  # "table: AI2-THOR", "similar to mug (0.81)", "llm: gpt-4o-mini", "unknown"


@dataclass(frozen=True, eq=False)
class Evidence:
    """All that was seen of one element: exact lists, so that maps merge exactly."""

    id: int
    votes: Mapping[str, int]  # label -> sum of the detector's scores, in thousandths
    observations: Observations  # (k,) in time order
    feature: Float32  # (D,) unit semantic feature, of the frame in which it had most pixels
    feature_pixels: int
    feature_index: int  # that frame

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def label(self) -> str:
        """The label with most votes; the first by name among equals."""
        return min(self.votes, key=lambda name: (-self.votes[name], name))


@dataclass(frozen=True, eq=False)
class Element:
    """The paper's tuple <p, f, o, kappa, rho, y, c>, and what the default profile adds to it."""

    evidence: Evidence
    label: str
    position: Float32  # (3,) m, world: median over observations
    extent: Float32  # (6,) m^2: median over observations
    o: float  # median observed-motion score; in units of objects.o_unit, so that `default` gives 1 for a still one
    kappa: float  # median reliability
    rho: float  # movability prior
    rho_source: str
    motion_class: MotionClass
    confidence: float  # c of the paper: kappa, rho or 1 - rho
    p_stat: float  # static-consistency p-value of the pixel at o: chi-square tail of (o in sigmas)^2; 1/4 if still
    score: float  # kappa-weighted mean of o: does not forget a mover that mostly stood still
    speed: float  # m/s: median of |drift| / time over the observations in intervals; 0 if there is none
    intervals: Int64  # (m, 2) ns, spans in which it was observed to move
    p_moving: float = float("nan")  # probability that it has moved, calibrated; NaN without a calibration

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def id(self) -> int:
        """Identity in the map."""
        return self.evidence.id

    @cached_property
    def row(self) -> bytes:
        """The numbers as a row of ROW: made once, however often the map is asked for its columns."""
        seen = self.evidence.observations
        whole = (self.evidence.feature_pixels, seen.size, seen["first_ns"][0], seen["second_ns"].max())
        attributes = (self.o, self.kappa, self.rho, self.motion_class, self.confidence, self.p_stat)
        told = (self.id, self.position, self.extent, *attributes, self.score, self.speed, self.p_moving)
        return np.array([(*told, *whole, len(self.intervals))], ROW).tobytes()


ROW = np.dtype(
    [
        ("id", np.int64),
        ("position", np.float32, 3),
        ("extent", np.float32, 6),
        ("o", np.float32),
        ("kappa", np.float32),
        ("rho", np.float64),
        ("motion_class", np.uint8),
        ("confidence", np.float32),
        ("p_stat", np.float32),
        ("score", np.float32),
        ("speed", np.float32),
        ("p_moving", np.float32),
        ("pixels", np.int32),
        ("observations", np.int32),
        ("first_ns", np.int64),
        ("last_ns", np.int64),
        ("intervals", np.int32),  # how many
    ]
)


@dataclass(frozen=True, eq=False)
class WorldMap:
    """The persistent map. ``elements`` holds the instantiated ones, ``evidence`` also what is still too small."""

    evidence: Mapping[int, Evidence]
    elements: Mapping[int, Element]
    clouds: tuple[Background, ...]  # the background in parts, so that it grows without being sorted anew each time
    touched: tuple[int, ...] = ()  # elements that the last update changed

    @cached_property
    def background(self) -> Background:
        """Coloured voxels of what stood still."""
        return merged(self.clouds)

    @cached_property
    def columns(self) -> Elements:
        """All elements by id, as columns."""
        return columns(self.elements[i] for i in sorted(self.elements))


@dataclass(frozen=True, eq=False)
class Elements:
    """Elements as columns: what queries, grids and sinks read. Units as in Element."""

    ids: Int64  # (n,)
    labels: tuple[str, ...]
    positions: Float32  # (n, 3)
    extents: Float32  # (n, 6)
    features: Float32  # (n, D)
    o: Float32  # (n,)
    kappa: Float32
    rho: Float64  # as the prior gives it: it is compared with a threshold that many share
    motion_class: UInt8  # MotionClass
    confidence: Float32
    p_stat: Float32
    score: Float32
    speed: Float32
    p_moving: Float32
    observations: Int32  # how many
    pixels: Int32  # most in one frame
    first_ns: Int64  # first and last time seen
    last_ns: Int64
    interval_rows: Int32  # (m,) row that each motion interval belongs to
    intervals: Int64  # (m, 2) ns
    rho_sources: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        freeze(self)

    def __len__(self) -> int:
        return int(self.ids.size)


def columns(elements: Iterable[Element]) -> Elements:
    """Elements as columns, in the order given."""
    rows = list(elements)
    table = np.frombuffer(b"".join(e.row for e in rows), ROW)
    each = {name: np.ascontiguousarray(table[name]) for name in ROW.names or ()}
    width = rows[0].evidence.feature.size if rows else 0
    return Elements(
        ids=each["id"],
        labels=tuple(e.label for e in rows),
        positions=each["position"],
        extents=each["extent"],
        features=np.array([e.evidence.feature for e in rows], np.float32).reshape(len(rows), width),
        o=each["o"],
        kappa=each["kappa"],
        rho=each["rho"],
        motion_class=each["motion_class"],
        confidence=each["confidence"],
        p_stat=each["p_stat"],
        score=each["score"],
        speed=each["speed"],
        p_moving=each["p_moving"],
        observations=each["observations"],
        pixels=each["pixels"],
        first_ns=each["first_ns"],
        last_ns=each["last_ns"],
        interval_rows=np.repeat(np.arange(len(rows), dtype=np.int32), each["intervals"]),
        intervals=np.concatenate([np.zeros((0, 2), np.int64), *(e.intervals for e in rows if len(e.intervals))]),
        rho_sources=tuple(e.rho_source for e in rows),
    )
