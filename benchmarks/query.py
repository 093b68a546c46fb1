"""Speed of queries on a map of 100,000 elements with features 512 wide, one thread, medians.

python -m benchmarks.query
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy

import hashlib
from collections.abc import Sequence

import numpy as np

from benchmarks.rows import milliseconds
from vlmm_log.elements import Elements
from vlmm_log.pipeline.language.answer import answer
from vlmm_log.pipeline.language.parser import parse
from vlmm_log.queries import View
from vlmm_log.settings import Settings

N, D, LABELS = 100_000, 512, 1000
ASKED = (
    "chair 7",
    "the chair that opens",
    "things I could move",
    "furniture that is not moving",
    "the 10 fastest things between 10 s and 12 s",
    "chairs or tables that never moved",
    "how many things moved",
    "chairs left of the table",
    "things within 1 m of the door",
    "the things nearest to the door",
)


def text_features(texts: Sequence[str]) -> np.ndarray:
    """Unit vectors, a random one for each text."""
    seeds = [int.from_bytes(hashlib.sha256(t.encode()).digest()[:4], "big") for t in texts]
    rows = np.array([np.random.default_rng(seed).normal(size=D) for seed in seeds], np.float32)
    return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True))


def elements(rng: np.random.Generator) -> Elements:
    """A map in which a thousandth of the elements bears each label."""
    names = ["chair", "table", "door", "furniture", *(f"thing {i}" for i in range(LABELS - 4))]
    label = rng.integers(LABELS, size=N)
    moving = rng.random(N) < 0.1
    rows = np.flatnonzero(moving).astype(np.int32)
    begin = rng.integers(0, 60_000_000_000, rows.size)
    numbers = {name: rng.random(N).astype(np.float32) for name in ("o", "kappa", "confidence", "p_stat", "score")}
    return Elements(
        ids=np.arange(N),
        labels=tuple(names[i] for i in label),
        positions=rng.uniform(-50, 50, (N, 3)).astype(np.float32),
        extents=np.full((N, 6), 0.1, np.float32),
        features=text_features(names)[label],
        rho=rng.random(N),
        motion_class=np.where(moving, 2, rng.integers(2, size=N)).astype(np.uint8),
        speed=np.where(moving, rng.random(N), 0).astype(np.float32),
        p_moving=np.full(N, np.nan, np.float32),
        observations=rng.integers(1, 50, N).astype(np.int32),
        pixels=rng.integers(150, 9000, N).astype(np.int32),
        first_ns=np.zeros(N, np.int64),
        last_ns=np.full(N, 60_000_000_000, np.int64),
        interval_rows=rows,
        intervals=np.stack([begin, begin + 500_000_000], axis=1),
        rho_sources=("table",) * N,
        **numbers,
    )


def main() -> None:
    s, known = Settings(), elements(np.random.default_rng(0))
    print(f"{N} elements, {D} wide, one thread, medians (at most 50 ms)")
    for text in ASKED:
        query, view = parse(text), View(np.eye(4), "-y", 0)
        asked = (query, known, text_features, s.query, s.map, view, 0.5)
        found = answer(*asked).matches
        print(f"  {text:46s} {milliseconds(lambda asked=asked: answer(*asked)):7.1f} ms   {found} match")


if __name__ == "__main__":
    main()
