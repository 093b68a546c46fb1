"""Whether the intrinsics suit the images: by what is plausible, by rigidity, by the poses, and by the log's name."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np

from vlmm_log.checks.case import Case
from vlmm_log.checks.motion_pairs import MotionPair, motion_pairs, moving
from vlmm_log.checks.readings import FEWEST_PAIRS, relative
from vlmm_log.checks.report import Evidence, Finding, Told
from vlmm_log.checks.rigid import error_px, fit
from vlmm_log.readers.intrinsics import PRESETS, Intrinsics
from vlmm_log.types import Float64

FOCAL = (0.35, 2.5)  # plausible focal length as a share of the image's width
CENTRE = 0.15  # of the image's size that the principal point may be off its middle
BETTER = 0.6  # a candidate's error as a share of the present one, at most
LEAST_PX = 0.5  # and it must win so much
AGREEING = 0.8  # share of pairs on which it must win
SCALES = (2.0, 0.5, 4.0, 0.25)  # of another resolution


def check_plausible_camera(case: Case) -> Told:
    """Focal length and principal point against the image's size, and the log's name."""
    if not case.samples.probes:
        return
    H, W = case.samples.probes[0].size
    own = case.log.camera
    figures = {"fx_px": own.fx, "fy_px": own.fy, "cx_px": own.cx, "cy_px": own.cy}
    text = f"fx {own.fx:g}, fy {own.fy:g}, cx {own.cx:g}, cy {own.cy:g} px on {W}x{H} px"
    if not plausible(own, W, H):
        better = next((c for k in SCALES if plausible(c := scaled(own, k), W, H)), None)
        remedy = f"--intrinsics {numbers(better)}" if better else "give the camera's own with --intrinsics fx,fy,cx,cy"
        yield Finding("intrinsics", f"{text}: of another resolution", remedy, figures)
        return
    named = _named(case)
    if named is not None:
        name, other = named
        message = f"{text} are those of {other}; the log's name says {name}"
        yield Finding("intrinsics", message, f"--intrinsics {name}", figures)
        return
    yield Evidence("intrinsics", f"{text} are plausible", figures)


def plausible(c: Intrinsics, width: int, height: int) -> bool:
    """Whether such a camera is likely to give images of that size."""
    centred = abs(c.cx / width - 0.5) < CENTRE and abs(c.cy / height - 0.5) < CENTRE
    return centred and FOCAL[0] < c.fx / width < FOCAL[1] and 0.8 < c.fy / c.fx < 1.25


def scaled(c: Intrinsics, k: float) -> Intrinsics:
    """The camera of k times the resolution."""
    return replace(c, fx=k * c.fx, fy=k * c.fy, cx=k * (c.cx + 0.5) - 0.5, cy=k * (c.cy + 0.5) - 0.5)


def numbers(c: Intrinsics) -> str:
    """As --intrinsics takes them."""
    return ",".join(f"{x:.2f}".rstrip("0").rstrip(".") for x in (c.fx, c.fy, c.cx, c.cy))


def _named(case: Case) -> tuple[str, str] | None:
    """The preset that the log's name asks for and the one that its camera equals, where they differ."""
    found = re.search(r"freiburg[123]|bonn", case.log.name)
    if found is None:
        return None
    own = case.log.camera
    same = [name for name, p in PRESETS.items() if np.abs(p.K - own.K).max() < 0.5]
    return (found[0], same[0]) if same and found[0] not in same else None


def check_camera(case: Case) -> Told:
    """Every known camera against the log's: what poses leave, or where there are none, what rigid motions leave."""
    pairs = moving(motion_pairs(case))
    if len(pairs) < FEWEST_PAIRS:
        yield Evidence("camera", "cannot tell: the camera stands still", {"moving_pairs": float(len(pairs))})
        return
    cameras = {name: p for name, p in PRESETS.items() if np.abs(p.K - case.log.camera.K).max() > 0.5}
    motions = _motions(case, pairs)
    by = "rigid motions" if motions is None else "poses"
    now = _errors(pairs, motions, case.log.camera.K)
    left = {name: _errors(pairs, motions, camera.K) for name, camera in cameras.items()}
    name = min(left, key=lambda n: float(np.mean(np.log(left[n] + 0.2))))
    before, after = float(np.median(now)), float(np.median(left[name]))
    figures = {"error_px": before, "best_error_px": after, "pairs": float(len(now))}
    text = f"{by} leave {before:.2f} px, {after:.2f} px with the intrinsics of {name}"
    agree = float(np.mean(left[name] < now))
    if after < BETTER * before and before - after > LEAST_PX and agree >= AGREEING:
        yield Finding("camera", text, f"--intrinsics {name}", figures)
    else:
        yield Evidence("camera", f"{text}: no clear difference", figures)


def _motions(case: Case, pairs: list[MotionPair]) -> list[Float64 | None] | None:
    """``T_second_first`` of each pair by the poses; None where the poses tell too little."""
    if case.log.poses is None:
        return None
    motions = [relative(case.log.poses, p, case) for p in pairs]
    return motions if sum(T is not None for T in motions) >= FEWEST_PAIRS else None


def _errors(pairs: list[MotionPair], motions: list[Float64 | None] | None, K: Float64) -> Float64:
    """(n,) px of each pair under a camera."""
    if motions is None:
        return np.array([error_px(p.probe, fit(p.probe, K, p.T), K) for p in pairs])
    return np.array([error_px(p.probe, T, K) for p, T in zip(pairs, motions, strict=True) if T is not None])
