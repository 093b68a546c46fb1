"""The paper's tables, and ours beside them: scenes rendered anew, every way judged, one report.

    python -m benchmarks.reproduce OUT [--frames 60] [--seeds 11,12,13] [--jobs clean,noisy,...]

Writes OUT/report.html and OUT/report.json. Thresholds and noise terms were chosen on rendered scenes of seeds 1 to 3
and on the real recordings; the scenes judged here have seeds that nothing was chosen on. Calibrations are fitted on
seed 1.
Real recordings are judged where they are (see benchmarks.data); what is absent is named in the report.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

from benchmarks import paper_tables
from benchmarks.data import DATA, MOVING_PAIRS, NOMINAL, SLICE, WEIGHTS, frames
from vlmm_log.assessment import evaluate
from vlmm_log.evaluation.page import Table, page
from vlmm_log.evaluation.plans import Comparison
from vlmm_log.evaluation.report import report
from vlmm_log.evaluation.results import Evaluation
from vlmm_log.rendering import simulate
from vlmm_log.settings import Settings

SCENES = ("kitchen", "living_room", "bedroom")
TUNED_ON = 1
FRUIT = DATA / "fruit_on_table"
YOLO = WEIGHTS / "yolov8n-seg.onnx"
POSE_NOISE = (1.5, 3.0)  # degrees, cm
REAL_SENSOR = {"noise": "disparity", "readout_s": 0.02, "depth_offset_s": 0.01}


@dataclass(frozen=True)
class Bench:
    """Where things go, and what is rendered."""

    out: Path
    seeds: tuple[int, ...]
    frames: int

    def scenes(self, name: str, seeds: Iterable[int], **options: object) -> list[Path]:
        """Logs of all scenes at each seed; those that are there are taken as they are."""
        made = []
        for seed in seeds:
            for scene in SCENES:
                out = self.out / "scenes" / f"{name}_{seed}" / scene
                if not out.exists():
                    simulate(scene, out, frames=self.frames, seed=seed, **options)  # type: ignore[arg-type]
                made.append(out)
        return made

    def clean(self) -> list[Path]:
        """No noise."""
        return self.scenes("clean", self.seeds)

    def noisy(self) -> list[Path]:
        """The paper's Kinect-like noise, with flying pixels and holes."""
        return self.scenes("kinect", self.seeds, noise="kinect_quadratic")


def own_noise(fitted: Evaluation) -> Settings:
    """Default with the depth noise that a sensor's own static pixels showed."""
    assert fitted.sigma_z is not None, "three depths or more are seen"
    a, b = fitted.sigma_z
    return Settings.load(sets=[f"noise.sigma_z_a={a:.6f}", f"noise.sigma_z_b={b:.6f}"])


def clean(b: Bench) -> Evaluation:
    """Exact truth, true masks, no noise; the sensor's depth noise fitted on another seed."""
    fitted = evaluate(b.scenes("clean", [TUNED_ON]))
    return evaluate(
        b.clean(),
        settings=own_noise(fitted),
        compare=Comparison(baselines=True),
        title="Exact truth, clean depth, depth noise fitted on another seed",
    )


def clean_default(b: Bench) -> Evaluation:
    """The same under default's own noise model, which expects a Kinect."""
    compare = Comparison(baselines=True, profiles=True)
    return evaluate(b.clean(), compare=compare, title="Exact truth, clean depth, default settings")


def noisy(b: Bench) -> Evaluation:
    """Kinect-like noise: profiles, baselines, identities, poses off, calibration from another seed."""
    curves = b.out / "calibration.json"
    evaluate(b.scenes("kinect", [TUNED_ON], noise="kinect_quadratic"), calibrate=curves, force=True)
    return evaluate(
        b.noisy(),
        compare=Comparison(baselines=True, profiles=True, association=True, pose_noise=POSE_NOISE),
        calibration=curves,
        title="Kinect-like noise",
    )


def levers(b: Bench) -> Evaluation:
    """Kinect-like noise, one seed: each lever taken from default."""
    some = b.noisy()[: len(SCENES)]
    return evaluate(some, compare=Comparison(levers=True), title="Levers of default, Kinect-like noise, one seed")


def sweeps(b: Bench) -> Evaluation:
    """Kinect-like noise, one seed: thresholds, quantile, gap."""
    swept = (
        ("objects.quantile", ("0.5", "0.6", "0.75", "0.9", "0.95", "1.0")),
        ("map.tau_o", ("0.8", "1.1", "1.35", "1.7", "2.2")),
        ("map.kappa_o", ("0.05", "0.15", "0.3", "0.45")),
        ("map.rho_tau", ("0.3", "0.4", "0.55", "0.7", "0.9")),
        ("map.interval_pairs", ("3", "5", "7", "9")),
    )
    some = b.noisy()[: len(SCENES)]
    return evaluate(
        some, compare=Comparison(sweeps=swept), title="Thresholds and quantile, Kinect-like noise, one seed"
    )


def gaps(b: Bench) -> list[Evaluation]:
    """Kinect-like noise, one seed, other gaps: each has its own truth."""
    some = b.noisy()[: len(SCENES)]
    return [
        evaluate(some, settings=Settings.load(sets=[f"keyframes.gap={gap}"]), title=f"Kinect-like noise, gap {gap}")
        for gap in (1, 2, 6, 9)
    ]


