"""Each stage of a pair on one thread, against a plain form of it and against its limit.

    python -m benchmarks.stages

Real images where they are at hand, else the rendered room; medians of one run. Limits: copying the bytes that a stage
reads and writes, and what the library takes that does the work.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy

import cv2
import numpy as np

from benchmarks import naive
from benchmarks.data import SLICE, frames, room, textbook
from benchmarks.rows import Row, milliseconds, shown
from vlmm_log.heap import keep_pages
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
from vlmm_log.readers.images import decode_depth, decode_rgb
from vlmm_log.readers.stored import StoredImage
from vlmm_log.settings import Settings
from vlmm_log.sinks.many import watched_by
from vlmm_log.sinks.recorder import Recorder, open_recording
from vlmm_log.sinks.rerun import RerunFile
from vlmm_log.types import Ego, EncodedImage, FramePair, Run, RunEnd

PAIRS = 60  # that are logged


def some_frames(folder: Path, count: int) -> tuple[str, list]:
    """Frames of the real slice where it is at hand, else of the rendered room."""
    if SLICE.exists():
        return "real slice", frames(SLICE, most=count)
    return "rendered room", frames(room(folder, count))


def one_pair() -> tuple[str, FramePair]:
    """A pair three frames apart."""
    with tempfile.TemporaryDirectory() as folder:
        source, logged = some_frames(Path(folder), 19)
    return source, FramePair(logged[15], logged[18])


def copied(*arrays: np.ndarray) -> float:
    """Time to copy arrays, ms."""
    into = [np.empty_like(a) for a in arrays]
    return milliseconds(lambda: [np.copyto(b, a) for a, b in zip(arrays, into, strict=True)])


def motion_bytes(matches: Matches, ego: Ego) -> list[np.ndarray]:
    """The arrays that the fused kernel reads and writes."""
    motion = measure_motion(matches, ego)
    return [*matches.inputs[:7], motion.residual, motion.d_m, motion.p_stat, motion.validity]


def decoding(pair: FramePair) -> Iterator[Row]:
    """The images of a frame: what libpng and libjpeg take, and what is made of it."""
    rgb, depth = pair.first.encoded_rgb, pair.first.encoded_depth
    if not isinstance(rgb, EncodedImage) or not isinstance(depth, EncodedImage):
        return
    files = [np.frombuffer(e.data, np.uint8) for e in (rgb, depth)]
    library = milliseconds(lambda: [cv2.imdecode(data, cv2.IMREAD_UNCHANGED) for data in files])
    stored = [StoredImage(bytes(e.data)) for e in (rgb, depth)]
    units = depth.units_per_meter
    ours = milliseconds(lambda: (decode_rgb(stored[0]), decode_depth(stored[1], units, 0.1, 10.0)))
    yield Row("images of a frame decoded", ours, "ms", f"{ours / library:.2f} of the library's own decoding")


def of_a_pair(pair: FramePair, s: Settings) -> Iterator[Row]:
    """Flow, matches, ego-refinement, the motion channel."""
    dis, rng = Dis(s.flow), np.random.default_rng(0)
    flow = estimate_flow(pair, dis)
    matches, segments = match(pair, flow, s.gate, s.noise), load_segmenter(s.objects)[0](pair.first)
    yield from decoding(pair)

    library = milliseconds(lambda: dis(pair.first, pair.second))
    plain = milliseconds(lambda: naive.flow(pair), 3)
    yield Row("flow both ways, DIS fast", library, "ms", f"Farneback {plain / library:.0f} times it")

    out = np.empty_like(flow.fb_error)
    copy = copied(flow.forward, flow.backward, out)
    trip = milliseconds(lambda: flow_kernels.round_trip(flow.forward, flow.backward, out))
    yield Row("round trip of the flow", trip, "ms", f"{trip / copy:.1f} copies")

    yield Row("segments by geometry", milliseconds(lambda: load_segmenter(s.objects)[0](pair.first)), "ms")
    yield Row("noise of the matches", milliseconds(lambda: match(pair, flow, s.gate, s.noise)), "ms")

    ours = milliseconds(lambda: refine_ego(matches, segments, s.ego, rng))
    first, second, valid = naive.matches(pair)
    plain = milliseconds(lambda: naive.ego(first[valid], second[valid], rng), 1)
    yield Row("ego-refinement, row_linear", ours, "ms", f"at most 10 asked; plain RANSAC {plain / ours:.0f} times it")

    ego = refine_ego(matches, segments, s.ego, rng)
    arrays = [a.copy() for a in motion_bytes(matches, ego)]
    copy = copied(*arrays)
    rows = as_rows(row_transforms(ego.T_second_first, ego.row_twist, np.arange(len(out)), len(out)))
    turn, table = np.eye(3, dtype=np.float32), kernels.p_stat_table()
    fused = milliseconds(lambda: kernels.measure(matches.inputs, rows, turn, table, *arrays[-4:]))
    plain = milliseconds(lambda: textbook.motion(matches, ego), 3)
    size = sum(a.nbytes for a in arrays) / out.size
    told = (
        f"{fused / copy:.1f} copies of {size:.0f} bytes a pixel, at most 5 asked; in float64 {plain / fused:.0f} times"
    )
    yield Row("gate, residual, Sigma, d_M, p: fused kernel", fused, "ms", told)
    yield Row("motion channel, whole", milliseconds(lambda: measure_motion(matches, ego)), "ms")


class Timed:
    """A sink, and how long each pair was in it."""

    def __init__(self, sink: Recorder) -> None:
        self.sink, self.ms = sink, 0.0

    def write(self, result: object, at: Moment) -> None:
        """See protocols.Sink."""
        began = time.perf_counter()
        self.sink.write(result, at)  # type: ignore[arg-type]
        self.ms += 1e3 * (time.perf_counter() - began)


def lean_logging(logged: list, models: Models, s: Settings, folder: Path) -> Iterator[Row]:
    """Time in the lean Rerun sink, and what it writes beyond the source's own bytes; rewrites of the file included."""
    run = Run("bench", "bench", s.to_toml(), {}, True, "+z", ())
    recording = open_recording(folder / "bench.rrd", lambda path: RerunFile(path, run))
    sink = Recorder([recording], dense=False)
    spent, whole = [], []
    world = empty_world(s, has_poses=True)
    pairs = [FramePair(a, b) for a, b in zip(logged, logged[3:], strict=False)]
    for pair in pairs:
        timed = Timed(sink)
        began = time.perf_counter()
        observe = watched_by(timed, pair)  # type: ignore[arg-type]
        world = step(observe(pair), world, models, s, observe)
        whole.append(1e3 * (time.perf_counter() - began))
        spent.append(timed.ms)
    sink.close(RunEnd(True, "", len(logged), len(pairs)))
    mean, share = float(np.mean(spent[10:])), float(np.sum(spent[10:]) / np.sum(whole[10:]))
    yield Row("lean logging", mean, "ms", f"mean, at most 6 asked; {share:.0%} of a pair without decoding")
    source = sum(len(e.data) for p in pairs for e in (p.first.encoded_rgb, p.first.encoded_depth) if e is not None)
    written = (folder / "bench.rrd").stat().st_size
    beyond = (written - source) / len(pairs) / 1e6
    yield Row("lean recording beyond the source's bytes", beyond, "MB", "at most .6 asked")


def measured(short: bool = False) -> Iterator[Row]:
    """All stages."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    keep_pages()
    s = Settings()
    _, pair = one_pair()
    yield from of_a_pair(pair, s)
    with tempfile.TemporaryDirectory() as folder:
        _, logged = some_frames(Path(folder), 33 if short else PAIRS + 3)
        yield from lean_logging(logged, load_models(s)[0], s, Path(folder))
    cv2.setNumThreads(threads)


if __name__ == "__main__":
    list(shown("stages of a pair, one thread", measured()))
