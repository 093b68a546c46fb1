"""Run one log twice with other settings, and fail where d_M moved by more than a tolerance: a check for CI.

    python examples/diff_two_runs.py LOG [A.B=VALUE ...] [--atol 0.5]

Without a setting both runs are alike, and so must be their results, to the bit.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

from vlmm_log import Settings, diff, process
from vlmm_log.comparison.tolerance import Choice, Tolerance
from vlmm_log.comparison.words import summary

D_M = "world/camera/image/residual/d_m"


def moved(log: Path, sets: list[str], atol: float, folder: Path) -> list[str]:
    """What differs in d_M beyond the tolerance, in words; none: nothing does."""
    before = process(log, rrd=folder / "before.rrd", settings=Settings.load())
    after = process(log, rrd=folder / "after.rrd", settings=Settings.load(sets=sets))
    tolerance, choice = Tolerance(atol), Choice(only=(D_M, "settings"))
    done = diff(before.outputs[0], after.outputs[0], tolerance=tolerance, choice=choice, rrd="two_runs.rrd", force=True)
    return summary(done) if done.entities else []


def main() -> None:
    """Parse, compare, say, and end with 1 where it moved."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("log", type=Path)
    parser.add_argument("sets", nargs="*", metavar="A.B=VALUE")
    parser.add_argument("--atol", type=float, default=0.0, help="sigmas that d_M may move by")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        lines = moved(arguments.log, arguments.sets, arguments.atol, Path(folder))
    print("\n".join(lines) or "d_M is the same")
    print("side by side: vlmm-log view two_runs.rrd")
    sys.exit(bool(lines))


if __name__ == "__main__":
    main()
