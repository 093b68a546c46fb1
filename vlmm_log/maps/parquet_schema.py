"""Columns of a map as Parquet."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pyarrow as pa

from vlmm_log.elements import OBSERVATION

SCALARS = {  # columns of the fused part that are fields of Element
    "label": pa.string(),
    "o": pa.float64(),
    "kappa": pa.float64(),
    "p_stat": pa.float64(),
    "score": pa.float64(),
    "speed": pa.float64(),
    "rho": pa.float64(),
    "rho_source": pa.string(),
    "confidence": pa.float64(),
}
CALIBRATED = {**SCALARS, "p_moving": pa.float64()}  # of a run with a calibration


def _vector(kind: pa.DataType, length: int) -> pa.DataType:
    """A list of so many numbers; Parquet has none of length 0, so that is a list of any length."""
    return pa.list_(pa.field("element", kind, nullable=False), length or -1)


def _rows(kind: pa.DataType) -> pa.DataType:
    return pa.list_(pa.field("element", kind, nullable=False))


def _struct(**kinds: pa.DataType) -> pa.DataType:
    return pa.struct([pa.field(name, kind, nullable=False) for name, kind in kinds.items()])


def _of_numpy(kind: np.dtype[Any]) -> pa.DataType:
    scalar = pa.from_numpy_dtype(kind.base)
    return _vector(scalar, *kind.shape) if kind.shape else scalar


OBSERVATIONS = _rows(_struct(**{name: _of_numpy(OBSERVATION[name]) for name in OBSERVATION.names or ()}))


def schema(feature_width: int, scalars: Mapping[str, pa.DataType] = SCALARS) -> pa.Schema:
    """Columns of a map whose semantic features have so many numbers."""
    fused = {
        "position": _vector(pa.float32(), 3),
        "extent": _vector(pa.float32(), 6),
        "motion_class": pa.string(),
        **scalars,
        "intervals": _rows(_struct(start_ns=pa.int64(), stop_ns=pa.int64())),
    }
    seen = {
        "votes": _rows(_struct(label=pa.string(), thousandths=pa.int64())),
        "feature_pixels": pa.int64(),
        "feature_index": pa.int64(),
        "semantic_feat": _vector(pa.float32(), feature_width),
        "observations": OBSERVATIONS,
    }
    fields = [pa.field("id", pa.int64(), nullable=False)]
    fields += [pa.field(name, kind, nullable=True) for name, kind in fused.items()]
    fields += [pa.field(name, kind, nullable=False) for name, kind in seen.items()]
    return pa.schema(fields)
