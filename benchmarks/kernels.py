"""Speed of the geometric stages, as ratios: against the textbook form in float64, and against copying the same bytes.

    python -m benchmarks.kernels

Real images where they are at hand, else the rendered room. One thread; medians of one run.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy

import cv2
import numpy as np

from benchmarks.data import SLICE, frames
from vlmm_log.models.dis import Dis
from vlmm_log.models.load import load_models
from vlmm_log.models.segmenters import load_segmenter
from vlmm_log.pipeline import flow_kernels, kernels
from vlmm_log.pipeline.ego import as_rows, refine_ego, row_transforms
from vlmm_log.pipeline.flow import estimate_flow
from vlmm_log.pipeline.matches import Matches, match
from vlmm_log.pipeline.motion import measure_motion
from vlmm_log.pipeline.run import empty_world, step
from vlmm_log.protocols import Models, Moment
from vlmm_log.settings import Settings
from vlmm_log.sinks.many import watched_by
from vlmm_log.types import Ego, FramePair

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "examples")]
import render_room  # noqa: E402
import textbook  # noqa: E402


def milliseconds(work: Callable[[], object], repeats: int = 15) -> float:
    """Median time of a call, after one that warms up."""
    work()
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        work()
        times.append(1e3 * (time.perf_counter() - began))
    return float(np.median(times))


def copied_bytes(matches: Matches, ego: Ego) -> list[np.ndarray]:
    """The arrays that the fused kernel reads and writes."""
    motion = measure_motion(matches, ego)
    return [*matches.inputs[:7], motion.residual, motion.d_m, motion.p_stat, motion.validity]


def logging_share(pair: FramePair, models: Models, s: Settings) -> tuple[float, float]:
    """Time in the lean Rerun sink and in the whole pair without decoding, ms."""
    from vlmm_log.sinks.recorder import Recorder, open_recording
    from vlmm_log.sinks.rerun import RerunFile
    from vlmm_log.types import Run, RunEnd

    class Timed:
        def __init__(self, sink: Recorder) -> None:
            self.sink, self.ms = sink, 0.0

        def write(self, result: object, at: Moment) -> None:
            began = time.perf_counter()
            self.sink.write(result, at)  # type: ignore[arg-type]
            self.ms += 1e3 * (time.perf_counter() - began)

    with tempfile.TemporaryDirectory() as folder:
        run = Run("bench", "bench", s.to_toml(), {}, True, "+z", ())
        recording = open_recording(Path(folder) / "bench.rrd", lambda path: RerunFile(path, run))
        sink = Recorder([recording], dense=False)
        shares, whole = [], []
        world = empty_world(s, has_poses=True)
        for _ in range(20):
            timed = Timed(sink)
            began = time.perf_counter()
            observe = watched_by(timed, pair)  # type: ignore[arg-type]
            world = step(observe(pair), world, models, s, observe)
            whole.append(1e3 * (time.perf_counter() - began))
            shares.append(timed.ms)
        sink.close(RunEnd(True, "", 2, 20))
    return float(np.median(shares)), float(np.median(whole))


def one_pair() -> tuple[str, FramePair]:
    """A pair three frames apart, of the real slice where it is at hand, else of the rendered room."""
    if SLICE.exists():
        logged = frames(SLICE)[15:19]
        return "real slice", FramePair(logged[0], logged[3])
    with tempfile.TemporaryDirectory() as folder:
        render_room.write_tum(Path(folder), 4)
        logged = frames(Path(folder))
    return "rendered room", FramePair(logged[0], logged[3])


def main() -> None:
    cv2.setNumThreads(1)
    s = Settings()
    source, pair = one_pair()
    dis = Dis(s.flow)
    flow = estimate_flow(pair, dis)
    matches = match(pair, flow, s.gate, s.noise)
    rng, segments = np.random.default_rng(0), load_segmenter(s.objects)[0](pair.first)

    def refined() -> Ego:
        return refine_ego(matches, segments, s.ego, rng)

    ego = refined()
    arrays = [a.copy() for a in copied_bytes(matches, ego)]
    into = [np.empty_like(a) for a in arrays]
    size = sum(a.nbytes for a in arrays) / pair.first.depth.size

    H = pair.first.depth.shape[0]
    copy = milliseconds(lambda: [np.copyto(b, a) for a, b in zip(arrays, into, strict=True)])
    rows_ = as_rows(row_transforms(ego.T_second_first, ego.row_twist, np.arange(H), H))
    turn, table, out = np.eye(3, dtype=np.float32), kernels.p_stat_table(), into[-4:]
    measured = (matches.inputs, rows_, turn, table, *out)
    fused = milliseconds(lambda: kernels.measure(*measured))
    naive = milliseconds(lambda: textbook.motion(matches, ego), repeats=3)
    rows = [
        ("flow both ways, DIS fast", milliseconds(lambda: dis(pair.first, pair.second)), ""),
        (
            "round trip of the flow",
            milliseconds(lambda: flow_kernels.round_trip(flow.forward, flow.backward, into[5])),
            "",
        ),
        ("noise of the matches", milliseconds(lambda: match(pair, flow, s.gate, s.noise)), ""),
        (
            "ego-refinement, row_linear",
            milliseconds(lambda: refine_ego(matches, segments, s.ego, rng)),
            "at most 20 ms",
        ),
        ("copy of the same bytes", copy, f"{size:.0f} bytes a pixel"),
        ("motion channel, whole", milliseconds(lambda: measure_motion(matches, ego)), ""),
        (
            "motion channel, fused kernel",
            fused,
            f"{fused / copy:.1f} copies (at most 6)",
        ),
        ("textbook: einsum, inverse, chi2.sf", naive, f"{naive / fused:.0f} times the fused one (at least 100)"),
    ]
    share, whole = logging_share(pair, load_models(s)[0], s)
    rows.append(("lean logging", share, f"{share / whole:.0%} of the pair's {whole:.0f} ms (at most 25 %)"))
    print(f"{source}, {pair.first.depth.shape[1]}x{pair.first.depth.shape[0]}, one thread, medians")
    for name, ms, note in rows:
        print(f"  {name:34s} {ms:9.2f} ms   {note}")


if __name__ == "__main__":
    main()
