"""The AI2-THOR rows of the movability table, made again: `python -m benchmarks.movability_table`.

Rows of our own stay, and win where both sources know a name.
"""

from __future__ import annotations

import csv
import json
from pathlib import Path

from benchmarks.data import WEIGHTS, need
from vlmm_log.models.prior import normal

TABLE = Path(__file__).resolve().parents[1] / "vlmm_log/data/movability.csv"
COUNTS = WEIGHTS / "ai2thor_types_movability.json"


def table(own: list[tuple[str, str, str]], counts: dict[str, dict[str, float]]) -> str:
    """The whole file: our rows, and AI2-THOR's of the types that these do not name; sorted by name."""
    rows = {normal(kind): (max(c["pickupable"], c["moveable"]), "AI2-THOR") for kind, c in counts.items()}
    lines = {name: f"{name},{rho:.3g},{source}" for name, (rho, source) in rows.items()}
    lines |= {name: f"{name},{rho},{source}" for name, rho, source in own}
    return "\n".join(["name,rho,source", *(lines[name] for name in sorted(lines)), ""])


def own_rows(path: Path) -> list[tuple[str, str, str]]:
    """Name, rho and source of the rows of our own."""
    with path.open(encoding="utf-8", newline="") as f:
        rows = [(r["name"], r["rho"], r["source"]) for r in csv.DictReader(f)]
    return [row for row in rows if row[2] != "AI2-THOR"]


if __name__ == "__main__":
    need(COUNTS)
    TABLE.write_text(table(own_rows(TABLE), json.loads(COUNTS.read_text("utf-8"))), "utf-8")
