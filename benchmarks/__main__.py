"""All benchmarks of speed and memory in one run, as ratios; a line of JSON is kept, so that the next run shows changes.

    python -m benchmarks [--short] [--history FILE]

Nothing here fails on a slow machine. Figures move by a tenth from run to run, more on a busy machine: ratios count.
"""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path

from benchmarks import containers, growth, memory, objects, pairs, stages
from benchmarks.rows import last, machine, remember, shown
from vlmm_log.version import __version__

BOTH = {
    "stages of a pair, one thread": stages.measured,
    "objects of a pair, 30 masks": objects.measured,
    "growth of the cost": growth.measured,
}
FULL = {
    "pairs a second": pairs.measured,
    "containers": containers.measured,
    "memory against length": memory.measured,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--short", action="store_true", help="small inputs, for a look in CI")
    parser.add_argument("--history", type=Path, default=Path("benchmarks.jsonl"), help="lines of JSON, one a run")
    arguments = parser.parse_args()
    form = "short" if arguments.short else "full"
    before = last(arguments.history, form)
    print(f"vlmm-log {__version__}, {machine()}; changes since the last run in {arguments.history}")
    figures = {}
    parts = {part: partial(measured, arguments.short) for part, measured in BOTH.items()}
    for part, measured in (parts if arguments.short else parts | FULL).items():
        for row in shown(part, measured(), before):
            figures[f"{part}: {row.name}"] = row.value
    remember(arguments.history, form, figures, __version__)


if __name__ == "__main__":
    main()
