"""Maps as JSON: one object an element, a line each, under the paper's names.

float64 figures stand as Python's ``repr``, float32 ones as the shortest number that gives them back, features as
base64 of a stated type. Elements, votes and versions are sorted, so that equal maps are equal bytes.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from functools import partial
from math import isnan, nan
from pathlib import Path
from typing import Any

import numpy as np

from vlmm_log.background import Background
from vlmm_log.elements import OBSERVATION, Element, Evidence, MotionClass, Observations, WorldMap
from vlmm_log.maps.fields import Field, encoded_feature, single, twice
from vlmm_log.maps.header import NAMES, check_version, header, read_header
from vlmm_log.maps.saved import SavedMap
from vlmm_log.types import Float32, Float64, InputError, Int32

LARGEST = 2**31  # bytes; the reader needs ten times as much memory
FUSED = ("id", "label", "position", "extent", "motion_class", "confidence", "observed_motion", "movability_prior")
SEEN = ("votes", "feature_pixels", "feature_index", "semantic_feat", "observations")
MOTION = ("o", "kappa", "p_stat", "score", "speed", "intervals")
CALIBRATED = "p_moving"  # of the motion, where a calibration gave it
CELLS = ("x", "y", "z", "points", "red", "green", "blue")
compact = partial(json.dumps, ensure_ascii=False, allow_nan=False, separators=(",", ":"))


def write(path: Path, saved: SavedMap) -> None:
    """Write a map that is ``checked``. Raises OSError, and UnicodeEncodeError for text that is none."""
    with path.open("w", encoding="utf-8", newline="\n") as f:
        f.writelines(_lines(saved))


def read(path: Path) -> SavedMap:
    """A map, its types checked; ``checked`` looks at its values. Raises InputError."""
    top = Field(_parsed(path), path)
    check_version(top)
    *_, elements, pending, background = top.members((*NAMES, "elements", "pending", "background"))
    fused = [_element(field) for field in elements.items()]
    evidence = [e.evidence for e in fused] + [_evidence(f.members(("id", *SEEN))) for f in pending.items()]
    world = WorldMap({e.id: e for e in evidence}, {e.id: e for e in fused}, (_background(background),))
    if len(world.evidence) < len(evidence):
        raise top.wrong(f"elements, pending: id {twice(e.id for e in evidence)} stands there twice")
    return SavedMap(world, *read_header(top))


def shortest(values: Float32) -> Float64:
    """float64 of the fewest decimals that, rounded to float32, give ``values`` back."""
    exact = values.astype(np.float64)
    size = np.where(exact == 0, 1.0, np.abs(exact))
    found, done = exact.copy(), exact == 0
    for digits in (6, 7, 8, 9):  # six hold any shorter number, nine any float32
        places = digits - 1 - np.floor(np.log10(size))
        scale = 10.0 ** np.abs(places)
        candidate = np.where(places >= 0, np.rint(exact * scale) / scale, np.rint(exact / scale) * scale)
        hit = ~done & (single(candidate) == values)
        found[hit] = candidate[hit]
        done |= hit
    return found


def _lines(saved: SavedMap) -> Iterator[str]:
    world = saved.world
    yield "{\n"
    for name, value in header(saved).items():
        yield f"{compact(name)}: {compact(value)},\n"
    yield from _listed("elements", (_element_object(world.elements[i]) for i in sorted(world.elements)))
    yield from _listed("pending", ({"id": e.id} | _evidence_object(e) for e in saved.pending))
    b = world.background
    columns = [*b.cells.T.tolist(), *b.sums.T.tolist()]
    voxels = {"voxel_m": float(b.voxel_m)} | dict(zip(CELLS, columns, strict=True))
    yield f'"background": {compact(voxels)}\n}}\n'


def _listed(name: str, objects: Iterable[object]) -> Iterator[str]:
    between = f'"{name}": [\n'
    for value in objects:
        yield between + compact(value)
        between = ",\n"
    yield f'"{name}": [\n],\n' if between != ",\n" else "\n],\n"


def _element_object(e: Element) -> dict[str, object]:
    motion = (*(float(x) for x in (e.o, e.kappa, e.p_stat, e.score, e.speed)), e.intervals.tolist())
    calibrated = {} if isnan(e.p_moving) else {CALIBRATED: float(e.p_moving)}
    fused = (
        int(e.id),
        e.label,
        shortest(e.position).tolist(),
        shortest(e.extent).tolist(),
        MotionClass(e.motion_class).name,
        float(e.confidence),
        dict(zip(MOTION, motion, strict=True)) | calibrated,
        {"rho": float(e.rho), "source": e.rho_source},
    )
    return dict(zip(FUSED, fused, strict=True)) | _evidence_object(e.evidence)


def _evidence_object(e: Evidence) -> dict[str, object]:
    seen = (
        {name: int(e.votes[name]) for name in sorted(e.votes)},
        int(e.feature_pixels),
        int(e.feature_index),
        encoded_feature(e.feature),
        {name: _column(e.observations, name) for name in OBSERVATION.names or ()},
    )
    return dict(zip(SEEN, seen, strict=True))


def _column(observations: Observations, name: str) -> list[object]:
    values = observations[name]
    return list((shortest(values) if values.dtype.kind == "f" else values).tolist())


def _parsed(path: Path) -> object:
    try:
        if path.stat().st_size > LARGEST:
            raise InputError(f"{path}: is larger than {LARGEST / 1e9:.1f} GB; keep a map of this size as .parquet")
        return json.loads(path.read_text("utf-8"), object_pairs_hook=_once, parse_constant=_no_number)
    except OSError as e:
        raise InputError(f"{path}: cannot be read: {e.strerror or e}") from e
    except UnicodeDecodeError as e:
        raise InputError(f"{path}: is not JSON: no UTF-8 at byte {e.start}") from e
    except RecursionError as e:
        raise InputError(f"{path}: is no map: nested too deep") from e
    except ValueError as e:
        raise InputError(f"{path}: is not JSON: {str(e)[:200]}") from e


def _once(pairs: list[tuple[str, object]]) -> dict[str, object]:
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError(f"{str(twice(name for name, _ in pairs))[:60]!r} stands twice in an object")
    return found


def _no_number(text: str) -> object:
    raise ValueError(f"{text} is no number")


def _element(field: Field) -> Element:
    members = field.members((*FUSED, *SEEN))
    id_, label, position, extent, motion_class, confidence, motion, prior = members[: len(FUSED)]
    known = (*MOTION, CALIBRATED) if CALIBRATED in motion.names() else MOTION
    o, kappa, p_stat, score, speed, intervals, *p_moving = motion.members(known)
    rho, source = prior.members(("rho", "source"))
    if motion_class.text() not in MotionClass.__members__:
        raise motion_class.wrong(f"is none of {', '.join(MotionClass.__members__)}")
    return Element(
        evidence=_evidence([id_, *members[len(FUSED) :]]),
        label=label.text(),
        position=position.vector(3),
        extent=extent.vector(6),
        o=o.number(),
        kappa=kappa.number(),
        rho=rho.number(),
        rho_source=source.text(),
        motion_class=MotionClass[motion_class.text()],
        confidence=confidence.number(),
        p_stat=p_stat.number(),
        score=score.number(),
        speed=speed.number(),
        intervals=intervals.integers(2),
        p_moving=p_moving[0].number() if p_moving else nan,
    )


def _evidence(members: list[Field]) -> Evidence:
    id_, votes, pixels, index, feature, observations = members
    return Evidence(
        id=id_.integer(),
        votes={name: votes.member(name).integer() for name in votes.names()},
        observations=_observations(observations),
        feature=feature.feature(),
        feature_pixels=pixels.integer(),
        feature_index=index.integer(),
    )


def _observations(field: Field) -> Observations:
    names = OBSERVATION.names or ()
    columns = field.members(names)
    rows = np.zeros(columns[0].length(), OBSERVATION)
    for name, column in zip(names, columns, strict=True):
        kind = OBSERVATION[name]
        values = single(column.floats(*kind.shape)) if kind.base.kind == "f" else _integers(column, kind.base)
        if len(values) != len(rows):
            raise column.wrong(f"has {len(values)} rows, {names[0]} has {len(rows)}")
        rows[name] = values
    return rows


def _integers(field: Field, kind: np.dtype[Any]) -> Int32:
    values = field.integers()
    limit = 2 ** (8 * kind.itemsize - 1)
    if values.size and not -limit <= int(values.min()) <= int(values.max()) < limit:
        raise field.wrong(f"an integer has more than {8 * kind.itemsize} bits")
    return values.astype(kind)


def _background(field: Field) -> Background:
    voxel_m, *columns = field.members(("voxel_m", *CELLS))
    lengths = {column.length() for column in columns}
    if len(lengths) > 1:
        raise field.wrong(f"{', '.join(CELLS)} are not equally many")
    cells = [_integers(column, np.dtype(np.int32)) for column in columns[:3]]
    sums = [column.integers() for column in columns[3:]]
    return Background(voxel_m.number(), np.stack(cells, axis=1), np.stack(sums, axis=1))
