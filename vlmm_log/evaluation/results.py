"""What an evaluation finds, as plain frozen values: what tables, JSON and the report are made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from vlmm_log.calibration import Calibration
from vlmm_log.evaluation.metrics import Decision, Reliability
from vlmm_log.types import Float32, UInt8


@dataclass(frozen=True)
class PixelRow:
    """One score over all judged pixels of all pairs. Shares in [0, 1]; NaN where there was nothing to judge."""

    trial: str  # settings, or baseline
    score: str  # "d_M", "raw", or the baseline's own
    ap: float  # full frame: a pixel that was not scored has score 0
    ap_interval: tuple[float, float]  # 95 %, frames drawn again
    scored_ap: float  # of scored pixels alone
    coverage: float
    prevalence: float
    recall: float  # at the threshold
    precision: float
    static_flags: float  # share of scored static pixels above the threshold
    far_flags: float  # of those beyond far_m
    far_flags_at_recall: float  # at the recall that the first row has at its threshold
    threshold: float
    pixels: int
    pairs: int


@dataclass(frozen=True)
class ObjectRow:
    """One way to rank elements, for the three queries."""

    name: str
    reference: str
    ap: Mapping[str, float]  # query -> average precision
    decisions: Mapping[str, Decision]  # query -> of what the answer names; empty where a mechanism only ranks
    macro_f1: float  # of the three classes; NaN where a mechanism decides none


@dataclass(frozen=True)
class Things:
    """What there was to find."""

    elements: int
    missed: int  # things large enough that became no element
    prevalence: Mapping[str, float]  # query -> share


@dataclass(frozen=True)
class Association:
    """How well a trial kept identities."""

    trial: str
    idf1: float
    elements: int
    things: int


@dataclass(frozen=True)
class CalibrationRow:
    """How far a probability is from how often it is right."""

    name: str
    unit: str  # "pixel" or "element"
    reliability: Reliability
    count: int

    @property
    def ece(self) -> float:
        """Expected calibration error, 15 bins."""
        return self.reliability.ece


@dataclass(frozen=True, eq=False)
class WorstFrame:
    """A frame that the first trial did badly in, to be looked at."""

    source: str
    index: int
    ap: float
    rgb: UInt8  # (H, W, 3)
    outcome: UInt8  # (H, W) Outcome
    score: Float32  # (H, W)


@dataclass(frozen=True)
class Evaluated:
    """A log that was judged."""

    name: str
    truth: str
    input_hash: str
    frames: int
    pairs: int
    judged_pairs: int
    skipped: Mapping[str, int]


@dataclass(frozen=True, eq=False)
class Evaluation:
    """All of it. The first pixel row is the settings as asked, scored by d_M."""

    title: str
    logs: tuple[Evaluated, ...]
    settings: str  # TOML
    versions: Mapping[str, str]
    pixels: tuple[PixelRow, ...]
    objects: tuple[ObjectRow, ...]
    things: Things | None
    association: tuple[Association, ...]
    calibration: tuple[CalibrationRow, ...]
    fitted: Calibration | None  # of the first trial; None where the truth has but one kind of pixels
    static_d_m2: float  # median of d_M^2 over static pixels: 2.366 is calibrated
    sigma_z: tuple[float, float] | None  # a m, b 1/m of sigma_z = a + b (z - z0)^2, fitted to static pixels
    worst: tuple[WorstFrame, ...]
