"""`doctor`: which conventions a log keeps, decided from its data, and the flag that mends each one that is wrong."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from vlmm_log.checks.camera import check_camera, check_plausible_camera
from vlmm_log.checks.case import Case
from vlmm_log.checks.depth_scale import check_depth_scale
from vlmm_log.checks.lists import check_lists, nearest_s
from vlmm_log.checks.registration import check_registration
from vlmm_log.checks.report import Diagnosis, Evidence, Finding, Told, sets_of
from vlmm_log.checks.trajectory import check_trajectory
from vlmm_log.protocols import Progress
from vlmm_log.settings import Settings
from vlmm_log.types import InputError

__all__ = ["Diagnosis", "Evidence", "Finding", "doctor"]

CHECKS: dict[Callable[[Case], Told], str] = {  # each sees the log as the findings before it mend it
    check_lists: "lists",
    check_depth_scale: "depth scale",
    check_plausible_camera: "intrinsics",
    check_registration: "registration",
    check_trajectory: "poses",
    check_camera: "camera",
}
GEOMETRY = (check_registration, check_trajectory, check_camera)
STOPPING = {  # what is not examined after a finding that only the user can mend: it would be told of its consequences
    "frames": (check_depth_scale, check_plausible_camera, *GEOMETRY),
    "depth coverage": GEOMETRY,
    "mirrored depth": GEOMETRY,
    "repeated images": (check_registration,),
}
WIDEST_S = 0.5  # between colour and depth where the settings' limit lets nothing together


def doctor(source: str | Path, *, settings: Settings | None = None, progress: Progress | None = None) -> Diagnosis:
    """Examine a log: some places of it, whatever its length.

    Each check looks at the log as the flags of the findings before it mend it, so that a fault is told once.
    ``settings`` are those that the log would be processed with; start and stop bound what is looked at.
    Raises InputError where the source cannot be opened.
    """
    path = Path(source)
    case, told = _opened(path, settings or Settings(), progress or _untold)
    for check, title in CHECKS.items():
        stopping = [x.check for x in told if isinstance(x, Finding) and check in STOPPING.get(x.check, ())]
        if stopping:
            told.append(Evidence(title, f"not examined before this is mended: {stopping[0]}"))
            continue
        new = list(check(case))
        told += new
        sets = [s for x in new if isinstance(x, Finding) for s in sets_of(x.remedy)]
        if sets:
            case = case.under(tuple(sets))
    findings = tuple(x for x in told if isinstance(x, Finding))
    return Diagnosis(str(path), findings, tuple(x for x in told if isinstance(x, Evidence)))


def _opened(path: Path, s: Settings, tell: Progress) -> tuple[Case, list[Finding | Evidence]]:
    """The case, and what had to be mended before there was any frame."""
    told: list[Finding | Evidence] = []
    try:
        case = Case.open(path, s, tell)
        _ = case.timeline  # of a bag, only reading it tells that no images meet
    except InputError as e:
        case, finding = _brought_together(path, s, tell, e)
        told.append(finding)
    if not len(case.timeline.pairs):
        raise InputError(f"{path}: no frame between --start and --stop; widen them")
    if not case.samples.seen:
        reasons = "; ".join(f"{reason} ({count}x)" for reason, count in case.samples.left_out.most_common(3))
        remedy = "mend the images, or give the camera that they are from with --intrinsics fx,fy,cx,cy"
        told.append(Finding("frames", f"no frame can be read: {reasons}", remedy))
    return case, told


def _brought_together(path: Path, s: Settings, tell: Progress, error: InputError) -> tuple[Case, Finding]:
    """A log none of whose colour images meets a depth image, with the offset that lets most meet."""
    if s.read.association_s >= WIDEST_S:
        raise error
    wide = replace(s, read=replace(s.read, association_s=WIDEST_S))
    try:
        timeline = Case.open(path, wide, tell).timeline
    except InputError:
        raise error from None
    late = float(np.median(nearest_s(timeline.rgb_ns, timeline.depth_ns)))
    remedy = f"--set read.depth_offset_s={s.read.depth_offset_s - late:.3f}"
    message = f"no colour image has depth within {s.read.association_s:g} s; depth comes {late * 1e3:+.0f} ms after"
    finding = Finding("synchronisation", message, remedy, {"depth_minus_colour_s": late})
    try:
        case = Case.open(path, s.changed(sets_of(remedy)), tell)
        _ = case.timeline
        return case, finding
    except InputError:
        raise error from None


def _untold(_done: int, _expected: int) -> None:
    """Nobody waits."""
