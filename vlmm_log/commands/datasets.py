"""``vlmm-log datasets list|get``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from vlmm_log.commands.examples import examples
from vlmm_log.commands.options import AS_JSON, FILE, FORCE
from vlmm_log.commands.telling import printable, show, tell
from vlmm_log.progress import progress

if TYPE_CHECKING:
    from vlmm_log.datasets import Got, Shelved


@click.group(
    epilog=examples(
        "vlmm-log datasets list",
        "vlmm-log datasets get freiburg3_walking_xyz",
    )
)
def datasets() -> None:
    """Recorded sequences to try this on, from their official sites. Nothing is fetched but by `get`."""


@datasets.command(
    name="list",
    epilog=examples(
        "vlmm-log datasets list",
        "vlmm-log datasets list --to logs --json",
    ),
)
@click.option("--to", type=FILE, default=Path(), help="Folder to look in for what is there.")
@AS_JSON
def list_datasets(to: Path, as_json: bool) -> None:
    """Say which sequences can be fetched, and what of them lies in the folder. No server is asked."""
    from vlmm_log.datasets import datasets as shelf

    shelved = shelf(to)
    if as_json:
        click.echo(json.dumps([x.report() for x in shelved], indent=2))
    else:
        print_datasets(shelved)


@datasets.command(
    name="get",
    epilog=examples(
        "vlmm-log datasets get freiburg3_walking_xyz",
        "vlmm-log datasets get freiburg3_walking_xyz --to logs --keep-archive",
    ),
)
@click.argument("name")
@click.option("--to", type=FILE, default=Path(), help="Folder to unpack it in; this one.")
@click.option("--url", default="", help="Another place that has the same archive.")
@click.option("--sha256", default="", metavar="HEX", help="What the archive's hash has to be.")
@click.option("--keep-archive", is_flag=True, help="Keep the archive after unpacking.")
@FORCE
@AS_JSON
def get_datasets(name: str, to: Path, url: str, sha256: str, keep_archive: bool, force: bool, as_json: bool) -> None:
    """Fetch the sequence NAME and unpack it. After a cut, the same command goes on.

    Its licence is shown first. An archive that lies in the folder already is used.
    """
    from vlmm_log.datasets import dataset, get_dataset

    offer = dataset(name)
    click.echo(f"{offer.title}: {offer.page}\nlicence: {offer.licence}\nplease cite: {offer.cite}", err=True)
    with progress("MB") as told:
        got = get_dataset(
            name,
            to=to,
            url=url,
            sha256=sha256,
            keep_archive=keep_archive,
            force=force,
            progress=told,
            tell=lambda line: click.echo(printable(line), err=True),
        )
    show(got, print_dataset, as_json=as_json)


def print_datasets(shelved: Sequence[Shelved]) -> None:
    """What can be fetched, a line a sequence; then the terms of each collection."""
    width = max(len(x.offer.name) for x in shelved)
    for x in shelved:
        size = f"{x.offer.size / 1e6:.0f} MB" if x.offer.size else "? MB"
        state = f" [{x.state}{f': {x.size / 1e6:.0f} MB' if x.size else ''}]" if x.state else ""
        moves = f" Moves: {x.offer.movers}." if x.offer.movers else ""
        tell(f"{x.offer.name:<{width}} {size:>8}  {x.offer.about}.{moves}{state}")
    for title, page, licence in dict.fromkeys((x.offer.title, x.offer.page, x.offer.licence) for x in shelved):
        tell(f"{title} ({page}), licence: {licence}")


def print_dataset(got: Got) -> None:
    """Where a sequence lies now, and how far it is known to be the right one."""
    if got.source:
        tell(f"SHA-256 {got.sha256}, as {got.source} says")
    else:
        record = got.path.parent / f"{got.offer.file}.sha256"
        tell(f"SHA-256 {got.sha256}: nobody publishes one, so this download was trusted; kept in {record}")
    if got.outside:
        tell(f"left out: {got.outside} members of the archive outside of {got.offer.folder}/")
    tell(f"wrote {got.path}; next: vlmm-log info {got.path}")
