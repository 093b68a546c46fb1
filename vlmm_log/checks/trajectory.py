"""Whether poses say what the images say: their convention, their clock, and whether they move at all."""

from __future__ import annotations

import numpy as np

from vlmm_log.checks.case import Case
from vlmm_log.checks.lists import POSE_ROWS, UNUSABLE
from vlmm_log.checks.motion_pairs import MotionPair, flow_px, motion_pairs, moving
from vlmm_log.checks.readings import (
    DEPTH,
    FEWEST_PAIRS,
    Candidate,
    best_offset,
    candidate,
    mounted,
    promising,
    relative,
    swept,
    wins,
)
from vlmm_log.checks.report import Evidence, Finding, Told
from vlmm_log.readers.poses import Poses
from vlmm_log.readers.stamps import limit_ns

UNEXPLAINED, UNEXPLAINED_PX = 0.35, 4.0  # share of the flow, and px, that poses leave which belong elsewhere
STANDING = 0.15  # of the flow that poses predict where they stand still


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
    intervals = [float(np.median(np.diff(t.stamps_ns))) / 1e9 for t in poses.moving if t.stamps_ns.size > 1]
    interval = max(intervals, default=np.inf)  # of a chain, the slowest link decides
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
            remedy = "--set read.poses=none"  # the camera's motion is then estimated
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
    others = promising(case, poses, pairs)
    best = min((c for c in swept(case, pairs, now, others) if wins(c, now)), key=lambda c: c.score, default=now)
    figures = {"error_px": now.px, "best_error_px": best.px, "flow_px": flow, "pairs": float(len(pairs))}
    figures["offset_s"] = best.offset_s
    text = f"poses leave {now.px:.1f} px of {flow:.0f} px flow"
    elsewhere = mounted(case, poses, pairs)
    if elsewhere is not None and wins(elsewhere, best):
        figures |= {"best_error_px": elsewhere.px}
        message = f"{text}, {elsewhere.px:.1f} px with the camera mounted elsewhere in the tracked frame"
        yield Finding("pose to camera", message, elsewhere.remedy, figures)
    elif best.px > max(UNEXPLAINED * flow, UNEXPLAINED_PX):
        remedy = "no known reading of the poses explains the images: see whether they belong to this recording"
        yield Finding("pose motion", text, remedy, figures)
    elif best is now:
        offset, left = best_offset(case, pairs, now)
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
