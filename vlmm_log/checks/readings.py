"""Readings of listed poses: every convention that they may be in, and how far each is off what the images show."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from vlmm_log import se3
from vlmm_log.checks.case import Case
from vlmm_log.checks.depth_scale import UNITS, units_by_steps
from vlmm_log.checks.motion_pairs import MotionPair, carried
from vlmm_log.checks.registration import peak
from vlmm_log.checks.rigid import error_px
from vlmm_log.readers import conventions
from vlmm_log.readers.poses import Poses
from vlmm_log.readers.stamps import limit_ns
from vlmm_log.types import Float64

SWEEP_S = 0.2  # largest time offset tried
STEP_S = 0.01
LATE_S = 0.03  # a smaller offset is within the stamping of unsynchronised sensors
BETTER, LEAST_PX = 0.6, 1.0  # another reading leaves at most this share of the error, and wins so many px
SOONER, LEAST_SOONER_PX = 0.8, 0.3  # another time offset: where clocks agree the best one is near 0 anyway
AGREEING = 0.75  # share of pairs on which it must win
EACH_CHANGE = 0.05  # log error that each changed knob must win: of equals the simplest is taken
EACH_PLACE = 0.15  # log error that a mounting's position must win: it is far less certain than its turn
POSITIONS, DEPTH = "position_units_per_meter", "depth_units_per_meter"  # only their ratio shows: one of them is wrong
MOST_CHANGES = 3  # wrong at once
FEWEST_PAIRS = 3
FEWEST_MOUNTED = 6  # pairs that a mounting of six numbers is told from
RANKED_ON, RANKED = 5, 12  # pairs on which all readings are tried, and best ones that are tried on every pair
SWEPT = 4  # best readings whose clock is swept too


@dataclass(frozen=True, eq=False)
class Candidate:
    """One reading of the listed poses, and how far it is off on each pair."""

    changes: tuple[tuple[str, str], ...]  # knob of read, value
    poses: Poses
    errors: Float64  # (pairs,) px; NaN without a pose
    stretch: float = 1.0  # of the poses' translations beside depth as it was read
    offset_s: float = 0.0  # added to what the settings say

    @property
    def score(self) -> float:
        """Mean log error, and a little for each change."""
        seen = self.errors[np.isfinite(self.errors)]
        if not len(seen):
            return np.inf
        return float(np.mean(np.log(seen + 0.5))) + EACH_CHANGE * (len(self.changes) + (self.offset_s != 0))

    @property
    def px(self) -> float:
        """Median error."""
        seen = self.errors[np.isfinite(self.errors)]
        return float(np.median(seen)) if len(seen) else np.nan

    @property
    def remedy(self) -> str:
        """Flags."""
        return " ".join(f"--set read.{name}={value}" for name, value in self.changes)


def wins(a: Candidate, b: Candidate) -> bool:
    """Whether one reading is clearly better than another: by a factor, by pixels, and on most pairs."""
    seen = np.isfinite(a.errors) & np.isfinite(b.errors)
    x, y = a.errors[seen], b.errors[seen]
    if len(x) < FEWEST_PAIRS:
        return False
    factor = float(np.exp(np.mean(np.log(x + 0.5)) - np.mean(np.log(y + 0.5))))
    on_most = float(np.mean(x < y)) >= AGREEING
    only_clock = a.changes == b.changes and a.offset_s != b.offset_s
    share, px = (SOONER, LEAST_SOONER_PX) if only_clock else (BETTER, LEAST_PX)
    return factor < share and float(np.median(y) - np.median(x)) > px and on_most


def changes(case: Case) -> list[tuple[tuple[str, str], ...]]:
    """Every other reading: direction, quaternion order, axes, mounting, units of positions."""
    now = case.read
    units = now.position_units_per_meter
    options: tuple[tuple[str, str, tuple[str, ...]], ...] = (
        ("poses", now.poses, ("camera_to_world", "world_to_camera")),
        ("quaternion", now.quaternion, ("xyzw", "wxyz")),
        ("camera_axes", now.camera_axes, ("optical", "body", "opengl")),
        ("pose_to_camera", now.pose_to_camera, (now.pose_to_camera, "none", "bonn", "icl")),
        (POSITIONS, f"{units:g}", (f"{units:g}", *(f"{units * k:g}" for k in (1000, 100, 0.001)))),
    )
    of_depth = f"{case.log.units_per_meter:g}"
    if units_by_steps(case)[1] is None and case.log.units_per_meter != 1:  # depth has no ruler of its own
        options += ((DEPTH, of_depth, (of_depth, *(f"{u:g}" for u in UNITS if u > 1))),)
    found = []
    for values in product(*(sorted(set(o[2])) for o in options)):
        rows = zip(options, values, strict=True)
        found.append(tuple((name, value) for (name, was, _), value in rows if value != was))
    return [c for c in found if 0 < len(c) <= MOST_CHANGES and not {POSITIONS, DEPTH} <= {name for name, _ in c}]


def promising(case: Case, poses: Poses, pairs: list[MotionPair]) -> list[Candidate]:
    """The other readings that do best on some of the pairs, judged on all."""
    some = pairs[:: -(-len(pairs) // RANKED_ON)]
    ranked = sorted((candidate(case, poses, some, c) for c in changes(case)), key=lambda c: c.score)
    return [candidate(case, poses, pairs, c.changes) for c in ranked[:RANKED]]


def candidate(case: Case, poses: Poses, pairs: list[MotionPair], changed: tuple[tuple[str, str], ...]) -> Candidate:
    """The poses read with some knobs changed."""
    stretch = 1.0
    if changed:
        read = case.settings.changed([f"read.{name}={value}" for name, value in changed]).read
        poses = replace(poses, convention=conventions.asked(read, poses.convention))
        stretch = (read.depth_units_per_meter or case.log.units_per_meter) / case.log.units_per_meter
    return Candidate(changed, poses, _errors(case, poses, pairs, stretch), stretch)


def swept(case: Case, pairs: list[MotionPair], now: Candidate, others: list[Candidate]) -> Iterator[Candidate]:
    """The present reading and the best others, each with and without the time offset that suits it."""
    yield from others
    for c in [now, *sorted(others, key=lambda c: c.score)[:SWEPT]]:
        offset, _ = best_offset(case, pairs, c)
        if abs(offset) >= LATE_S:
            yield _shifted(case, pairs, c, offset)


def best_offset(case: Case, pairs: list[MotionPair], c: Candidate) -> tuple[float, float]:
    """Time offset s that suits a reading best, and its error px. Where a pair loses its pose, others decide."""
    offsets = np.arange(-SWEEP_S, SWEEP_S + STEP_S / 2, STEP_S)
    tried = [_shifted(case, pairs, c, float(s)) for s in offsets]
    scores = np.array([-t.score if np.isfinite(t.errors).sum() >= FEWEST_PAIRS else -np.inf for t in tried])
    if not np.isfinite(scores).all():
        scores = np.where(np.isfinite(scores), scores, -1e3)
    return peak(offsets.tolist(), scores), tried[int(np.argmax(scores))].px


def _shifted(case: Case, pairs: list[MotionPair], c: Candidate, offset_s: float) -> Candidate:
    convention = replace(c.poses.convention, offset_ns=c.poses.convention.offset_ns + round(offset_s * 1e9))
    poses = replace(c.poses, convention=convention)
    return Candidate(c.changes, poses, _errors(case, poses, pairs, c.stretch), c.stretch, offset_s)


def _errors(case: Case, poses: Poses, pairs: list[MotionPair], stretch: float) -> Float64:
    """(pairs,) px. Errors know only the ratio of translation to depth: other units of depth stretch translations."""
    K = case.log.camera.K
    relatives = [relative(poses, p, case) for p in pairs]
    for T in relatives:
        if T is not None:
            T[:3, 3] *= stretch
    return np.array([np.nan if T is None else error_px(p.probe, T, K) for p, T in zip(pairs, relatives, strict=True)])


def relative(poses: Poses, pair: MotionPair, case: Case) -> Float64 | None:
    """``T_second_first`` (4, 4) by the poses; None where one is missing."""
    gap = limit_ns(case.read.pose_gap_s)
    first, second = poses.at(pair.probe.first_ns, gap), poses.at(pair.probe.second_ns, gap)
    return None if first is None or second is None else se3.inverse(second) @ first


def mounted(case: Case, poses: Poses, pairs: list[MotionPair]) -> Candidate | None:
    """The best reading with the camera mounted in the tracked frame as the pairs themselves say."""
    found: list[tuple[float, Candidate]] = []
    for direction, order in product(("camera_to_world", "world_to_camera"), ("xyzw", "wxyz")):
        bare = (("camera_axes", "optical"), ("poses", direction), ("quaternion", order))
        tracked = candidate(case, poses, pairs, (*bare, ("pose_to_camera", "none"))).poses
        motions = [(p.T, T) for p in pairs if (T := relative(tracked, p, case)) is not None]
        mountings = carried(motions) if len(motions) >= FEWEST_MOUNTED else None
        named = [(name, value) for name, value in bare if getattr(case.read, name) != value]
        for k, X in enumerate(mountings or ()):
            numbers = ",".join(f"{x:.4f}" for x in (*X[:3, 3], *se3.quaternion(X)))
            tried = candidate(case, poses, pairs, (*named, ("pose_to_camera", numbers)))
            found.append((tried.score + k * EACH_PLACE, tried))
    return min(found, key=lambda x: x[0])[1] if found else None
