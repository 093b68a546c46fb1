"""A difference as plain values, and as JSON: docs/diff.schema.json describes it."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from vlmm_log.comparison.difference import Change, Difference, EntityDifference, Figures, FrameDifference, Place

FORMAT, VERSION = "vlmm-log diff", 1


def report(d: Difference) -> dict[str, Any]:
    """The whole difference. Numbers that are not known are None."""
    first = d.first
    return {
        "format": FORMAT,
        "version": VERSION,
        "a": d.a,
        "b": d.b,
        "same": d.same,
        "settings": [_change(c) for c in d.settings],
        "inputs": [_change(c) for c in d.inputs],
        "about": [_change(c) for c in d.about],
        "frames": dict(zip(("a", "b", "both"), d.frames, strict=True)),
        "missing": list(d.missing),
        "first": first and {**_place(first.at), "stage": first.stage, "entity": first.entity},
        "stages": [{"stage": s.stage, "frames": s.frames, "first": _place(s.first)} for s in d.stages],
        "entities": [_entity(e) for e in d.entities],
        "elements": {
            "matched": d.elements.matched,
            "changes": [
                {"a": c.a, "b": c.b, "label": c.label, "kinds": list(c.kinds), "told": c.told}
                for c in d.elements.changes
            ],
        },
        "queries": [
            {"query": q.query, "ranks": [{"element": e, "a": a, "b": b} for e, a, b in q.ranks]} for q in d.queries
        ],
    }


def write_json(path: Path, d: Difference) -> None:
    """The report as a file."""
    path.write_text(json.dumps(report(d), indent=1, allow_nan=False) + "\n", "utf-8")


def _change(c: Change) -> dict[str, Any]:
    return {"name": c.name, "a": _plain(c.a), "b": _plain(c.b)}


def _plain(value: object) -> object:
    """A setting as JSON has it: there is no infinity."""
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


def _place(at: Place) -> dict[str, Any]:
    return {"frame": at.index, "time_ns": at.stamp_ns}


def _entity(e: EntityDifference) -> dict[str, Any]:
    return {
        "entity": e.entity,
        "stage": e.stage,
        "compared": e.compared,
        "differing": len(e.frames),
        "only_a": [_place(p) for p in e.only_a],
        "only_b": [_place(p) for p in e.only_b],
        "first": _place(e.first),
        "worst": e.worst and _frame(e.worst),
        "over_share": e.over_share,
        "unmatched": e.unmatched,
        "largest": _known(e.largest),
        "frames": [_frame(f) for f in e.frames],
    }


def _frame(f: FrameDifference) -> dict[str, Any]:
    return {**_place(f.at), **_figures(f.figures)}


def _figures(n: Figures) -> dict[str, Any]:
    return {
        "compared": n.compared,
        "over": n.over,
        "unmatched": n.unmatched,
        "p50": _known(n.p50),
        "p95": _known(n.p95),
        "max": _known(n.largest),
        "unit": n.unit,
        "told": n.told,
    }


def _known(x: float) -> float | str | None:
    """Infinity, as of NaN against a number in a table, has no number in JSON."""
    return None if math.isnan(x) else "infinite" if math.isinf(x) else x
