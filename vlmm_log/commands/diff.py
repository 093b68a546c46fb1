"""``vlmm-log diff``."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from vlmm_log.commands.diff_batches import tell_batches
from vlmm_log.commands.examples import examples
from vlmm_log.commands.exits import FOUND
from vlmm_log.commands.options import FILE, FORCE
from vlmm_log.commands.telling import console, tell
from vlmm_log.progress import progress

if TYPE_CHECKING:
    from vlmm_log.comparison.difference import Difference

MOST_LINES = 40  # of a section


@click.command(
    epilog=examples(
        "vlmm-log diff before.rrd after.rrd",
        "vlmm-log diff a.rrd b.mcap --atol 0.01 --html diff.html",
        "vlmm-log diff maps_of_monday maps_of_tuesday",
    )
)
@click.argument("a", type=FILE)
@click.argument("b", type=FILE)
@click.option("--atol", multiple=True, metavar="[ENTITY=]X", help="Absolute tolerance; repeatable. Poses: cm, degrees.")
@click.option("--rtol", multiple=True, metavar="[ENTITY=]X", help="Tolerance relative to B; repeatable.")
@click.option("--only", multiple=True, metavar="ENTITY", help="Compare these alone: names or patterns; repeatable.")
@click.option("--ignore", multiple=True, metavar="ENTITY", help="Leave these out; repeatable.")
@click.option("--json", "json_file", type=FILE, help="Write all of it as JSON; - prints it.")
@click.option("--html", type=FILE, help="Write it as one page, with pictures of the worst frames.")
@click.option("--rrd", type=FILE, help="Write A, B and their difference as one recording.")
@FORCE
def diff(
    a: Path,
    b: Path,
    atol: tuple[str, ...],
    rtol: tuple[str, ...],
    only: tuple[str, ...],
    ignore: tuple[str, ...],
    json_file: Path | None,
    html: Path | None,
    rrd: Path | None,
    force: bool,
) -> None:
    """Say what differs between two recordings (.rrd, .mcap) or maps: B against A. Exit code 1: something does.

    Two folders of batch are compared log by log.

    Settings and inputs first, then the first frame and the earliest stage that differ, then every entity. ENTITY is a
    name as in the viewer, world/camera/image/residual/d_m, or a pattern, "world/map/*".
    """
    from vlmm_log.batches.manifest import is_batch
    from vlmm_log.compare import diff as run
    from vlmm_log.comparison.report import report
    from vlmm_log.comparison.tolerance import Choice, Tolerance

    tolerance, choice = Tolerance.parse(atol, rtol), Choice(only, ignore)
    printed = json_file == Path("-")
    if is_batch(a) and is_batch(b):
        for name, path in (("--html", html), ("--rrd", rrd)):
            if path is not None:
                raise click.UsageError(f"{name} is for two recordings; give those of one log")
        tell_batches(a, b, tolerance, choice, json_file, force=force)
        return
    with progress("entities") as told:
        done = run(
            a,
            b,
            tolerance=tolerance,
            choice=choice,
            json=None if printed else json_file,
            html=html,
            rrd=rrd,
            force=force,
            progress=told,
        )
    if printed:
        click.echo(json.dumps(report(done), indent=1))
    else:
        print_difference(done)
        tell(*(f"wrote {path}" for path in (json_file, html, rrd) if path is not None))
    if not done.same:
        sys.exit(FOUND)


def print_difference(d: Difference) -> None:
    """What differs: in words, then settings, entities and elements, a line each."""
    from vlmm_log.comparison.words import entity_words, grouped, name_words, summary

    tell(f"A {d.a}", f"B {d.b}", *summary(d))
    _section("settings, A -> B", [f"{c.name}: {c.a} -> {c.b}" for c in d.settings])
    _section("entities, in the order of the stages", [entity_words(name, group) for name, group in grouped(d.entities)])
    changes = [c for c in d.elements.changes if c.kinds != ("changed",)]
    _section("elements", [f"{name_words(c)}: {', '.join(c.kinds)}: {c.told}" for c in changes])
    _section("about the runs, A -> B", [f"{change.name}: {change.a} -> {change.b}" for change in d.about])


def _section(title: str, lines: list[str]) -> None:
    if lines:
        console().print(title, style="bold")
    tell(*(f"  {line}" for line in lines[:MOST_LINES]))
    if len(lines) > MOST_LINES:
        tell(f"  and {len(lines) - MOST_LINES} more: --json tells all")
