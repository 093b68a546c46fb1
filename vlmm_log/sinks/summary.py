"""The figures of a run, gathered while it goes."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from statistics import median

from vlmm_log.protocols import Moment, Result
from vlmm_log.sinks.stages import stage_of
from vlmm_log.types import CHI2_3_MEDIAN, Ego, Motion, RunEnd, Segments, Skipped


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
        stage = stage_of(result)
        if stage is not None:
            self.stage_ms[stage].append(at.elapsed_ms)
        match result:
            case Skipped():
                self.skipped[result.reason] += 1
            case Segments():
                self.instances.append(len(result))
                self.skipped.update(result.notes)
            case Ego():
                self.unreliable_pairs += not result.reliable
                self.inlier_share.append(result.inlier_share)
            case Motion():
                self.pairs += 1
                self.coverage.append(result.valid_share)
                if result.valid_share:
                    self.flagged.append(result.flagged_share)
                    self.static_d_m2.append(result.static_d_m2_median)
                    self.residual_m.append(result.median_norm)
            case _:
                pass

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
            "ego_inlier_share": [x for x in self.inlier_share if x == x],
            **{f"{stage}_ms": values for stage, values in self.stage_ms.items()},
        }
        counts = {"pairs": self.pairs, "unreliable_pairs": self.unreliable_pairs}
        figures: dict[str, float | int] = {**counts, **{k: median(v) for k, v in medians.items() if v}}
        if self.static_d_m2:
            figures["calibrating_noise_scale"] = self.noise_scale * (median(self.static_d_m2) / CHI2_3_MEDIAN) ** 0.5
        return figures
