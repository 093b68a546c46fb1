"""A difference as one page that needs nothing else: tables, plots, pictures of the worst frames."""

from __future__ import annotations

from pathlib import Path

from vlmm_log.comparison.difference import Difference
from vlmm_log.comparison.pictures import worst_frames
from vlmm_log.comparison.plots import curves, where_and_when
from vlmm_log.comparison.words import STAGES, figure_words, first_words, grouped, id_words, place_words, summary
from vlmm_log.pages.templates import rendered
from vlmm_log.recording import Recording
from vlmm_log.version import __version__


def write_page(path: Path, d: Difference, recordings: tuple[Recording, Recording] | None) -> None:
    """Write the page; of maps there are neither plots nor pictures. What comes from the logs is escaped."""
    path.write_text(page(d, recordings), "utf-8")


def page(d: Difference, recordings: tuple[Recording, Recording] | None) -> str:
    """The page as HTML."""
    listed = [
        {
            "name": name,
            "stage": group[0].stage,
            "compared": sum(e.compared for e in group),
            "differing": sum(len(e.frames) for e in group),
            "only_a": sum(len(e.only_a) for e in group),
            "only_b": sum(len(e.only_b) for e in group),
            "first": min((e.first for e in group), key=lambda place: place.order),
            "entity": group[0] if len(group) == 1 else None,
            "members": len(group),
        }
        for name, group in grouped(d.entities)
    ]
    return rendered(
        "diff.html",
        {
            "d": d,
            "summary": summary(d),
            "first": None if d.first is None else first_words(d.first),
            "listed": listed,
            "where": where_and_when(d),
            "curves": None if recordings is None or d.same else curves(recordings),
            "rows": [] if recordings is None else worst_frames(d, recordings),
            "version": __version__,
            "figure_words": lambda e: figure_words(e.worst.figures) if e.worst else "",
            "id_words": id_words,
            "place_words": place_words,
            "stages": STAGES,
        },
    )
