"""Whether poses say what the images say: their convention, their clock, and whether they move at all."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from vlmm_log import se3
from vlmm_log.checks.case import Case
from vlmm_log.checks.depth_scale import UNITS, units_by_steps
from vlmm_log.checks.lists import POSE_ROWS, UNUSABLE
from vlmm_log.checks.motion_pairs import MotionPair, carried, flow_px, motion_pairs, moving
from vlmm_log.checks.registration import peak
from vlmm_log.checks.report import Evidence, Finding, Told
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
UNEXPLAINED, UNEXPLAINED_PX = 0.35, 4.0  # share of the flow, and px, that poses leave which belong elsewhere
STANDING = 0.15  # of the flow that poses predict where they stand still
SWEPT = 6  # best conventions whose clock is swept too


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


def check_trajectory(case: Case) -> Told:
    """Poses against the motion of the images. Pairs are compared at the stamps of their colour images."""
    poses = case.log.poses
    if poses is None:
        yield Evidence("poses", "the log has no poses; conventions of poses are not examined")
        return
    lost = sum(count for reason, count in case.timeline.left_out.items() if reason.startswith(POSE_ROWS))
    if lost > UNUSABLE * (lost + poses.stamps_ns.size):
        yield Evidence("poses", "not examined: too many of their rows cannot be used", {"rows": float(lost)})
        return
    coverage = list(_coverage(case, poses))
    yield from coverage
    if any(isinstance(told, Finding) for told in coverage):
        return
    pairs = motion_pairs(case)
    standing = list(_standing(case, poses, pairs))
    yield from standing
    pairs = moving(pairs)
    if any(isinstance(told, Finding) for told in standing):
        return
    if len(pairs) < FEWEST_PAIRS:
        yield Evidence("pose convention", "cannot tell: the camera stands still", {"moving_pairs": float(len(pairs))})
        return
    yield from _convention(case, poses, pairs)


def _coverage(case: Case, poses: Poses) -> Told:
    stamps, listed = case.timeline.colour_ns, poses.stamps_ns
    if not listed.size:
        return
    some = stamps[np.unique(np.linspace(0, len(stamps) - 1, 500).astype(int))]
    gap = limit_ns(case.read.pose_gap_s)
    share = float(np.mean([poses.at(int(t), gap) is not None for t in some]))
    late_s = float(listed[0] - stamps[0]) / 1e9
    interval = float(np.median(np.diff(listed))) / 1e9 if listed.size > 1 else np.inf
    figures = {"covered_share": share, "first_pose_after_first_image_s": late_s, "interval_s": interval}
    text = f"{share:.0%} of the images have a pose; poses begin {late_s:+.3f} s after them, one every {interval:.3f} s"
    if share >= 0.5:
        yield Evidence("pose coverage", text, figures)
    elif listed[-1] < stamps[0] or listed[0] > stamps[-1]:
        remedy = "write poses and images with one clock: at no time are there both"
        yield Finding("pose coverage", f"another clock: {text}", remedy, figures)
    elif interval > case.read.pose_gap_s and np.isfinite(interval):
        yield Finding("pose coverage", text, f"--set read.pose_gap_s={1.5 * interval:.2g}", figures)
    else:
        yield Finding(
            "pose coverage", text, "list poses for the whole recording, or cut it with --start, --stop", figures
        )


def _standing(case: Case, poses: Poses, pairs: list[MotionPair]) -> Told:
    """Poses that stand still where the images move, and the other way round."""
    K = case.log.camera.K
    flows = [(p.probe.moved_px, flow_px(p.probe, T, K)) for p in pairs if (T := relative(poses, p, case)) is not None]
    if not flows:
        return
    seen, predicted = np.array(flows).T
    frozen = (seen > 6) & (predicted < np.minimum(STANDING * seen, 1.5))
    driven = (seen < 1.5) & (predicted > 6)
    figures = {"seen_px": float(np.median(seen)), "predicted_px": float(np.median(predicted))}
    for which, text in ((frozen, "images move and poses stand still"), (driven, "images stand still and poses move")):
        count = int(np.count_nonzero(which))
        if count >= FEWEST_PAIRS and count > 0.2 * len(seen):
            of = f"{text} on {count} of {len(seen)} pairs: {np.median(seen[which]):.1f} px seen, "
            of += f"{np.median(predicted[which]):.1f} px predicted"
            remedy = "take the poses out (the camera's motion is then estimated), or list those of this recording"
            yield Finding("pose motion", of, remedy, figures)
            return
    text = f"images move by {np.median(seen):.1f} px a pair, poses predict {np.median(predicted):.1f} px"
    yield Evidence("pose motion", text, figures)


def _convention(case: Case, poses: Poses, pairs: list[MotionPair]) -> Told:
    now = candidate(case, poses, pairs, ())
    if int(np.isfinite(now.errors).sum()) < FEWEST_PAIRS:
        yield Evidence("pose convention", "cannot tell: too few moving pairs have poses")
        return
    flow = float(np.median([p.probe.moved_px for p in pairs]))
    best = min(
        _swept(case, pairs, now, [candidate(case, poses, pairs, c) for c in changes(case)]), key=lambda c: c.score
    )
    figures = {"error_px": now.px, "best_error_px": best.px, "flow_px": flow, "pairs": float(len(pairs))}
    figures["offset_s"] = best.offset_s
    text = f"poses leave {now.px:.1f} px of {flow:.0f} px flow"
    best = best if _wins(best, now) else now
    mounted = _mounted(case, poses, pairs)
    if mounted is not None and _wins(mounted, best):
        figures |= {"best_error_px": mounted.px}
        message = f"{text}, {mounted.px:.1f} px with the camera mounted elsewhere in the tracked frame"
        yield Finding("pose to camera", message, mounted.remedy, figures)
    elif best.px > max(UNEXPLAINED * flow, UNEXPLAINED_PX):
        remedy = "no known reading of the poses explains the images: see whether they belong to this recording"
        yield Finding("pose motion", text, remedy, figures)
    elif best is now:
        offset, left = _offset(case, pairs, now)
        yield Evidence("pose convention", f"{text}; no other reading is clearly better", figures)
        yield Evidence("pose clock", f"best offset {offset * 1e3:+.0f} ms, {left:.1f} px", {"offset_s": offset})
    else:
        yield from _mended(case, best, text, figures)


def _mended(case: Case, best: Candidate, text: str, figures: dict[str, float]) -> Told:
    if best.changes:
        changed = ", ".join(f"{name} = {value}" for name, value in best.changes)
        check = "depth scale" if best.changes[0][0] == DEPTH else "pose convention"
        yield Finding(check, f"{text}, {best.px:.1f} px with {changed}", best.remedy, figures)
    if best.offset_s:
        offset = case.read.pose_offset_s + best.offset_s
        message = f"{text}, {best.px:.1f} px where they are {best.offset_s * 1e3:+.0f} ms later"
        yield Finding("pose clock", message, f"--set read.pose_offset_s={offset:.3f}", figures)


def _wins(a: Candidate, b: Candidate) -> bool:
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


def _swept(case: Case, pairs: list[MotionPair], now: Candidate, others: list[Candidate]) -> Iterator[Candidate]:
    """The present reading and the best others, each with and without the time offset that suits it."""
    promising = sorted(others, key=lambda c: c.score)[:SWEPT]
    for c in [now, *promising]:
        yield c
        offset, _ = _offset(case, pairs, c)
        if abs(offset) >= LATE_S:
            yield _shifted(case, pairs, c, offset)


def _offset(case: Case, pairs: list[MotionPair], c: Candidate) -> tuple[float, float]:
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


def candidate(case: Case, poses: Poses, pairs: list[MotionPair], changed: tuple[tuple[str, str], ...]) -> Candidate:
    """The poses read with some knobs changed."""
    stretch = 1.0
    if changed:
        read = case.settings.changed([f"read.{name}={value}" for name, value in changed]).read
        poses = replace(poses, convention=conventions.asked(read, poses.convention))
        stretch = (read.depth_units_per_meter or case.log.units_per_meter) / case.log.units_per_meter
    return Candidate(changed, poses, _errors(case, poses, pairs, stretch), stretch)


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


def _mounted(case: Case, poses: Poses, pairs: list[MotionPair]) -> Candidate | None:
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
