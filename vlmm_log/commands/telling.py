"""How commands tell: lines and tables on stdout. No label can steer the terminal."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import click

if TYPE_CHECKING:
    from rich.console import Console

USUAL_WIDTH = 80  # of a terminal
FOLDED = 16  # characters that a folded column keeps


def printable(text: str) -> str:
    """A label as a terminal may show it: control and direction characters as escapes."""
    return "".join(c if c.isprintable() else f"\\u{ord(c):04x}" for c in text)


def tell(*lines: str) -> None:
    """Lines, each whole: a terminal wraps them, a file does not."""
    for line in lines:
        click.echo(printable(line))


class Reported(Protocol):
    """What came of a command."""

    def report(self) -> dict[str, Any]:
        """For JSON."""


R = TypeVar("R", bound=Reported)


def show(done: R, print_plainly: Callable[[R], None], *, as_json: bool) -> None:
    """As JSON on request, else in the command's own words."""
    if as_json:
        click.echo(json.dumps(done.report(), indent=2))
    else:
        print_plainly(done)


def console() -> Console:
    """What draws tables; names may hold brackets."""
    from rich.console import Console

    return Console(markup=False, highlight=False)


def print_rows(
    title: str,
    head: Sequence[str],
    rows: Sequence[Sequence[str]],
    *,
    left: int = 1,
    boxed: bool = True,
    at_least: int = 0,
) -> None:
    """A title and a table, of which so many columns are text, to the left. Only the widest column folds.

    What is no terminal gets rows as wide as they are. A terminal too narrow gets a line a row, which names its cells;
    from 80 columns on it is taken to be ``at_least`` so wide.
    """
    from rich.box import HEAVY_HEAD
    from rich.cells import cell_len
    from rich.table import Table
    from rich.text import Text

    tell(*([title] if title else []))
    cells = [[printable(cell) for cell in row] for row in rows]
    widths = [max(map(cell_len, column)) for column in zip(head, *cells, strict=True)]
    widest = widths.index(max(widths))
    whole = sum(widths) + (3 * len(widths) + 1 if boxed else 2 * len(widths))
    drawn = console()
    if not drawn.is_terminal:
        drawn.width = whole
    elif drawn.width >= USUAL_WIDTH:
        drawn.width = max(drawn.width, at_least)
    if drawn.width < whole - max(0, widths[widest] - FOLDED):
        named = ([f"{name} {cell}".strip() for name, cell in zip(head, row, strict=True) if cell] for row in cells)
        tell(*(", ".join(row) for row in named))
        return
    table = Table(box=HEAVY_HEAD if boxed else None, pad_edge=boxed)
    for k, name in enumerate(head):
        table.add_column(name, justify="left" if k < left else "right", overflow="fold", no_wrap=k != widest)
    for row in cells:
        table.add_row(*(Text(cell) for cell in row))
    drawn.print(table)


def known(value: float | None, form: str = "{}") -> str:
    """A figure as text; nothing where there is none."""
    return "" if value is None or value != value else form.format(value)
