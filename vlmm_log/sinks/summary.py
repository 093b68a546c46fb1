"""The figures of a run, gathered while it goes."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from statistics import median

from vlmm_log.protocols import Make, Moment, Result
from vlmm_log.sinks.stages import stage_of
from vlmm_log.types import CHI2_3_MEDIAN, Ego, FramePair, Motion, RunEnd, Segments, Skipped


@dataclass(frozen=True)
class Noted:
    """What the figures need of one result."""

    stage: str | None
    values: Mapping[str, float] = field(default_factory=dict)  # for the lists of these names
    skipped: tuple[str, ...] = ()  # reasons
    unreliable: bool = False


def noted(result: Result, _pair: FramePair | None = None) -> Noted:
    """What the figures need of a result."""
    stage = stage_of(result)
    match result:
        case Skipped():
            return Noted(stage, skipped=(result.reason,))
        case Segments():
            return Noted(stage, {"instances": len(result)}, result.notes)
        case Ego():
            return Noted(stage, {"inlier_share": result.inlier_share}, unreliable=not result.reliable)
        case Motion() if result.valid_share:
            medians = {"static_d_m2": result.static_d_m2_median, "residual_m": result.median_norm}
            return Noted(stage, {"coverage": result.valid_share, "flagged": result.flagged_share} | medians)
        case Motion():
            return Noted(stage, {"coverage": result.valid_share})
        case _:
            return Noted(stage)


@dataclass
class Summary:
    """Medians over pairs, in the units their names say. NaN and empty lists until a pair was seen."""

    noise_scale: float = 1.0  # of the run's settings
    pairs: int = 0
    unreliable_pairs: int = 0
    coverage: list[float] = field(default_factory=list)  # share of pixels scored
    flagged: list[float] = field(default_factory=list)  # share of scored pixels above tau_px
    static_d_m2: list[float] = field(default_factory=list)
    residual_m: list[float] = field(default_factory=list)  # median norm of a pair's residuals
    inlier_share: list[float] = field(default_factory=list)
    instances: list[int] = field(default_factory=list)  # segmented in a frame
    stage_ms: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    skipped: Counter[str] = field(default_factory=Counter)  # reason -> count
    end: RunEnd | None = None

    def write(self, result: Result, at: Moment) -> None:
        """Take what the closing table needs."""
        self.take(noted(result), at)

    @property
    def made(self) -> Make:
        """See protocols.Halved."""
        return noted

    def take(self, made: Noted, at: Moment) -> None:
        """See protocols.Halved."""
        if made.stage is not None:
            self.stage_ms[made.stage].append(at.elapsed_ms)
        self.pairs += made.stage == "motion"
        self.unreliable_pairs += made.unreliable
        self.skipped.update(made.skipped)
        for name, value in made.values.items():
            getattr(self, name).append(value)

    def close(self, end: RunEnd) -> None:
        """Keep how the run ended."""
        self.end = end

    def figures(self) -> dict[str, float | int]:
        """Medians over pairs, for a table or JSON; what no pair gave is left out."""
        medians: dict[str, Sequence[float]] = {
            "coverage": self.coverage,
            "flagged_share": self.flagged,
            "static_d_m2_median": self.static_d_m2,
            "residual_median_m": self.residual_m,
            "instances": self.instances,
            "ego_inlier_share": self.inlier_share,
            **{f"{stage}_ms": values for stage, values in self.stage_ms.items()},
        }
        counts = {"pairs": self.pairs, "unreliable_pairs": self.unreliable_pairs}
        known = {name: [x for x in values if x == x] for name, values in medians.items()}
        figures: dict[str, float | int] = {**counts, **{k: median(v) for k, v in known.items() if v}}
        if known["static_d_m2_median"]:
            static_d_m2 = figures["static_d_m2_median"]
            figures["calibrating_noise_scale"] = self.noise_scale * (static_d_m2 / CHI2_3_MEDIAN) ** 0.5
        return figures
