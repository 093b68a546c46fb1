"""``vlmm-log view``."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from vlmm_log.commands.options import FILE


@click.command(
    epilog="Examples: vlmm-log view out.rrd; vlmm-log view before.rrd after.rrd; vlmm-log view out.rrd --web"
)
@click.argument("files", nargs=-1, required=True, metavar="FILE [FILE]", type=FILE)
@click.option("--web", is_flag=True, help="Serve it for a browser on this machine (127.0.0.1) instead.")
@click.option("--port", type=click.IntRange(1, 65534), default=9090, show_default=True, help="Of the page, with --web.")
def view(files: tuple[Path, ...], web: bool, port: int) -> None:
    """Show a recording (.rrd, .mcap) in the Rerun viewer, or two side by side under one timeline."""
    from vlmm_log.viewing import view as run

    if len(files) > 2:
        raise click.UsageError("view shows one recording or two")
    sys.exit(run(files, web=web, port=port, tell=lambda line: click.echo(line, err=True)))
