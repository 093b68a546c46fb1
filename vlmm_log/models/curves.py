"""The calibration that settings name: it holds for the settings that it was fitted with, and for no others."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from vlmm_log.calibration import Calibration, deciding, load_calibration
from vlmm_log.models.weights import fingerprint
from vlmm_log.settings import Settings
from vlmm_log.types import InputError


def load_curves(s: Settings) -> tuple[Calibration | None, dict[str, str]]:
    """The calibration and its fingerprint; None where the settings name none.

    Raises InputError where the file is none, and where it was fitted with other settings.
    """
    if not s.calibration.file:
        return None, {}
    path = Path(s.calibration.file)
    calibration = load_calibration(path)
    fault = _fitted_otherwise(calibration.settings, deciding(s))
    if fault:
        raise InputError(f"{path}: {fault}")
    return calibration, {"calibration": fingerprint(path)}


def origin(c: Calibration) -> str:
    """Where a calibration comes from, to judge whether it fits the log."""
    told = f"calibration: fitted on {', '.join(c.fitted_on)}; static d_M^2 {c.static_d_m2:.2f} (2.366 expected)"
    if c.sigma_z is None:
        return told
    return f"{told}; its sensor's sigma_z a {c.sigma_z[0]:.5f} m, b {c.sigma_z[1]:.5f} 1/m"


def _fitted_otherwise(fitted: Mapping[str, object], here: Mapping[str, object]) -> str:
    """What of the settings is not as the curves were fitted with, and what to do; "" where all are."""
    differ = [name for name in dict.fromkeys((*here, *fitted)) if fitted.get(name) != here.get(name)]
    if not differ:
        return ""
    name, others = differ[0], len(differ) - 1
    more = f" ({others} more {'differ' if others > 1 else 'differs'})" if others else ""
    if name not in fitted or name not in here:
        which = "without" if name not in fitted else "with"
        return f"fitted {which} {name}, by another version{more}; fit it anew with vlmm-log eval LOG --calibrate FILE"
    was, now = _short(fitted[name]), _short(here[name])
    return f"fitted with {name} = {was}, this run has {now}{more}; fit it anew or --set {name}={was}"


def _short(value: object) -> object:
    """1.0 as 1."""
    return f"{value:g}" if isinstance(value, float) and float(f"{value:g}") == value else value
