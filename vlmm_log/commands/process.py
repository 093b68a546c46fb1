"""``vlmm-log process``."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from vlmm_log.commands.examples import examples
from vlmm_log.commands.exits import INTERRUPTED
from vlmm_log.commands.options import AS_JSON, FILE, FORCE, QUERIES, READING, SOURCE, added, as_settings, method
from vlmm_log.commands.telling import print_rows, show, tell
from vlmm_log.progress import progress

if TYPE_CHECKING:
    from vlmm_log.processed import Processed
    from vlmm_log.settings import Settings

ROWS = {  # figure -> what the table calls it, how it is written
    "pairs": ("pairs", "{:.0f}"),
    "unreliable_pairs": ("pairs with unreliable ego-motion", "{:.0f}"),
    "coverage": ("coverage (pixels scored)", "{:.1%}"),
    "flagged_share": ("flagged (d_M above tau_px)", "{:.2%}"),
    "static_d_m2_median": ("d_M^2 median (2.366 expected of a still world)", "{:.2f}"),
    "calibrating_noise_scale": ("noise.scale that would make it 2.366", "{:.2f}"),
    "residual_median_m": ("residual median", "{:.4f} m"),
    "instances": ("instances a frame", "{:.0f}"),
    "ego_inlier_share": ("ego-refinement inliers", "{:.1%}"),
    "flow_ms": ("flow", "{:.1f} ms"),
    "matches_ms": ("noise of the matches", "{:.1f} ms"),
    "ego_ms": ("ego-refinement", "{:.1f} ms"),
    "motion_ms": ("motion channel", "{:.1f} ms"),
    "posterior_ms": ("calibrated probabilities", "{:.1f} ms"),
    "segments_ms": ("segmenter", "{:.1f} ms"),
    "embed_ms": ("embedder", "{:.1f} ms"),
    "aggregate_ms": ("observations", "{:.1f} ms"),
    "associate_ms": ("association", "{:.1f} ms"),
    "map_ms": ("map and fusion", "{:.1f} ms"),
}


@click.command(
    epilog=examples(
        "vlmm-log process rgbd_dataset_freiburg3_walking_xyz",
        "vlmm-log process walking.bag --stop 15 --rrd out.rrd --map map.json",
        'vlmm-log process room --query "things that moved" --workers 4',
    )
)
@SOURCE
@added(*READING)
@click.option("--rrd", type=FILE, help="Rerun recording to write; SOURCE-name.rrd if no recording is named.")
@click.option("--mcap", type=FILE, help="MCAP file to write: the same content as messages.")
@click.option("--mcap-schema", type=click.Choice(["ros2", "foxglove"]), default="ros2", show_default=True)
@click.option("--map", "map_file", type=FILE, help="Map to write: .json, .parquet or .ply.")
@QUERIES
@method("geometric (default), yolo:FILE.onnx, masks:FOLDER or none.")
@click.option("--workers", type=click.IntRange(1), default=1, show_default=True, help="Processes that share the work.")
@click.option("--resume", is_flag=True, help="Keep what pairs show until all is written; go on where such a run ended.")
@FORCE
@AS_JSON
@as_settings
def process(
    source: Path,
    rrd: Path | None,
    mcap: Path | None,
    mcap_schema: str,
    map_file: Path | None,
    queries: tuple[str, ...],
    workers: int,
    resume: bool,
    force: bool,
    as_json: bool,
    settings: Settings,
) -> None:
    """Run the method on every keyframe pair of SOURCE and record every intermediate.

    SOURCE is a folder in TUM RGB-D or Bonn layout, rgb/ and depth/ folders with or without poses, 7-Scenes frames, a
    .bag, a ROS 2 bag folder, a .db3 or an .mcap.
    """
    from vlmm_log.api import process as run
    from vlmm_log.heap import keep_pages

    if rrd is None and mcap is None:
        named = os.path.abspath(source)  # noqa: PTH100  a link keeps its name
        rrd = Path(f"{Path(named).name}.rrd")  # the closing table names it
    keep_pages()
    with progress("pairs", compiles=True) as told:
        done = run(
            source,
            rrd=rrd,
            mcap=mcap,
            map=map_file,
            mcap_schema=mcap_schema,
            queries=queries,
            settings=settings,
            force=force,
            progress=told,
            workers=workers,
            resume=resume,
        )
    show(done, print_processed, as_json=as_json)
    if done.resumed:
        click.echo(f"went on after {done.resumed} pairs of an earlier run", err=True)
    if not done.end.complete:
        again = "the same command goes on from here" if resume else "with --resume it could go on from here"
        click.echo(f"interrupted: {again}", err=True)
        sys.exit(INTERRUPTED)


def print_processed(done: Processed) -> None:
    """The closing figures of a run."""
    print_figures(done)
    tell(done.elements_told())
    for found in done.answers:
        names = ", ".join(f"{i} {done.map.world.elements[i].label}".strip() for i in found.ids[:10].tolist())
        tell(f"{found.text!r}: {found.matches} of the map's elements{': ' if names else ''}{names}")
    tell(*(f"  {note}" for note in (*done.run.notes, *done.end.told)))
    for path in done.outputs:
        size = path.stat().st_size / 1e6
        state = "" if done.end.complete else " (interrupted: readable up to the last pair)"
        tell(f"wrote {path}{state}, {size:.1f} MB")
    if not done.end.complete and not done.outputs:
        tell("interrupted before the first pair: nothing was kept")


def print_figures(done: Processed) -> None:
    """The table of a run."""
    figures = done.summary.figures()
    rows = [(label, form.format(figures[name])) for name, (label, form) in ROWS.items() if name in figures]
    rows += [(f"noted: {reason}", str(count)) for reason, count in sorted(done.summary.skipped.items())]
    print_rows(f"{done.run.source} ({done.run.reader}), medians over pairs", ("figure", "value"), rows)
