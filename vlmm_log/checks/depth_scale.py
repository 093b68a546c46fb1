"""Whether stored depth is read with the right units: by the sensor's own steps, and by what is plausible."""

from __future__ import annotations

import numpy as np

from vlmm_log.checks.case import Case
from vlmm_log.checks.probe import counted_per_meter
from vlmm_log.checks.report import Evidence, Finding, Told
from vlmm_log.types import Int64

UNITS = (1000.0, 5000.0, 10000.0, 1.0)  # stored values of a metre that are in use
# A structured-light sensor tells depth by disparity in steps of 1/8 px, so its steps grow with z^2:
# step = z^2 / (8 f b). Khoshelham and Oude Elberink, Sensors 2012: 1 / (f b) = 2.85e-5 / cm -> 0.00285 / m.
KINECT_STEP = 0.00287  # 1/m
# Stereo cameras have finer steps of the same kind: a D415's and a D455's at 1280x720 are a Kinect's at five times the
# units. But a Kinect sees nothing that near, and no such wide image.
NEAREST_M, WIDEST = 0.4, 1.5  # depth of the nearest percentile; width over height
AGREE = 0.2  # an estimate within this share of known units means them
SPREAD = 0.3  # estimates at several depths that differ by more are no ruler
COARSE = 2.5  # stored values; finer steps may be rounding
PLAUSIBLE_M = (0.15, 12.0)  # median depth of a log
USUAL_M = 2.0


def check_depth_scale(case: Case) -> Told:
    """Units of depth. Says nothing of logs whose depth is in metres already."""
    samples, units = case.samples, case.log.units_per_meter
    if not samples.seen:
        return
    seen = float(np.median(samples.seen))
    if seen == 0:
        remedy = "record or export depth again: there is none in the images"
        yield Finding("depth coverage", "depth images are 0 all over", remedy, {"seen_share": 0.0})
        return
    yield Evidence("depth coverage", f"{seen:.0%} of the pixels have depth", {"seen_share": seen})
    yield from _scale(case, units)


def _scale(case: Case, units: float) -> Told:
    low, high = case.read.depth_min_m, case.read.depth_max_m
    metres = float(np.nanmedian(case.samples.metres))
    ruler, known = units_by_steps(case)
    figures = {"median_m": metres, "units_per_meter": units, "units_by_steps": ruler}
    if known is not None:
        text = f"depth steps grow with its square as a Kinect's at {ruler:.4g} per metre"
        if abs(known / units - 1) < AGREE:
            yield Evidence("depth scale", f"{text}; read as {units:g}", figures)
        else:
            remedy = f"--set read.depth_units_per_meter={known:g}"
            yield Finding("depth scale", f"{text}, but are read as {units:g}", remedy, figures)
        return
    if PLAUSIBLE_M[0] < metres < PLAUSIBLE_M[1] and low < metres < high:
        text = f"median depth {metres:.2f} m is plausible; the images have no ruler that tells more"
        yield Evidence("depth scale", text, figures)
        return
    better = min(UNITS, key=lambda u: abs(np.log(metres * units / u / USUAL_M)))
    text = f"median depth would be {metres:.3g} m at {units:g} per metre"
    yield Finding("depth scale", text, f"--set read.depth_units_per_meter={better:g}", figures)


def units_by_steps(case: Case) -> tuple[float, float | None]:
    """Stored values of a metre as depth's own steps say, NaN where they do not, and those in use that it must be."""
    steps = kinect_units(case.samples.stored)
    if steps is None:
        return np.nan, None
    counted = case.log.units_per_meter / counted_per_meter(case.log)  # stored values of what is counted as one
    ruler = steps * counted
    known = min(UNITS, key=lambda u: abs(np.log(u / ruler)))
    total = np.cumsum(case.samples.stored)
    nearest_m = int(np.searchsorted(total, 0.01 * total[-1])) * counted / known
    wide = any(probe.size[1] > WIDEST * probe.size[0] for probe in case.samples.probes)
    is_kinect = abs(ruler / known - 1) < AGREE and nearest_m >= NEAREST_M and not wide
    return (ruler, known) if is_kinect else (np.nan, None)


def kinect_units(stored: Int64) -> float | None:
    """Stored value of one metre, by steps that grow with the square of depth; None where they do not.

    ``stored`` (n,) counts how often each stored value occurs.
    """
    total = np.cumsum(stored)
    if total[-1] < 10_000:
        return None
    estimates = []
    for share in (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8):
        low = int(np.searchsorted(total, share * total[-1]))
        window = stored[low : int(low * 1.12) + 1]
        values = np.flatnonzero(window >= 0.1 * window.max())
        if values.size < 6 or (step := float(np.mean(np.diff(values)))) < COARSE:
            continue
        estimates.append(KINECT_STEP * (low + float(values.mean())) ** 2 / step)
    if len(estimates) < 3 or np.ptp(np.log(estimates)) > 2 * SPREAD:
        return None
    return float(np.median(estimates))
