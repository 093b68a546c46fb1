"""From scores to probabilities: curves fitted on logs with truth, kept in a file that ``process`` takes. numpy only."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlmm_log.settings import Settings
from vlmm_log.types import Float32, Float64, InputError, freeze

FORMAT, VERSION = "vlmm-log calibration", 1


@dataclass(frozen=True, eq=False)
class Curve:
    """A probability that rises with a score: linear between knots, constant beyond."""

    x: Float64  # (k,) scores, ascending
    p: Float64  # (k,) probabilities, not falling

    def __post_init__(self) -> None:
        freeze(self)

    def __call__(self, score: NDArray[np.floating[Any]]) -> Float32:
        """Probability of each score; NaN stays NaN."""
        return np.asarray(np.interp(score, self.x, self.p), np.float32)


@dataclass(frozen=True, eq=False)
class Calibration:
    """What was fitted, and on what."""

    pixel: Curve  # of d_M: the point moves
    element: Curve | None  # of the motion evidence: the element has moved; None where the truth had no things
    settings: Mapping[str, object]  # name -> value of every setting that decides the scores
    fitted_on: tuple[str, ...]  # logs, with the hash of their input
    static_d_m2: float  # median over static pixels; 2.366 where Sigma fits
    sigma_z: tuple[float, float] | None  # a m, b 1/m of the sensor's own sigma_z, as its static pixels have it

    def to_json(self) -> str:
        """The file."""
        curves = {"pixel": self.pixel, "element": self.element}
        return (
            json.dumps(
                {
                    "format": FORMAT,
                    "version": VERSION,
                    **{n: None if c is None else {"x": c.x.tolist(), "p": c.p.tolist()} for n, c in curves.items()},
                    "settings": dict(self.settings),
                    "fitted_on": list(self.fitted_on),
                    "static_d_m2": self.static_d_m2,
                    "sigma_z": self.sigma_z,
                },
                indent=1,
            )
            + "\n"
        )


DECIDING = ("keyframes", "flow", "gate", "noise", "ego", "objects", "tracks", "map")


def deciding(s: Settings) -> dict[str, object]:
    """Every setting that scores depend on, by name: a curve holds for these alone. Paths are left out."""
    tables = {name: vars(getattr(s, name)) for name in DECIDING}
    left_out = {"flow.weights", "objects.segmenter", "objects.yolo_names", "objects.embedder", "objects.prior"}
    named = {f"{table}.{name}": value for table, values in tables.items() for name, value in values.items()}
    return {name: value for name, value in named.items() if name not in left_out}


def load_calibration(path: Path) -> Calibration:
    """Of a file. Raises InputError where it is none, or its curves are no curves."""
    try:
        table = json.loads(path.read_text("utf-8"))
        if table.get("format") != FORMAT or table.get("version") != VERSION:
            raise ValueError(f"its format is not {FORMAT} {VERSION}")
        element = table["element"]
        return Calibration(
            _curve(table["pixel"]),
            None if element is None else _curve(element),
            dict(table["settings"]),
            tuple(str(x) for x in table["fitted_on"]),
            float(table["static_d_m2"]),
            None if table["sigma_z"] is None else (float(table["sigma_z"][0]), float(table["sigma_z"][1])),
        )
    except (OSError, ValueError, LookupError, TypeError, AttributeError, OverflowError, RecursionError) as e:
        raise InputError(f"{path}: no calibration: {e}; make one with vlmm-log eval LOG --calibrate FILE") from e


def _curve(table: Mapping[str, object]) -> Curve:
    x, p = np.asarray(table["x"], np.float64), np.asarray(table["p"], np.float64)
    rises = x.ndim == 1 and x.shape == p.shape and x.size > 0 and (np.diff(x) > 0).all() and (np.diff(p) >= 0).all()
    if not (rises and np.isfinite(x).all() and ((p >= 0) & (p <= 1)).all()):
        raise ValueError("a curve is no rising list of probabilities")
    return Curve(x, p)
