"""How far two tables are apart: rows by their key, then column by column."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlmm_log.comparison.difference import NAN, Figures
from vlmm_log.entries import Column

KEYS = ("element_id", "stage")  # what a row is of


def table_figures(a: Mapping[str, Column], b: Mapping[str, Column], atol: float, rtol: float) -> Figures:
    """Cells beyond the tolerance, and rows that one side alone has. Their order counts, too."""
    keys_a, keys_b = _keys(a), _keys(b)
    common = [key for key in keys_a if key in keys_b]
    only_a, only_b = len(keys_a) - len(common), len(keys_b) - len(common)
    told = [f"rows only in {side}: {n}" for side, n in (("A", only_a), ("B", only_b)) if n]
    rows_a, rows_b = ([keys[key] for key in common] for keys in (keys_a, keys_b))
    compared = over = 0
    largest = NAN
    for name in dict.fromkeys((*a, *b)) if common else ():
        if name not in a or name not in b:
            told.append(f"column {name} only in {'A' if name in a else 'B'}")
            over += len(common)
            continue
        n, cells, most, text = _column(a[name], b[name], rows_a, rows_b, atol, rtol)
        compared, over = compared + cells, over + n
        largest = np.fmax(largest, most)
        if n:
            told.append(f"{name}: {text}")
    if not over and rows_b != sorted(rows_b):
        over, compared = 1, max(compared, 1)
        told.append("the order of the rows")
    return Figures(compared, over, only_a + only_b, largest=float(largest), told="; ".join(told))


def _keys(columns: Mapping[str, Column]) -> dict[Any, int]:
    """Key of each row -> its number; of a table without keys, the number itself."""
    key = next((columns[name] for name in KEYS if name in columns), None)
    keys = () if key is None else key if isinstance(key, tuple) else key.tolist()
    found = {value: k for k, value in enumerate(keys)}
    if key is None or len(found) < len(keys):  # without keys, or not each once
        return {k: k for k in range(len(next(iter(columns.values()), ())))}
    return found


def _column(
    a: Column, b: Column, rows_a: list[int], rows_b: list[int], atol: float, rtol: float
) -> tuple[int, int, float, str]:
    """Cells beyond the tolerance, cells in all, the largest distance, and what to say of them."""
    if isinstance(a, tuple) or isinstance(b, tuple):
        pairs = [(str(a[i]), str(b[j])) for i, j in zip(rows_a, rows_b, strict=True)]
        others = [f"{x!r} -> {y!r}" for x, y in pairs if x != y]
        return len(others), len(pairs), NAN, ", ".join(others[:3]) + (" ..." if len(others) > 3 else "")
    x, y = np.asarray(a)[rows_a], np.asarray(b)[rows_b]
    if x.dtype == y.dtype and x.tobytes() == y.tobytes():
        return 0, x.size, NAN, ""
    if x.shape != y.shape:
        return max(x.size, y.size), max(x.size, y.size), NAN, f"size {x.shape} -> {y.shape}"
    wide = x.dtype.kind in "iu" and y.dtype.kind in "iu"  # nanoseconds and digests are no floats
    apart = _whole(x, y) if wide else _distance(x.astype(np.float64), y.astype(np.float64))
    limit = atol + rtol * np.nan_to_num(np.abs(y.astype(np.float64)))
    n = int(np.count_nonzero((apart > limit) | np.isinf(apart)))
    most = float(apart.max(initial=0.0))
    return n, x.size, most if n else NAN, f"{n} of {x.size}, by {most:.4g} at most"


def _whole(x: NDArray[Any], y: NDArray[Any]) -> NDArray[np.float64]:
    return np.where(x == y, 0.0, np.abs(x.astype(np.float64) - y.astype(np.float64)).clip(min=1.0))


def _distance(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """NaN against NaN is no distance, against a number an infinite one."""
    with np.errstate(invalid="ignore"):
        apart = np.abs(x - y)
    apart[np.isnan(apart)] = np.inf
    apart[(x == y) | (np.isnan(x) & np.isnan(y))] = 0.0
    return apart
