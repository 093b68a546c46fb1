"""``vlmm-log convert``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from vlmm_log.commands.examples import examples
from vlmm_log.commands.options import AS_JSON, FILE, FORCE, READING, SOURCE, added, as_settings
from vlmm_log.commands.telling import show, tell
from vlmm_log.progress import progress

if TYPE_CHECKING:
    from vlmm_log.conversion import Converted
    from vlmm_log.settings import Settings


@click.command(
    epilog=examples(
        "vlmm-log convert rgbd_dataset_freiburg1_xyz xyz.mcap",
        "vlmm-log convert walking.bag tum/",
        "vlmm-log convert walking.bag small.mcap --compressed",
    )
)
@SOURCE
@added(*READING)
@click.argument("out", type=FILE)
@click.option("--to", help="mcap, bag, ros2, ros2-mcap or tum; if not given, by OUT's name.")
@click.option("--compressed", is_flag=True, help="Encoded colour and compressedDepth instead of bare pixels.")
@FORCE
@AS_JSON
@as_settings
def convert(
    source: Path, out: Path, to: str | None, compressed: bool, force: bool, as_json: bool, settings: Settings
) -> None:
    """Write SOURCE's images and poses into another container: OUT.mcap, OUT.bag, a ROS 2 bag folder or a TUM folder.

    Without loss: depth, poses and stamps come back bit for bit.
    """
    from vlmm_log.conversion import convert as run

    form = "compressed" if compressed else "raw"
    with progress("images") as told:
        done = run(source, out, settings=settings, to=to or "", images=form, force=force, progress=told)
    show(done, print_converted, as_json=as_json)


def print_converted(done: Converted) -> None:
    """What was written."""
    tell(*(f"  {name}: {count}" for name, count in done.counts.items()))
    tell(*(f"  {note}" for note in done.notes))
    tell(*(f"  noted: {reason}, {n} times" for reason, n in sorted(done.skipped.items())))
    tell(f"wrote {done.out}")
