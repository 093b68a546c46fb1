"""Whether the lists are whole: holes, repetitions, images that cannot be read, depth that colour does not meet."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator

import numpy as np

from vlmm_log.checks.case import Case
from vlmm_log.checks.report import Evidence, Finding, Told
from vlmm_log.readers.images import ImageError
from vlmm_log.readers.poses import ELSEWHERE
from vlmm_log.readers.stamps import SET_BACK, SORTED_IN, TOO_LATE
from vlmm_log.readers.stored import Shot
from vlmm_log.types import Int64

HOLES = 0.1  # share of a regular list that is missing
REGULAR = 0.8  # share of intervals near a multiple of the period, without which a list has no period
SHORTEST = 6  # rows, below which nothing is said of regularity
TOGETHER = 0.8  # share of images with a partner
REPEATED = 0.02  # share of images that repeat an earlier one
STILL_PX = 3.0  # median flow of a camera that stands still
COMPARED = 600  # images whose bytes are compared
UNUSABLE = 0.01  # share of rows or images that cannot be used
POSE_ROWS = ("pose", "transform")  # how reasons of unusable pose rows begin


def check_lists(case: Case) -> Told:
    """Stamps and files, by what is listed and by the bytes."""
    holes = list(_holes(case))
    yield from holes
    if not any(isinstance(told, Finding) for told in holes):
        yield from _association(case)
    yield from _unusable(case)
    yield from _repetitions(case)


def _holes(case: Case) -> Told:
    for kind, stamps in (("colour", case.timeline.rgb_ns), ("depth", case.timeline.depth_ns)):
        if len(stamps) < SHORTEST:
            continue
        intervals = np.diff(stamps) / 1e9
        period = float(np.quantile(intervals, 0.3))
        steps = intervals / period
        regular = float(np.mean(np.abs(steps - np.rint(steps)) < 0.25))
        missing = float(np.maximum(np.rint(steps) - 1, 0).sum())
        share = missing / (missing + len(stamps))
        longest = float(intervals.max())
        figures = {"missing_share": share, "period_s": period, "longest_gap_s": longest, "regular_share": regular}
        if regular >= REGULAR and share > HOLES:
            text = f"{share:.0%} of the {kind} images are missing from a list with one every {period * 1e3:.0f} ms"
            remedy = f"list the missing {kind} images, or record again without dropping"
            yield Finding("gaps", f"{text}; the longest gap is {longest:.2f} s", remedy, figures)
        else:
            order = f"one every {period * 1e3:.0f} ms, {share:.1%} missing" if regular >= REGULAR else "no fixed rate"
            yield Evidence("gaps", f"{len(stamps)} {kind} images: {order}, longest gap {longest:.2f} s", figures)


def _association(case: Case) -> Told:
    timeline = case.timeline
    fewer = min(len(timeline.rgb_ns), len(timeline.depth_ns))
    inside = _overlap(timeline.rgb_ns, timeline.depth_ns)
    share = len(timeline.pairs) / max(min(fewer, inside), 1)
    apart = nearest_s(timeline.rgb_ns, timeline.depth_ns)
    middle, spread = float(np.median(apart)), float(np.subtract(*np.quantile(apart, [0.9, 0.1])))
    figures = {"paired_share": min(share, 1.0), "depth_minus_colour_s": middle, "spread_s": spread}
    text = f"{min(share, 1.0):.0%} of the images have a partner; depth comes {middle * 1e3:+.0f} ms after colour"
    whole_log = case.read.start_s == 0 and case.read.stop_s >= 1e9
    if share >= TOGETHER or fewer < SHORTEST or not whole_log:
        yield Evidence("synchronisation", f"{text} (80 % within {spread * 1e3:.0f} ms)", figures)
        return
    if spread < case.read.association_s:
        offset = case.read.depth_offset_s - middle
        yield Finding("synchronisation", f"{text}, always", f"--set read.depth_offset_s={offset:.3f}", figures)
    else:
        wide = float(np.quantile(np.abs(apart), 0.95))
        yield Finding("synchronisation", f"{text}, by up to {wide:.3f} s", "trigger both cameras together", figures)


def nearest_s(rgb_ns: Int64, depth_ns: Int64) -> Int64:
    """Stamp of the nearest depth image minus each colour image's, s."""
    after = np.clip(np.searchsorted(depth_ns, rgb_ns), 1, max(len(depth_ns) - 1, 1))
    later = depth_ns[np.minimum(after, len(depth_ns) - 1)] - rgb_ns
    earlier = depth_ns[after - 1] - rgb_ns
    return np.asarray(np.where(np.abs(earlier) <= np.abs(later), earlier, later) / 1e9)


