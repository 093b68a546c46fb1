"""The motion channel on real recordings, over every pair: coverage, calibration, false flags.

    python -m benchmarks.real_check [--no-raft] [--json F]

Two tables. The TUM slice (a hand-held camera; one seated person turns the head: nearly everything is still) at
gaps 1, 3 and 6; `moving_pairs` (camera about still, large movers), DIS scored against RAFT's own d_M: above 4
moving, below 2.8 static, the rest ignored - a pseudo-truth, so a direction and not a result.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.data import MOVING_PAIRS, NOMINAL, SLICE, WEIGHTS, frames, need
from vlmm_log import se3
from vlmm_log.models.dis import Dis
from vlmm_log.models.segmenters import load_segmenter
from vlmm_log.pipeline.ego import refine_ego
from vlmm_log.pipeline.flow import estimate_flow
from vlmm_log.pipeline.matches import match
from vlmm_log.pipeline.motion import measure_motion
from vlmm_log.pipeline.run import randomness
from vlmm_log.protocols import FlowEstimator
from vlmm_log.settings import FlowSettings, Settings
from vlmm_log.types import Ego, FlowField, Frame, FramePair, Motion

VARIANTS = {
    "paper, rigid": Settings.load("paper"),
    "paper, row_linear": Settings.load("paper", sets=["ego.model=row_linear"]),
    "default, rigid": Settings.load(sets=["ego.model=rigid"]),
    "default, row_linear": Settings.load(),
}
SEGMENT, _ = load_segmenter(Settings().objects)
MOVING, STATIC = 4.0, 2.8  # RAFT's d_M above, below


class Figures(NamedTuple):
    """One pair, one variant."""

    coverage: float  # share of pixels scored
    static_d_m2: float  # median
    flagged: float  # share of scored pixels
    residual_m: float  # median
    inliers: float  # share of matches


def estimators(*, raft: bool) -> dict[str, FlowEstimator]:
    """DIS fast, and RAFT at half size where its weights are."""
    found: dict[str, FlowEstimator] = {"DIS fast": Dis(FlowSettings())}
    if raft:
        from vlmm_log.models.raft import Raft

        found["RAFT half"] = Raft(FlowSettings(estimator="raft", weights=str(WEIGHTS)))
    return found


def measured(pair: FramePair, flow: FlowField, s: Settings) -> tuple[Ego, Motion]:
    """The channel of one pair on a flow that is already there."""
    matches = match(pair, flow, s.gate, s.noise)
    ego = refine_ego(matches, SEGMENT(pair.first), s.ego, randomness(s.seed, pair))
    return ego, measure_motion(matches, ego)


def slice_table(logged: list[Frame], flows: dict[str, FlowEstimator]) -> list[dict[str, object]]:
    """One row for each gap, flow and variant: medians over all pairs."""
    rows: list[dict[str, object]] = []
    header = (
        f"{'gap':>3} {'flow':10} {'variant':20} {'pairs':>5} {'coverage':>8} {'d_M^2':>6} {'flagged':>8} {'p90':>7}"
    )
    print(header + f" {'|m| cm':>7} {'inliers':>7}")
    for gap in (1, 3, 6):
        for name, estimator in flows.items():
            results: dict[str, list[Figures]] = {variant: [] for variant in VARIANTS}
            for a, b in zip(logged, logged[gap:], strict=False):
                pair = FramePair(a, b)
                flow = estimate_flow(pair, estimator)
                for variant, s in VARIANTS.items():
                    results[variant].append(figures(*measured(pair, flow, s)))
            for variant, seen in results.items():
                row = medians(seen)
                rows.append({"gap": gap, "flow": name, "variant": variant, "pairs": len(seen), **row})
                print(
                    f"{gap:3d} {name:10} {variant:20} {len(seen):5d} {row['coverage']:8.1%} {row['static_d_m2']:6.2f} "
                    f"{row['flagged']:8.2%} {row['flagged_p90']:7.1%} {100 * row['residual_m']:7.2f} "
                    f"{row['inliers']:7.1%}",
                    flush=True,
                )
    return rows


def figures(ego: Ego, motion: Motion) -> Figures:
    """What is kept of a pair."""
    return Figures(
        motion.valid_share, motion.static_d_m2_median, motion.flagged_share, motion.median_norm, ego.inlier_share
    )


def medians(seen: list[Figures]) -> dict[str, float]:
    """Over pairs; flagged also as its 90th percentile."""
    middle = dict(zip(Figures._fields, np.nanmedian(np.array(seen), axis=0).tolist(), strict=True))
    return {**middle, "flagged_p90": float(np.quantile([f.flagged for f in seen], 0.9))}


def pose_table(logged: list[Frame]) -> dict[str, float]:
    """How much d_M changes when the poses are wrong or absent, and the residual with and without ego-refinement."""
    s, off = Settings(), Settings.load(sets=["ego.model=off"])
    wrong = se3.exp(np.array([*np.deg2rad([0.9, -0.9, 0.8]), 0.02, 0.02, -0.01]))  # 1.5 degrees, 3 cm
    seen: dict[str, list[float]] = {}
    for a, b in zip(logged, logged[3:], strict=False):
        pair = FramePair(a, b)
        flow = estimate_flow(pair, Dis(FlowSettings()))
        true = measured(pair, flow, s)[1]
        assert a.T_world_cam is not None
        others = {"perturbed by 1.5 deg, 3 cm": a.T_world_cam @ wrong, "no poses": None}
        for name, T in others.items():
            other = measured(FramePair(replace(a, T_world_cam=T), b), flow, s)[1]
            change = np.abs(other.d_m - true.d_m) / true.d_m
            seen.setdefault(f"d_M changes, {name}", []).append(float(np.nanmedian(change)))
        seen.setdefault("residual m, ground truth alone", []).append(measured(pair, flow, off)[1].median_norm)
        seen.setdefault("residual m, refined", []).append(true.median_norm)
    rows = {name: float(np.median(values)) for name, values in seen.items()}
    print(f"\nslice, gap 3, DIS fast, default{'':24} median over pairs")
    for name, value in rows.items():
        print(f"{name:54} {value:8.4f}   worst pair {max(seen[name]):.4f}")
    return rows


def moving_table(flows: dict[str, FlowEstimator]) -> list[dict[str, object]]:
    """DIS against RAFT's mask, scene by scene, with the default settings. A gated pixel of DIS counts as unflagged."""
    s = Settings()
    shares: dict[str, list[float]] = {}
    print(f"\n{'moving_pairs, default':24} {'moving':>7} {'static flagged':>14} {'recall':>7}")
    for folder in sorted(MOVING_PAIRS.iterdir()):
        pair = FramePair(*frames(folder, NOMINAL))
        d_m = {name: measured(pair, estimate_flow(pair, f), s)[1] for name, f in flows.items()}
        truth = np.nan_to_num(d_m["RAFT half"].d_m, nan=-1.0)
        moving, static = truth > MOVING, (truth >= 0) & (truth < STATIC)
        flagged = np.nan_to_num(d_m["DIS fast"].d_m) > d_m["DIS fast"].tau_px
        shares[folder.name] = [float(x) for x in (moving.mean(), flagged[static].mean(), flagged[moving].mean())]
    shares["mean over scenes"] = np.mean(list(shares.values()), axis=0).tolist()
    for name, row in shares.items():
        print("{:24} {:7.1%} {:14.1%} {:7.1%}".format(name, *row))
    return [dict(zip(("moving", "static_flagged", "recall"), r, strict=True), scene=n) for n, r in shares.items()]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--no-raft", action="store_true", help="DIS only: a minute instead of eight")
    parser.add_argument("--json", type=Path, help="also write the rows here")
    arguments = parser.parse_args()
    need(SLICE)
    flows = estimators(raft=not arguments.no_raft)
    rows: dict[str, object] = {"slice": slice_table(frames(SLICE), flows)}
    rows["poses"] = pose_table(frames(SLICE))
    if not arguments.no_raft and MOVING_PAIRS.exists():
        rows["moving_pairs"] = moving_table(flows)
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=2) + "\n")


if __name__ == "__main__":
    main()
