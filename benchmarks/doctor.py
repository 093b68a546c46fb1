"""Whether `doctor` finds what is wrong, names what mends it, and is silent where nothing is.

    python -m benchmarks.doctor [FOLDER]

Every fault of tests/faults.py is made, one at a time, in a copy of the real slice, or of another folder in TUM layout;
clean logs are examined as they are. A finding counts as right where it is told under the fault's own check. Then the
remedy is applied, and doctor is to be silent. The thresholds were chosen on these logs, so of them the figures say that
nothing is broken; examples/render_room.py makes a log that they were not chosen on.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from benchmarks.data import DATA, MOVING_PAIRS, NOMINAL, SLICE, need
from vlmm_log.checks.report import sets_of
from vlmm_log.diagnosis import Diagnosis, doctor
from vlmm_log.settings import Settings

CLEAN = [SLICE, DATA / "fruit_on_table", *sorted(p for p in MOVING_PAIRS.glob("*") if p.is_dir())]
ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "tests")]
from faults import FAULTS, Fault, linked  # noqa: E402


@dataclass(frozen=True)
class Outcome:
    """Of one fault."""

    found: bool
    right: bool  # the right remedy is among those named
    besides: tuple[str, ...]  # checks that found something else
    closed: bool | None  # doctor is silent under the remedy; None where nothing was found or only the user can mend it


def main() -> None:
    source = Path(sys.argv[1]) if len(sys.argv) > 1 else SLICE
    need(source)
    false = list(_clean([source] if source != SLICE else CLEAN))
    faults = [f for f in FAULTS if f.knob != "intrinsics" or source == SLICE]  # the slice's own camera is known
    with tempfile.TemporaryDirectory() as scratch:
        _copy(source, Path(scratch) / "base")
        outcomes = [_tried(fault, Path(scratch)) for fault in faults]
    found = sum(o.found for o in outcomes)
    right = sum(o.right for o in outcomes)
    besides = sum(len(o.besides) for o in outcomes)
    closed = [o.closed for o in outcomes if o.closed is not None]
    print(f"\nrecall {found}/{len(outcomes)}; right remedy {right}/{len(outcomes)}", end="; ")
    print(f"precision {found}/{found + besides + len(false)}: {besides} other findings, {len(false)} on clean logs")
    print(f"silent under the remedy: {sum(closed)}/{len(closed)} of those found that a flag mends")


def _clean(logs: list[Path]) -> Iterator[str]:
    """False findings."""
    for path in logs:
        if not path.exists():
            continue
        sets = [f"read.intrinsics={NOMINAL}"] if path.parent == MOVING_PAIRS else []
        clock = time.perf_counter()
        found = doctor(path, settings=Settings.load(sets=sets))
        told = "; ".join(f"{f.check}: {f.message}" for f in found.findings) or "silent"
        print(f"clean  {path.name:45} {time.perf_counter() - clock:5.1f} s  {told}")
        yield from (f.check for f in found.findings)


def _tried(fault: Fault, scratch: Path) -> Outcome:
    name = fault.name.replace(" ", "_").replace(",", "").replace("freiburg3", "another")
    folder = linked(scratch / "base", scratch / (f"rgbd_dataset_freiburg1_{name}" if len(sys.argv) < 2 else name))
    fault.make(folder)
    clock = time.perf_counter()
    diagnosis = doctor(folder)
    took = time.perf_counter() - clock
    outcome = _judged(fault, folder, diagnosis)
    remedies = " | ".join(f.remedy for f in diagnosis.findings) or "nothing"
    marks = [name for name in ("found", "right") if getattr(outcome, name)]
    marks += [] if outcome.closed is None else ["silent" if outcome.closed else "NOT SILENT"]
    print(f"{'+'.join(marks) or 'MISSED':19} {fault.name:38} {took:4.1f} s  {remedies}", flush=True)
    if outcome.besides:
        print(f"{'':20}besides: {', '.join(outcome.besides)}")
    return outcome


def _judged(fault: Fault, folder: Path, diagnosis: Diagnosis) -> Outcome:
    own = [f for f in diagnosis.findings if f.check in fault.check]
    besides = tuple(f.check for f in diagnosis.findings if f.check not in fault.check)
    right = any(fault.mended_by(f.remedy) for f in own)
    closed = None
    if fault.knob and own:
        settings = Settings.load(sets=[s for f in diagnosis.findings for s in sets_of(f.remedy)])
        closed = not doctor(folder, settings=settings).findings
    return Outcome(bool(own), right, besides, closed)


def _copy(source: Path, target: Path) -> None:
    for path in source.rglob("*"):
        if path.is_file():
            place = target / path.relative_to(source)
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_bytes(path.read_bytes())


if __name__ == "__main__":
    main()
