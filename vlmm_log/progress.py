"""Progress on stderr: a bar on a terminal, else a plain line now and then."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import click


@contextmanager
def progress(what: str) -> Iterator[Callable[[int, int], None]]:
    """A bar with a rate and the time left on a terminal; else a plain line now and then. Of pairs, messages, ..."""
    if not sys.stderr.isatty():
        yield _plain_lines(what)
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = [BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[rate]}"), TimeRemainingColumn()]
    began = time.monotonic()
    with Progress(TextColumn(what), *columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(what, total=None, rate="")

        def update(done: int, expected: int) -> None:
            rate = f"{done / (time.monotonic() - began):.1f}/s"
            bar.update(task, completed=done, total=max(expected, done), rate=rate)

        yield update


def _plain_lines(what: str, every_s: float = 5.0) -> Callable[[int, int], None]:
    began = last = time.monotonic()

    def update(done: int, expected: int) -> None:
        nonlocal last
        now = time.monotonic()
        if done and now - last >= every_s:
            last = now
            rate = done / (now - began)
            left = max(expected - done, 0) / rate
            click.echo(f"{done} of {expected} {what}, {rate:.1f}/s, {left:.0f} s left", err=True)

    return update
