"""``vlmm-log doctor``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from vlmm_log.commands.examples import examples
from vlmm_log.commands.exits import FOUND
from vlmm_log.commands.options import AS_JSON, READING, SOURCE, added, as_settings
from vlmm_log.commands.telling import show, tell
from vlmm_log.progress import progress

if TYPE_CHECKING:
    from vlmm_log.diagnosis import Diagnosis
    from vlmm_log.settings import Settings


@click.command(
    epilog=examples(
        "vlmm-log doctor walking.bag",
        "vlmm-log doctor room --intrinsics freiburg1 --start 10 --stop 40",
    )
)
@SOURCE
@added(*READING)
@AS_JSON
@as_settings
def doctor(source: Path, as_json: bool, settings: Settings) -> None:
    """Check SOURCE's conventions from its data, and name the flag that mends what is wrong. Exit code 1: findings.

    Inverted poses, quaternion order, axes, the pose-to-camera transform, depth scale, colour-depth registration, time
    offsets, intrinsics, duplicated and unsynchronised frames.
    """
    from vlmm_log.diagnosis import doctor as run

    with progress("checks") as told:
        diagnosis = run(source, settings=settings, progress=told)
    show(diagnosis, print_diagnosis, as_json=as_json)
    if diagnosis.findings:
        sys.exit(FOUND)


def print_diagnosis(diagnosis: Diagnosis) -> None:
    """Findings with their remedies, then what was examined."""
    for finding in diagnosis.findings:
        tell(f"FOUND {finding.check}: {finding.message}", f"      mend it: {finding.remedy}")
    tell(*(f"  {seen.check}: {seen.message}" for seen in diagnosis.evidence))
    if not diagnosis.findings:
        tell("nothing found that contradicts the data")
