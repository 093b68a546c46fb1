"""Progress on stderr: a bar on a terminal, else a plain line now and then."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path

import click

from vlmm_log.cache import kernels_folder

COMPILING = "compiling kernels for this processor, once: about 12 s"
REFUSED_S = 1.0  # what cannot be used is told sooner, and alone


@contextmanager
def progress(what: str, *, compiles: bool = False) -> Iterator[Callable[[int, int], None]]:
    """A bar with a rate and the time left on a terminal; else a plain line now and then. Of pairs, messages, ...

    ``compiles``: the work begins with all of the pipeline's kernels; a terminal is told why nothing seems to happen
    where none are kept.
    """
    if not sys.stderr.isatty() or os.environ.get("TERM") in ("dumb", "unknown"):
        yield _plain_lines(what)
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = [BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[rate]}"), TimeRemainingColumn()]
    began = time.monotonic()
    with Progress(TextColumn(what), *columns, console=Console(stderr=True, highlight=False)) as bar:
        task = bar.add_task(what, total=None, rate="")
        told = threading.Timer(REFUSED_S, bar.console.print, [COMPILING])
        if compiles and not _kernels_kept():
            told.start()

        def update(done: int, expected: int) -> None:
            told.cancel()
            rate = f"{done / (time.monotonic() - began):.1f}/s"
            bar.update(task, completed=done, total=max(expected, done), rate=rate)

        try:
            yield update
        finally:
            told.cancel()


def _kernels_kept() -> bool:
    """Whether an earlier run left the kernels that measure motion; a few others are kept by lesser commands."""
    spec = find_spec("vlmm_log.pipeline")
    assert spec is not None
    assert spec.submodule_search_locations
    kept = os.environ.get("NUMBA_CACHE_DIR") or kernels_folder(Path(spec.submodule_search_locations[0]))
    return any(Path(kept).rglob("kernels.*.nbi"))


def _plain_lines(what: str, every_s: float = 5.0) -> Callable[[int, int], None]:
    began = last = time.monotonic()

    def update(done: int, expected: int) -> None:
        nonlocal last
        now = time.monotonic()
        if done and now - last >= every_s:
            last = now
            rate = done / (now - began)
            left = max(expected - done, 0) / rate
            with suppress(OSError):  # nobody listens, or a full disk: the work goes on
                click.echo(f"{done} of {expected} {what}, {rate:.1f}/s, {left:.0f} s left", err=True)

    return update
