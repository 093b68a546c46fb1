"""Maps with known content, and hypothesis strategies for any map a file must hold."""

from __future__ import annotations

import dataclasses

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from vlmm_log.background import Background, empty_background
from vlmm_log.elements import (
    OBSERVATION,
    Element,
    Evidence,
    MotionClass,
    Movability,
    WorldMap,
)
from vlmm_log.maps import SavedMap
from vlmm_log.maps.saved import WORLD_UP
from vlmm_log.types import Run, RunEnd

ORIGIN_NS = 1_305_031_227_000_000_000
STEP_NS = 100_000_000

# ---- builders: every figure can be given, the others are plain and agree with each other


ROUND = (0.01, 0, 0, 0.01, 0, 0.01)  # m^2, a ball of 10 cm standard deviation


def observations(count=3, *, start_ns=ORIGIN_NS, position=(0.0, 0.0, 1.0), extent=ROUND, **columns):
    """(count,) rows, one every STEP_NS; ``columns`` are values or arrays by name."""
    rows = np.zeros(count, OBSERVATION)
    rows["first_ns"] = start_ns + STEP_NS * np.arange(count)
    rows["second_ns"] = rows["first_ns"] + STEP_NS
    rows["index"] = np.arange(count)
    plain = {"pixels": 400, "scored": 300, "o": 2.027, "phi": 0.05, "gamma": 0.5, "kappa": 0.025, "gamma_all": 0.1}
    for name, value in (plain | {"position": position, "extent": extent} | columns).items():
        rows[name] = value
    return rows


def evidence(id_, label="mug", *, feature=(1.0, 0.0), seen=None, pixels=400, **columns):
    """What was seen of an element with one label."""
    seen = observations(**columns) if seen is None else seen
    return Evidence(id_, {label: 900 * max(len(seen), 1)}, seen, np.array(feature, np.float32), pixels, 0)


def element(
    id_,
    label="mug",
    *,
    position=(0.0, 0.0, 1.0),
    extent=ROUND,
    motion_class=MotionClass.STATIC,
    o=1.0,
    kappa=0.025,
    movability=None,
    p_stat=0.25,
    score=None,
    speed=0.0,
    intervals=(),
    feature=(1.0, 0.0),
    seen=None,
    pixels=400,
):
    """An element by its fused figures. Confidence follows the paper's rule; the observations stand at ``position``."""
    movability = movability or Movability(0.1, "table: AI2-THOR")
    rho = movability.rho
    seen = observations(position=position, extent=extent) if seen is None else seen
    return Element(
        evidence=evidence(id_, label, feature=feature, seen=seen, pixels=pixels),
        label=label,
        position=np.array(position, np.float32),
        extent=np.array(extent, np.float32),
        o=o,
        kappa=kappa,
        rho=rho,
        rho_source=movability.source,
        motion_class=motion_class,
        confidence={MotionClass.MOVING: kappa, MotionClass.MOVABLE_STATIC: rho}.get(motion_class, 1 - rho),
        p_stat=p_stat,
        score=o if score is None else score,
        speed=speed,
        intervals=np.array(intervals, np.int64).reshape(-1, 2),
    )


def background(points, colors=(128, 128, 128), voxel_m=0.05):
    """Voxels of points (n, 3) m, world, all of one colour."""
    cells = np.floor(np.asarray(points, float).reshape(-1, 3) / voxel_m).astype(np.int32)
    cells, counts = np.unique(cells, axis=0, return_counts=True)
    sums = counts[:, None] * np.array([1, *colors])
    return Background(voxel_m, cells, sums.astype(np.int64))


def world(elements=(), pending=(), voxels=None):
    """A map of elements, of evidence too small to be one, and of a background."""
    elements = {e.id: e for e in elements}
    seen = {e.id: e.evidence for e in elements.values()} | {e.id: e for e in pending}
    return WorldMap(seen, elements, (empty_background(0.05) if voxels is None else voxels,))


def saved(world_map=None, *, world_up="+z", T_world_cam=None, source="kitchen"):
    """A map with what a file says of its run."""
    run = Run(source, "tum", 'profile = "default"\n', {"vlmm-log": "0.1", "numpy": "2"}, True, world_up, ("a note",))
    end = RunEnd(True, "ab" * 32, 12, 9)
    return SavedMap(world() if world_map is None else world_map, run, end, ORIGIN_NS, T_world_cam)


