"""``vlmm-log batch``."""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import click

from vlmm_log.commands.examples import examples
from vlmm_log.commands.exits import FAILED, INTERRUPTED
from vlmm_log.commands.options import AS_JSON, FILE, QUERIES, READING, SOURCES, added, as_settings, method
from vlmm_log.commands.telling import known, print_rows, show, tell
from vlmm_log.progress import progress

if TYPE_CHECKING:
    from vlmm_log.fleet import Batch
    from vlmm_log.settings import Settings

MOST_MOVERS = 6


@click.command(
    epilog=examples(
        "vlmm-log batch logs/* --out maps",
        "vlmm-log batch logs/* --out maps --segmenter 'masks:{source}/masks'",
        "vlmm-log batch logs/* --out maps --engine ray",
    )
)
@SOURCES
@click.option("--out", required=True, type=FILE, help="Folder: a folder a log, manifest, summary.")
@click.option("--engine", default="local", show_default=True, metavar="local|ray[:ADDRESS]")
@click.option("--workers", type=click.IntRange(1), help="Logs at a time, on one thread each; one a core.")
@click.option("--retries", type=click.IntRange(0), default=0, show_default=True, help="For a log whose process dies.")
@click.option("--gpus", type=click.FloatRange(0), default=0.0, help="With ray: the share of a GPU that a log takes.")
@click.option("--mcap", is_flag=True, help="Write run.mcap, too: the same content as ROS 2 messages.")
@click.option("--no-rrd", is_flag=True, help="Write no run.rrd.")
@QUERIES
@method("As of process; {source} in a name is the log's path.")
@added(*READING)
@AS_JSON
@as_settings
def batch(
    sources: tuple[Path, ...],
    out: Path,
    engine: str,
    workers: int | None,
    retries: int,
    gpus: float,
    mcap: bool,
    no_rrd: bool,
    queries: tuple[str, ...],
    as_json: bool,
    settings: Settings,
) -> None:
    """Process many logs into OUT, a folder each; what is finished there is not done again. Exit code 1: one failed.

    A folder bears the log's name and a hash of its content, the settings and the versions. After Ctrl-C or a crash the
    same command goes on with what is unfinished.
    """
    from vlmm_log.batches.tasks import State
    from vlmm_log.fleet import batch as run

    kinds = {"rrd": not no_rrd, "mcap": mcap}
    with progress("logs", compiles=True) as told:
        done = run(
            sources,
            out,
            settings=settings,
            queries=queries,
            recordings=[kind for kind, wanted in kinds.items() if wanted],
            engine=engine,
            workers=workers,
            retries=retries,
            gpus=gpus,
            progress=told,
        )
    show(done, print_batch, as_json=as_json)
    if not done.complete:
        sys.exit(INTERRUPTED)
    if done.of(State.FAILED):
        sys.exit(FAILED)


def print_batch(done: Batch) -> None:
    """How the logs stand, then what failed and why."""
    rows = []
    for o in done.outcomes:
        figures = o.row
        movers = figures.get("movers", [])
        more = f" and {len(movers) - MOST_MOVERS} more" if len(movers) > MOST_MOVERS else ""
        cells = (
            known(figures.get("pairs"), "{:.0f}"),
            known(o.seconds, "{:.1f}"),
            known(figures.get("flagged_share"), "{:.1%}"),
            known(figures.get("static_d_m2_median"), "{:.2f}"),
            known(figures.get("elements"), "{:.0f}"),
        )
        rows.append((o.name, str(o.state), *cells, ", ".join(movers[:MOST_MOVERS]) + more))
    print_rows("", ("log", "state", "pairs", "s", "flagged", "d_M^2", "elements", "seen to move"), rows, boxed=False)
    tell(*(f"{o.name}: {o.error}" for o in done.outcomes if o.error))
    states = Counter(str(o.state) for o in done.outcomes)
    tell(f"{len(done.outcomes)} logs: {', '.join(f'{n} {state}' for state, n in sorted(states.items()))}")
    if not done.complete:
        tell("interrupted: the same command goes on with what is pending")
    tell(f"wrote {done.out}")
