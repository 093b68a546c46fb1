"""A small map whose every answer is known, seen by a camera that looks along the world's +x, z up.

          x = 2 (near row)                x = 4 (far row)
y = +1    chair 1 (office, moved 1-2 s)   door 5 (moving, 3-4 s and 6-7 s)
y =  0    table 2, mug 3 on top of it     monitor 6
y = -1    person 4 (moving, 0.5-9.5 s)    chair 7 (x = 3.8, never moved)
wall 8 at x = 6; element 9 has no label and no feature; chair 10 at y = +3, x = 4, has NaN in place of values
"""

from __future__ import annotations

import numpy as np

from vlmm_log.elements import Elements, MotionClass
from vlmm_log.queries import View

S = 1_000_000_000
ORIGIN_NS = 1_305_031_102 * S
WORDS = ("chair", "office", "table", "mug", "person", "door", "monitor", "wall", "furniture", "coffee")
STATIC, MOVABLE, MOVING = MotionClass.STATIC, MotionClass.MOVABLE_STATIC, MotionClass.MOVING
THETA = 0.45
NAN = float("nan")

#   id, label, position, size m, rho, class, o, kappa, score, speed, observations, moved s
ROWS = [
    (1, "office chair", (2, 1, 0.5), 0.8, 0.8, MOVABLE, 1.2, 0.2, 1.6, 0.2, 12, [(1, 2)]),
    (2, "table", (2, 0, 0.4), 1.5, 0.6, MOVABLE, 0.9, 0.1, 0.9, 0.0, 30, []),
    (3, "mug", (2, 0.2, 0.9), 0.1, 0.95, MOVABLE, 1.0, 0.1, 1.0, 0.0, 4, []),
    (4, "person", (2, -1, 0.4), 1.8, 1.0, MOVING, 6.0, 0.9, 6.0, 1.1, 28, [(0.5, 9.5)]),
    (5, "door", (4, 1, 1.0), 2.2, 0.4, MOVING, 3.1, 0.62, 3.0, 0.6, 20, [(3, 4), (6, 7)]),
    (6, "monitor", (4, 0, 1.0), 0.6, 0.56, MOVABLE, 0.8, 0.1, 0.8, 0.0, 25, []),
    (7, "chair", (3.8, -1, 0.5), 0.9, 0.8, MOVABLE, 0.9, 0.1, 0.9, 0.0, 9, []),
    (8, "wall", (6, 0, 1.5), 5.0, 0.02, STATIC, 1.0, 0.05, 1.0, 0.0, 30, []),
    (9, "", (6, 5, 3.0), 0.2, 0.3, STATIC, 1.0, 0.05, 1.0, 0.0, 2, []),
    (10, "chair", (4, 3, 0.5), NAN, NAN, STATIC, NAN, NAN, NAN, NAN, 3, []),
]


def embed(texts):
    """(m, D) unit vectors with a 1 for each known word: texts are alike as they share words."""
    rows = np.array([[word in text.split() for word in WORDS] for text in texts], np.float32).reshape(-1, len(WORDS))
    return rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1)


def known_map(rows=ROWS):
    ids, labels, positions, sizes, rho, classes, o, kappa, score, speed, observations, moved = zip(*rows, strict=True)
    spans = [(row, a, b) for row, own in enumerate(moved) for a, b in own]
    n = len(rows)
    variance = np.array(sizes, np.float32) ** 2 / 12 / 3
    confidence = [
        {STATIC: 1 - p, MOVABLE: p, MOVING: k}[MotionClass(c)] for p, k, c in zip(rho, kappa, classes, strict=True)
    ]
    return Elements(
        ids=np.array(ids, np.int64),
        labels=labels,
        positions=np.array(positions, np.float32),
        extents=np.stack([variance, 0 * variance, 0 * variance, variance, 0 * variance, variance], axis=1),
        features=embed(labels),
        o=np.array(o, np.float32),
        kappa=np.array(kappa, np.float32),
        rho=np.array(rho, np.float64),
        motion_class=np.array(classes, np.uint8),
        confidence=np.array(confidence, np.float32),
        p_stat=np.full(n, 0.5, np.float32),
        score=np.array(score, np.float32),
        speed=np.array(speed, np.float32),
        p_moving=np.full(n, NAN, np.float32),
        observations=np.array(observations, np.int32),
        pixels=np.full(n, 500, np.int32),
        first_ns=np.array([ORIGIN_NS + (5 * S if i == 3 else 0) for i in ids], np.int64),
        last_ns=np.array([ORIGIN_NS + (10 * S if i != 7 else 4 * S) for i in ids], np.int64),
        interval_rows=np.array([row for row, _, _ in spans], np.int32),
        intervals=np.array([(ORIGIN_NS + round(a * S), ORIGIN_NS + round(b * S)) for _, a, b in spans]).reshape(-1, 2),
        rho_sources=("table: AI2-THOR",) * n,
    )


def view():
    """The camera stands at the origin at 1 m height: its z is the world's x, its x the world's -y."""
    T = np.eye(4)
    T[:3, :3] = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], float)
    T[:3, 3] = [0, 0, 1]
    return View(T, "+z", ORIGIN_NS)