def real_sensor(b: Bench) -> Evaluation:
    """Quantised disparity, rolling shutter, colour-depth time offset, poses off."""
    logs = b.scenes("sensor", b.seeds[:1], **REAL_SENSOR, pose_noise=(0.5, 1.0))
    return evaluate(
        logs,
        compare=Comparison(profiles=True, levers=True),
        title="Quantised disparity, rolling shutter, time offset, poses off by .5 deg and 1 cm; one seed",
    )


def real_slice(_: Bench) -> Evaluation | None:
    """fr1_rpy, the paper's person proxy."""
    if not (SLICE.exists() and YOLO.exists()):
        return None
    s = Settings.load(options={"objects.segmenter": f"yolo:{YOLO}"})
    compare = Comparison(profiles=True, pose_noise=POSE_NOISE)
    return evaluate([SLICE], truth="person", settings=s, compare=compare, title="TUM fr1_rpy slice, person proxy")


def real_pairs(b: Bench) -> Evaluation | None:
    """Six two-frame scenes against RAFT's own d_M."""
    if not (MOVING_PAIRS.exists() and any(WEIGHTS.glob("raft*.pth"))):
        return None
    from benchmarks.raft_truth import write

    logs = sorted(MOVING_PAIRS.iterdir())
    write(b.out / "raft_truth", logs, 1, NOMINAL)
    s = Settings.load(sets=["keyframes.gap=1"], options={"read.intrinsics": NOMINAL})
    compare = Comparison(profiles=True, levers=True)
    return evaluate(
        logs, truth=b.out / "raft_truth", settings=s, compare=compare, title="moving_pairs, DIS against RAFT's d_M"
    )


def real_fruit(b: Bench) -> Evaluation | None:
    """A fixed camera against depth differences."""
    if not FRUIT.exists():
        return None
    from benchmarks.difference_truth import write

    write(frames(FRUIT), b.out / "fruit_truth", 1)
    return evaluate(
        [FRUIT],
        truth=b.out / "fruit_truth",
        settings=Settings.load(sets=["keyframes.gap=1"]),
        compare=Comparison(profiles=True, baselines=True),
        title="fruit_on_table, fixed camera, truth from depth differences",
    )


JOBS: Mapping[str, Callable[[Bench], Evaluation | list[Evaluation] | None]] = {
    "clean": clean,
    "clean_default": clean_default,
    "noisy": noisy,
    "levers": levers,
    "sweeps": sweeps,
    "gaps": gaps,
    "real_sensor": real_sensor,
    "real_slice": real_slice,
    "real_pairs": real_pairs,
    "real_fruit": real_fruit,
}


def rendered(b: Bench, names: Iterable[str]) -> None:
    """Render what the jobs share, before any of them starts."""
    if {"clean", "clean_default"} & {*names}:
        b.clean()
    if {"noisy", "levers", "sweeps", "gaps"} & {*names}:
        b.noisy()


def judged(b: Bench, name: str) -> tuple[list[Evaluation], float]:
    """One job, and its seconds; no evaluation where something is absent."""
    began = time.monotonic()
    found = JOBS[name](b)
    return ([] if found is None else found if isinstance(found, list) else [found]), time.monotonic() - began


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--seeds", default="11,12,13", help="of the scenes that are judged; not 1 to 3")
    parser.add_argument("--workers", type=int, default=2, help="jobs at once")
    parser.add_argument("--jobs", default=",".join(JOBS), help="some of: " + ", ".join(JOBS))
    arguments = parser.parse_args()
    b = Bench(arguments.out, tuple(int(x) for x in arguments.seeds.split(",")), arguments.frames)
    names = arguments.jobs.split(",")
    rendered(b, names)
    done: dict[str, list[Evaluation]] = {}
    with ProcessPoolExecutor(arguments.workers, mp_context=get_context("spawn")) as pool:
        for name, (found, seconds) in zip(names, pool.map(judged, [b] * len(names), names), strict=True):
            if found:
                done[name] = found
            told = "done" if found else "skipped, its recording or weights are not here"
            print(f"{name}: {told}, {seconds:.0f} s", flush=True)
    write(b.out, done, [name for name in names if name not in done])


def write(out: Path, done: Mapping[str, list[Evaluation]], absent: list[str]) -> None:
    """The report, as a page and as JSON."""
    tables: list[Table] = [*paper_tables.tables(done), paper_tables.routing()]
    if absent:
        tables.append(
            Table("Not judged", ["job"], [[name] for name in absent], "Its recording or weights were not there.")
        )
    everything = [e for found in done.values() for e in found]
    out.mkdir(parents=True, exist_ok=True)
    (out / "report.html").write_text(page("vlmm-log: evidence", everything, tables), "utf-8")
    plain = {
        "tables": [{"title": t.title, "head": list(t.head), "rows": [list(r) for r in t.rows]} for t in tables],
        "evaluations": {name: [report(e) for e in found] for name, found in done.items()},
    }
    (out / "report.json").write_text(json.dumps(plain, indent=1) + "\n", "utf-8")
    for t in tables:
        print(f"\n{t.title}")
        for row in [list(t.head), *t.rows]:
            print("  " + f"{row[0]:44s}" + "".join(f"{cell:>16s}" for cell in row[1:]))
    print(f"\nwrote {out / 'report.html'} and {out / 'report.json'}")


if __name__ == "__main__":
    sys.exit(main())
