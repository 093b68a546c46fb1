"""``vlmm-log diff`` of two folders of ``batch``."""

from __future__ import annotations

import json
import sys
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import click

from vlmm_log.commands.exits import FOUND
from vlmm_log.commands.telling import tell
from vlmm_log.progress import progress

if TYPE_CHECKING:
    from vlmm_log.compare_batches import BatchDifference
    from vlmm_log.comparison.tolerance import Choice, Tolerance


def tell_batches(
    a: Path, b: Path, tolerance: Tolerance, choice: Choice, json_file: Path | None, *, force: bool
) -> None:
    """Compare log by log, and print or write it."""
    from vlmm_log.compare_batches import diff_batches
    from vlmm_log.outputs import claim, replacing

    printed = json_file == Path("-")
    if json_file is not None and not printed:
        claim([json_file], force=force)
    with progress("logs") as told:
        done = diff_batches(a, b, tolerance=tolerance, choice=choice, progress=told)
    text = json.dumps(done.report(), indent=1) + "\n"
    if printed:
        click.echo(text, nl=False)
    else:
        print_batch_difference(done)
    if json_file is not None and not printed:
        with replacing(json_file, force=force) as (partial,):
            partial.write_text(text, encoding="utf-8")
        tell(f"wrote {json_file}")
    if not done.same:
        sys.exit(FOUND)


def print_batch_difference(d: BatchDifference) -> None:
    """A line a log."""
    tell(f"A {d.a}", f"B {d.b}")
    tell(*(f"{log.name}: {log.verdict}{': ' if log.told else ''}{log.told}" for log in d.logs))
    counts = Counter(log.verdict for log in d.logs)
    tell(f"{len(d.logs)} logs: {', '.join(f'{n} {verdict}' for verdict, n in counts.most_common())}")
