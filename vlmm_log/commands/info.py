"""``vlmm-log info``."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from vlmm_log.commands.examples import examples
from vlmm_log.commands.options import AS_JSON, READING, SOURCE, added, as_settings
from vlmm_log.commands.telling import known, print_rows, show, tell

if TYPE_CHECKING:
    from vlmm_log.settings import Settings
    from vlmm_log.survey import Info


@click.command(
    epilog=examples(
        "vlmm-log info walking.bag",
        "vlmm-log info walking.bag --topics depth=/camera/depth/image",
    )
)
@SOURCE
@added(*READING)
@AS_JSON
@as_settings
def info(source: Path, as_json: bool, settings: Settings) -> None:
    """Say what SOURCE holds: topics or lists, rates, sizes, intrinsics, poses, gaps."""
    from vlmm_log.survey import info as run

    told = run(source, settings=settings)
    show(told, print_info, as_json=as_json)


def print_info(told: Info) -> None:
    """What a log holds."""
    head = ("", "stream", "type", "count", "Hz", "longest gap")
    rows = [
        (x.role, x.name, x.type, known(x.count), known(x.rate_hz, "{:.2f}"), known(x.longest_gap_s, "{:.3f} s"))
        for x in told.streams
    ]
    print_rows(f"{told.source} ({told.reader})", head, rows, left=3)
    tell(*(f"  {line}" for line in _lines(told)))


def _lines(told: Info) -> Iterator[str]:
    if told.problem:
        yield f"{told.span_s:.1f} s; gives no frames as it is: {told.problem}"
    else:
        yield f"about {told.frames} frames in {told.span_s:.1f} s"
    if told.first is not None:
        f = told.first
        yield (
            f"first frame {f.width}x{f.height} at {f.stamp_ns} ns, {f.depth_seen:.0%} of its pixels with depth, "
            f"median {f.depth_median_m:.2f} m"
        )
    elif not told.problem:
        yield "no frame could be read: `vlmm-log doctor` looks for the reason"
    yield f"poses: {told.poses or 'none'}"
    yield from told.notes
    yield from (f"noted: {reason}, {count} times" for reason, count in sorted(told.skipped.items()))
    yield from (f"for {role}, best first: {'; '.join(c)}" for role, c in told.candidates.items() if len(c) > 1)