def _overlap(a: Int64, b: Int64) -> int:
    """How many of the sparser list lie within the span of the other."""
    few, many = sorted((a, b), key=len)
    return int(np.count_nonzero((few >= many[0]) & (few <= many[-1])))


def _unusable(case: Case) -> Told:
    """Rows and images that the reader left out, by reason."""
    timeline = case.timeline
    rows = timeline.left_out
    poses = 0 if case.log.poses is None else case.log.poses.stamps_ns.size
    images = len(timeline.rgb_ns) + len(timeline.depth_ns)
    for reason, count in sorted(rows.items()):
        of_pose = reason.startswith(POSE_ROWS)
        share = count / (count + (poses if of_pose else images))
        text, figures = f"{count} rows are not used: {reason}", {"rows": float(count), "share": share}
        if share > UNUSABLE and not reason.startswith(ELSEWHERE):
            remedy = "write the poses again with unit quaternions" if of_pose else "mend these rows of the lists"
            yield Finding("unusable rows", text, remedy, figures)
        else:
            yield Evidence("unusable rows", text, figures)
    for reason, count in sorted(case.samples.left_out.items()):
        if reason in rows or "within" in reason or not case.samples.seen:  # pairs, poses, no frame: told elsewhere
            continue
        figures = {"share": count / (count + len(case.samples.seen))}
        if reason in (SORTED_IN, SET_BACK):
            yield Evidence("order of images", f"of those looked at {count}, which are used: {reason}", figures)
            continue
        remedy = "mend or replace these images, or give the camera that they are from with --intrinsics"
        if reason.startswith(TOO_LATE):
            remedy = "write the bag again with its images in the order of their stamps"
        yield Finding("unusable images", f"of those looked at {count} fail: {reason}", remedy, figures)


def _repetitions(case: Case) -> Told:
    """Images with the same bytes under different stamps."""
    latest: dict[str, bytes] = {}
    compared = repeated = 0
    empty = bool(case.samples.seen) and max(case.samples.seen) == 0  # told elsewhere; nothing is equal to nothing
    for shot in _some_shots(case):
        if empty and shot.kind == "depth":
            continue
        try:
            digest = hashlib.blake2b(shot.load().data, digest_size=16).digest()
        except ImageError:  # told where frames are made
            continue
        compared += 1
        repeated += latest.get(shot.kind) == digest
        latest[shot.kind] = digest
    share = repeated / max(compared, 1)
    figures = {"repeated_share": share, "compared": float(compared)}
    text = f"{repeated} of {compared} images repeat the one before under another stamp"
    flow = [p.moved_px for p in case.samples.probes if np.isfinite(p.moved_px)]
    if share > REPEATED and flow and np.median(flow) < STILL_PX:
        yield Evidence("repeated images", f"{text}; the camera stands still, so that no pose is contradicted", figures)
    elif share > REPEATED:
        remedy = "take the repeated rows out of the lists; they pass for a camera and a world that stand still"
        yield Finding("repeated images", text, remedy, figures)
    else:
        yield Evidence("repeated images", text, figures)


def _some_shots(case: Case) -> Iterator[Shot]:
    """Images of the whole log, or of windows spread over it where there are many."""
    timeline = case.timeline
    stamps = timeline.frame_ns - timeline.origin_ns
    if not len(stamps):
        return
    windows = [(int(stamps[0]), int(stamps[-1]) + 1)]
    if 2 * len(stamps) > COMPARED:
        length = COMPARED // 20
        starts = np.linspace(0, len(stamps) - 1 - length, 10).round().astype(int)
        windows = [(int(stamps[k]), int(stamps[k + length])) for k in starts]
    for start, stop in windows:
        yield from (shot for shot in case.log.shots(start, stop) if isinstance(shot, Shot))
