"""``vlmm-log view``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from vlmm_log.commands.examples import examples
from vlmm_log.commands.options import AS_JSON, FILE

if TYPE_CHECKING:
    from vlmm_log.viewing import Viewed


@click.command(
    epilog=examples(
        "vlmm-log view out.rrd",
        "vlmm-log view before.rrd after.rrd",
        "vlmm-log view out.rrd --web",
    )
)
@click.argument("files", nargs=-1, required=True, metavar="FILE [FILE]", type=FILE)
@click.option("--web", is_flag=True, help="Serve it for a browser on this machine (127.0.0.1) instead.")
@click.option("--port", type=click.IntRange(1, 65534), default=9090, show_default=True, help="Of the page, with --web.")
@AS_JSON
def view(files: tuple[Path, ...], web: bool, port: int, as_json: bool) -> None:
    """Show a recording (.rrd, .mcap) in the Rerun viewer, or two side by side under one timeline."""
    from vlmm_log.viewing import view as run

    if len(files) > 2:
        raise click.UsageError("view shows one recording or two")
    run(files, web=web, port=port, tell=print_as_json if as_json else tell_beside)


def print_as_json(viewed: Viewed) -> None:
    """On stdout, before the viewer opens."""
    click.echo(json.dumps(viewed.report(), indent=2))


def tell_beside(viewed: Viewed) -> None:
    """What is missing, and where the page is, on stderr: what the viewer says goes there, too."""
    for line in viewed.told:
        click.echo(line, err=True)
    if viewed.url:
        click.echo(f"open {viewed.url}", err=True)
