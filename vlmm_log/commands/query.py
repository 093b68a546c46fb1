"""``vlmm-log query``."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from vlmm_log.commands.examples import examples
from vlmm_log.commands.exits import NOTHING
from vlmm_log.commands.options import AS_JSON, FILE, FORCE
from vlmm_log.commands.telling import print_rows, tell

if TYPE_CHECKING:
    from vlmm_log.ask import Found


@click.command(
    epilog=examples(
        "vlmm-log query walking.rrd 'how many chairs moved'",
        "vlmm-log query map.json 'the door that opens' --json",
        "vlmm-log query map.json 'things that moved' --grid grid.yaml",
    )
)
@click.argument("source", metavar="MAP_OR_RRD", type=FILE)
@click.argument("text", metavar="TEXT")
@click.option("--parser", metavar="NAME", help="default, paper or llm:URL; if not given, the map's own.")
@click.option("--set", "sets", multiple=True, metavar="A.B=V", help="Change one of the map's settings; repeatable.")
@click.option("--limit", type=click.IntRange(1), default=20, show_default=True, help="Answers to print.")
@click.option("--explain", is_flag=True, help="Print how the query was understood, too.")
@click.option("--rrd", type=FILE, help="Write the hits as a recording that opens with the other.")
@click.option("--masks", type=FILE, help="Folder for the hits' masks, a PNG a frame (of a .rrd).")
@click.option("--grid", type=FILE, help="Occupancy grid: .npz, or .yaml with its .pgm for ROS.")
@FORCE
@AS_JSON
def query(
    source: Path,
    text: str,
    parser: str | None,
    sets: tuple[str, ...],
    limit: int,
    explain: bool,
    rrd: Path | None,
    masks: Path | None,
    grid: Path | None,
    force: bool,
    as_json: bool,
) -> None:
    """Ask a map or a recording. Exit code 1: nothing answers.

    The grid shows the whole map; its element layers only the answers.
    """
    from vlmm_log.ask import find

    sets = sets if parser is None else (*sets, f"query.parser={json.dumps(parser)}")
    found = find(source, text, sets=sets, rrd=rrd, masks=masks, grid=grid, force=force)
    if as_json:
        click.echo(json.dumps(found.report(limit), indent=2))
    else:
        if explain:
            tell(*found.answer.explanation.splitlines())
        print_found(found, limit)
    if not found.answer.matches:
        sys.exit(NOTHING)


def print_found(found: Found, limit: int) -> None:
    """What a query found."""
    answer = found.answer
    if answer.returns == "count":
        tell(str(answer.matches))
    elif not answer.matches:
        tell(f"nothing in {len(found.elements)} elements answers {answer.text!r}")
    if answer.matches:
        print_answers(found, limit)
    if answer.returns == "mask" and not found.outputs:
        tell("asks for where: --masks FOLDER or --rrd F writes the pixels")
    tell(*(f"  {told}" for told in found.told), *(f"wrote {path}" for path in found.outputs))


def print_answers(found: Found, limit: int) -> None:
    """The table of the elements that answer."""
    rows = []
    for row in found.report(limit)["answers"]:
        place = " ".join(f"{x:.2f}" for x in row["position"])
        rows.append((str(row["id"]), row["label"], row["motion_class"], f"{row['score']:.2f}", place, row["reason"]))
    head = ("id", "label", "class", "score", "position m", "why")
    print_rows(f"{found.answer.matches} of {len(found.elements)} elements", head, rows, left=len(head))
