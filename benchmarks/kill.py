"""SIGKILL at random moments of process, convert and batch: what was left, and whether the rest could be done.

    python -m benchmarks.kill [--kills N] [--seed S] [--only TEXT]

Exit code 1: a promise was broken; it is named with its number. Linux only; the log is a small rendered room.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.data import ROOT

sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "examples")]
from killing import DEEDS, FOUND, BrokenPromiseError, trial, whole  # noqa: E402
from small_room import write_small_room  # noqa: E402


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="of the commands")
    arguments = parser.parse_args()
    deeds = [deed for deed in DEEDS if arguments.only in deed.name]
    counts = {deed.name: Counter[str]() for deed in deeds}
    broken = []
    with tempfile.TemporaryDirectory(prefix="vlmm-log-kill-") as folder:
        room = Path(folder) / "room"
        write_small_room(room, 12)
        good = whole(room, Path(folder) / "whole", tuple(deeds))
        for k in range(arguments.kills):
            deed = deeds[k % len(deeds)]
            there = Path(folder) / str(k)
            try:
                counts[deed.name][trial(deed, room, there, good, np.random.default_rng([arguments.seed, k]))] += 1
            except BrokenPromiseError as e:
                broken.append(f"kill {k} of {deed.name}: {e}")
            shutil.rmtree(there, ignore_errors=True)
    table = Table("command", "kills", "nothing yet", "begun", "partial readable", "already done", "then equal")
    for name, found in counts.items():
        table.add_row(name, *map(str, (found.total(), *(found[kind] for kind in FOUND), found.total())))
    Console().print(table)
    print(f"{arguments.kills} kills, {len(broken)} broken promises", *broken, sep="\n")
    sys.exit(bool(broken))


if __name__ == "__main__":
    main()