def kitchen():
    """A small map with one of each: a mug that stands, a door that opened, a chair, a thing too small to be one."""
    span = [(ORIGIN_NS, ORIGIN_NS + 2 * STEP_NS)]
    moved = observations(5, o=[9.5, 8.25, 7.1, 1.5, 2.0], kappa=0.7, drift=(0.02, 0.0, 0.01), position=(2, 0, 1))
    can_move = {"motion_class": MotionClass.MOVABLE_STATIC, "movability": Movability(0.9, "table: AI2-THOR")}
    moves = {"motion_class": MotionClass.MOVING, "o": 3.5, "kappa": 0.7, "speed": 0.2, "intervals": span, "seen": moved}
    elements = [
        element(4, "mug", position=(0.3, 0.1, 0.8), **can_move),
        element(7, "door", position=(2, 0, 1), **moves),
        element(9, "Stühlchen 椅子 \U0001fa91 \"'\\\n\0", position=(1, 1, 0.5), feature=(0.6, 0.8)),
    ]
    voxels = background(np.random.default_rng(0).uniform(-1, 1, (40, 3)), (200, 30, 4))
    small = evidence(2**62, "key", seen=observations(1, pixels=40), pixels=40)
    return saved(world(elements, [small], voxels), T_world_cam=np.linalg.qr(np.arange(16).reshape(4, 4) ** 0.5)[0])


# ---- strategies

texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=8)
ids = st.integers(0, 2**63 - 1)
stamps = st.integers(-(2**63), 2**63 - 1)
counts = st.integers(0, 2**31 - 1)
figures = st.floats(-3.4e38, 3.4e38)
singles = st.floats(width=32, allow_nan=False, allow_infinity=False)


def vectors(*shape):
    return hnp.arrays(np.float32, shape, elements=singles)


@st.composite
def observation_rows(draw, min_size=0):
    rows = np.zeros(draw(st.integers(min_size, 4)), OBSERVATION)
    for name in OBSERVATION.names:
        kind = OBSERVATION[name]
        elements = singles if kind.base.kind == "f" else hnp.from_dtype(kind.base)
        rows[name] = draw(hnp.arrays(kind.base, (len(rows), *kind.shape), elements=elements))
    return rows[np.argsort(rows["first_ns"], kind="stable")]


@st.composite
def evidences(draw, id_, width, min_size=0):
    votes = draw(st.dictionaries(texts, ids, min_size=1, max_size=3))
    return Evidence(id_, votes, draw(observation_rows(min_size)), draw(vectors(width)), draw(counts), draw(counts))


@st.composite
def fused(draw, id_, width):
    spans = hnp.arrays(np.int64, st.tuples(st.integers(0, 2), st.just(2)), elements=stamps)
    numbers = {n: draw(figures) for n in ("o", "kappa", "rho", "confidence", "p_stat", "score", "speed")}
    return Element(
        evidence=draw(evidences(id_, width, min_size=1)),
        label=draw(texts),
        position=draw(vectors(3)),
        extent=draw(vectors(6)),
        rho_source=draw(texts),
        motion_class=draw(st.sampled_from(MotionClass)),
        intervals=draw(spans),
        p_moving=draw(st.just(float("nan")) | st.floats(0, 1)),
        **numbers,
    )


@st.composite
def backgrounds(draw):
    cell = st.tuples(*[st.integers(-(2**31), 2**31 - 1)] * 3)
    cells = sorted(draw(st.sets(cell, max_size=4)))
    counts = [draw(st.integers(1, 2**40)) for _ in cells]
    sums = [[n, *(draw(st.integers(0, 255 * n)) for _ in range(3))] for n in counts]
    voxel_m = draw(st.floats(1e-3, 1e3))
    return Background(voxel_m, np.array(cells, np.int32).reshape(-1, 3), np.array(sums, np.int64).reshape(-1, 4))


@st.composite
def saved_maps(draw):
    """Any map a file must hold: any finite figure, any Unicode text, any 64-bit id."""
    width = draw(st.integers(0, 3))
    which = draw(st.lists(ids, unique=True, max_size=4))
    cut = draw(st.integers(0, len(which)))
    elements = [draw(fused(i, width)) for i in which[:cut]]
    pending = [draw(evidences(i, width)) for i in which[cut:]]
    run = Run(
        draw(texts),
        draw(texts),
        draw(texts),
        draw(st.dictionaries(texts, texts, max_size=2)),
        draw(st.booleans()),
        draw(st.sampled_from(WORLD_UP)),
        tuple(draw(st.lists(texts, max_size=2))),
    )
    end = RunEnd(draw(st.booleans()), draw(texts), draw(ids), draw(ids))
    pose = draw(st.none() | hnp.arrays(np.float64, (4, 4), elements=figures))
    return SavedMap(world(elements, pending, draw(backgrounds())), run, end, draw(stamps), pose)


# ---- equality to the bit


def bits(value):
    """Nested tuples, equal only where types, shapes and every bit are; ``touched`` and the order of mappings aside."""
    if isinstance(value, WorldMap):
        value = (value.evidence, value.elements, value.background)
    if dataclasses.is_dataclass(value):
        return tuple((f.name, bits(getattr(value, f.name))) for f in dataclasses.fields(value))
    if isinstance(value, np.ndarray):
        return (value.dtype.str, value.shape, value.tobytes())
    if isinstance(value, dict):
        return tuple((key, bits(value[key])) for key in sorted(value))
    if isinstance(value, tuple | list):
        return tuple(bits(v) for v in value)
    return (type(value).__name__, value.hex() if isinstance(value, float) else value)
