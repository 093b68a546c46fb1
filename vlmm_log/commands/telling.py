"""How commands tell: lines and tables on stdout. No label can steer the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from rich.console import Console


def printable(text: str) -> str:
    """A label as a terminal may show it: control and direction characters as escapes."""
    return "".join(c if c.isprintable() else f"\\u{ord(c):04x}" for c in text)


def tell(*lines: str) -> None:
    """Lines, each whole: a terminal wraps them, a file does not."""
    for line in lines:
        click.echo(printable(line))


def console() -> Console:
    """What draws tables; names may hold brackets."""
    from rich.console import Console

    return Console(markup=False, highlight=False)


def print_rows(title: str, head: Sequence[str], rows: Sequence[Sequence[str]], at_least: int = 0) -> None:
    """A table without lines, the first column to the left; ``at_least`` so many characters wide."""
    from rich.table import Table
    from rich.text import Text

    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    for k, name in enumerate(head):
        table.add_column(name, justify="right" if k else "left", overflow="fold")
    for row in rows:
        table.add_row(*(Text(printable(cell)) for cell in row))
    drawn = console()
    drawn.width = max(drawn.width, at_least)
    drawn.print(table)


def known(value: float | None, form: str = "{}") -> str:
    """A figure as text; nothing where there is none."""
    return "" if value is None or value != value else form.format(value)
