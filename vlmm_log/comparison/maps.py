"""Two maps: which element of one is which of the other, and what became of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlmm_log.comparison.difference import ElementChange, ElementsDifference, QueryDifference
from vlmm_log.entries import Column, Table

NEAR_M = 0.5  # elements of different ids that are farther apart are not the same
OTHER_LABEL = 1.0  # what a different label costs, in NEAR_M: only one of the same place outweighs it
FIGURES = ("o", "kappa", "rho", "confidence", "score", "speed", "p_stat", "p_moving")
TEXTS = ("rho_source",)
Columns = Mapping[str, Column]


def elements_difference(a: Table | None, b: Table | None, atol: float, rtol: float) -> ElementsDifference:
    """Elements matched by id, then across ids by position and label; what was added, removed, or is not as it was."""
    x, y = (_ready(table.columns) if table is not None and len(table) else None for table in (a, b))
    pairs = [] if x is None or y is None else matched(x, y)
    changes = [] if x is None or y is None else [_change(x, y, i, j, atol, rtol) for i, j in pairs]
    lost = set(range(0 if a is None else len(a))) - {i for i, _ in pairs}
    new = set(range(0 if b is None else len(b))) - {j for _, j in pairs}
    changes += [_alone(x, i, "removed") for i in sorted(lost) if x is not None]
    changes += [_alone(y, j, "added") for j in sorted(new) if y is not None]
    return ElementsDifference(len(pairs), tuple(change for change in changes if change is not None))


def _ready(columns: Columns) -> Columns:
    """The numbers that are compared as arrays of double precision: made once, not for each element."""
    numbers = {name: np.asarray(columns[name], np.float64) for name in ("position", *FIGURES) if name in columns}
    return {**columns, **numbers}


def _ids(columns: Columns) -> list[int]:
    return [int(i) for i in columns["element_id"]]


def matched(a: Columns, b: Columns) -> list[tuple[int, int]]:
    """Rows that are one thing: of the same id, if near or of the same label, then the nearest by place and label."""
    number = {i: j for j, i in enumerate(_ids(b))}
    same = [(i, number[key]) for i, key in enumerate(_ids(a)) if key in number]
    pairs = [(i, j) for i, j in same if _apart(a, b, i, j) <= NEAR_M or a["label"][i] == b["label"][j]]
    rest_a = sorted(set(range(len(a["label"]))) - {i for i, _ in pairs})
    rest_b = sorted(set(range(len(b["label"]))) - {j for _, j in pairs})
    return sorted(pairs + _assigned(a, b, rest_a, rest_b))


def _assigned(a: Columns, b: Columns, rest_a: list[int], rest_b: list[int]) -> list[tuple[int, int]]:
    """The cheapest pairs of what is near, among each group that hangs together: groups are few elements each."""
    from scipy.optimize import linear_sum_assignment
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    rest_a, rest_b = _placed(a, rest_a), _placed(b, rest_b)
    if not rest_a or not rest_b:
        return []
    trees = cKDTree(_positions(a)[rest_a]), cKDTree(_positions(b)[rest_b])
    near = trees[0].sparse_distance_matrix(trees[1], NEAR_M, output_type="ndarray")
    other = np.array(
        [a["label"][rest_a[i]] != b["label"][rest_b[j]] for i, j in zip(near["i"], near["j"], strict=True)]
    )
    cost = near["v"] / NEAR_M + OTHER_LABEL * other
    allowed = cost <= 1.5  # another label only at half the distance
    i, j, cost = near["i"][allowed], near["j"][allowed], cost[allowed]
    n = len(rest_a) + len(rest_b)
    graph = coo_array((np.ones(i.size, np.int8), (i, j + len(rest_a))), shape=(n, n))
    group = connected_components(graph, directed=False)[1][i]
    pairs = []
    for edges in np.split(np.argsort(group, kind="stable"), np.flatnonzero(np.diff(np.sort(group))) + 1):
        rows, row = np.unique(i[edges], return_inverse=True)
        columns, column = np.unique(j[edges], return_inverse=True)
        table = np.full((rows.size, columns.size), 1e6)
        table[row, column] = cost[edges]
        chosen = zip(*linear_sum_assignment(table), strict=True)
        pairs += [(rest_a[rows[r]], rest_b[columns[c]]) for r, c in chosen if table[r, c] < 1e6]
    return pairs


def _placed(columns: Columns, rows: list[int]) -> list[int]:
    """Those whose position is known: of a damaged map it may be none."""
    return [i for i in rows if np.isfinite(_positions(columns)[i]).all()]


def _positions(columns: Columns) -> NDArray[np.float64]:
    return np.asarray(columns["position"], np.float64).reshape(-1, 3)


def _apart(a: Columns, b: Columns, i: int, j: int) -> float:
    return float(np.linalg.norm(_positions(a)[i] - _positions(b)[j]))


def _alone(columns: Columns, row: int, kind: str) -> ElementChange:
    i, label = int(columns["element_id"][row]), str(columns["label"][row])
    told = (
        f"{columns['motion_class'][row]}, o {float(columns['o'][row]):.2f}, {int(columns['observations'][row])} pairs"
    )
    a, b = (i, None) if kind == "removed" else (None, i)
    return ElementChange(a, b, label, (kind,), told)


def _change(a: Columns, b: Columns, i: int, j: int, atol: float, rtol: float) -> ElementChange | None:
    kinds, told = [], []
    metres = _apart(a, b, i, j)
    if _beyond(_positions(a)[i], _positions(b)[j], atol, rtol):
        kinds.append("moved")
        told.append(f"by {100 * metres:.3g} cm")
    if a["label"][i] != b["label"][j]:
        kinds.append("relabelled")
        told.append(f"{a['label'][i]!r} -> {b['label'][j]!r}")
    if a["motion_class"][i] != b["motion_class"][j]:
        kinds.append("flipped")
        told.append(f"{a['motion_class'][i]} -> {b['motion_class'][j]}")
    figures = [name for name in FIGURES if _beyond(_figure(a, name, i), _figure(b, name, j), atol, rtol)]
    figures += [name for name in TEXTS if a[name][i] != b[name][j]]
    figures += ["observations"] if int(a["observations"][i]) != int(b["observations"][j]) else []
    if figures:
        kinds.append("changed")
        told += [f"{name} {_both(_value(a, name, i), _value(b, name, j))}" for name in figures]
    ids = int(a["element_id"][i]), int(b["element_id"][j])
    if not kinds and ids[0] == ids[1]:
        return None
    classes = (str(a["motion_class"][i]), str(b["motion_class"][j])) if "flipped" in kinds else ()
    return ElementChange(*ids, str(a["label"][i]), tuple(kinds or ["renumbered"]), ", ".join(told), classes)


def _figure(columns: Columns, name: str, row: int) -> NDArray[Any]:
    """One figure; NaN where the run gave none."""
    if name not in columns:
        return np.full(1, np.nan)
    return np.asarray(columns[name], np.float64)[row : row + 1]


def _beyond(a: NDArray[Any], b: NDArray[Any], atol: float, rtol: float) -> bool:
    both_nan = np.isnan(a) & np.isnan(b)
    return bool((~(np.abs(a - b) <= atol + rtol * np.abs(b)) & ~both_nan).any())


def _value(columns: Columns, name: str, row: int) -> Any:
    """One value; NaN where the run gave none."""
    return columns[name][row] if name in columns else float("nan")


def _both(x: Any, y: Any) -> str:
    """Two values that differ, in as many digits as show it."""
    if not isinstance(x, float | np.floating):
        return f"{x} -> {y}"
    digits = next((n for n in range(3, 17) if f"{x:.{n}g}" != f"{y:.{n}g}"), 17)
    return f"{x:.{digits}g} -> {y:.{digits}g}"


def query_difference(query: str, a: Table | None, b: Table | None) -> QueryDifference | None:
    """Ranks of a query's last answers, by element id; None where they are the same."""
    ranks = [{i: k + 1 for k, i in enumerate(_ids(t.columns) if t is not None and len(t) else [])} for t in (a, b)]
    if ranks[0] == ranks[1]:
        return None
    elements = sorted(ranks[0].keys() | ranks[1].keys(), key=lambda i: (ranks[0].get(i, 1 << 30), i))
    told = ((f"element {i}", ranks[0].get(i), ranks[1].get(i)) for i in elements)
    return QueryDifference(query, tuple(row for row in told if row[1] != row[2]))
