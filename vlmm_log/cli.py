"""The command line: parse, call one function, print. Errors end here, in one line."""

from __future__ import annotations

import json
import os
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from vlmm_log.version import __version__

if TYPE_CHECKING:
    from vlmm_log.api import Processed
    from vlmm_log.ask import Found

NOTHING = 1
INTERRUPTED = 130


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="vlmm-log")
@click.option("--debug", is_flag=True, help="Show the traceback of an error.")
def cli(debug: bool) -> None:
    """What moved in a recording, and how sure are we?"""


@cli.command(
    epilog="Example: vlmm-log process rgbd_dataset_freiburg3_walking_xyz --rrd walking.rrd && rerun walking.rrd"
)
@click.argument("source", type=click.Path(path_type=Path))
@click.option("--rrd", type=click.Path(path_type=Path), help="Rerun recording to write; SOURCE-name.rrd if not given.")
@click.option("--map", "map_file", type=click.Path(path_type=Path), help="Map to write: .json, .parquet or .ply.")
@click.option("--query", "queries", multiple=True, metavar="TEXT", help="Log what it finds at every pair; repeatable.")
@click.option("--profile", help="default, or paper: what the paper prints.")
@click.option("--settings", "toml", type=click.Path(path_type=Path), help="TOML file of settings.")
@click.option("--set", "sets", multiple=True, metavar="A.B=V", help="One setting; repeat as needed.")
@click.option("--flow", type=click.Choice(["dis", "raft"]), help="Optical flow: dis needs no weights.")
@click.option("--weights", help="RAFT weights: a file, or a folder with raft*.pth.")
@click.option("--segmenter", metavar="NAME", help="geometric (default), yolo:FILE.onnx, masks:FOLDER or none.")
@click.option("--embedder", metavar="NAME", help="words (default), clip, maskclip; clip:WEIGHTS.")
@click.option("--prior", metavar="NAME", help="Movability prior: table (default) or llm:URL.")
@click.option("--gap", metavar="K", help="Distance of a pair: frames (3) or seconds (0.1s).")
@click.option("--start", type=float, help="Seconds from the log's first frame.")
@click.option("--stop", type=float, help="Seconds from the log's first frame.")
@click.option("--intrinsics", metavar="F|FX,FY,CX,CY", help="camera.txt or numbers, px.")
@click.option("--dense", is_flag=True, help="Write full float32 tensors and covariances.")
@click.option("--force", is_flag=True, help="Replace an existing output once the new one is complete.")
@click.option("--json", "as_json", is_flag=True, help="Print the closing figures as JSON.")
def process(
    source: Path,
    rrd: Path | None,
    map_file: Path | None,
    queries: tuple[str, ...],
    profile: str | None,
    toml: Path | None,
    sets: tuple[str, ...],
    flow: str | None,
    weights: str | None,
    segmenter: str | None,
    embedder: str | None,
    prior: str | None,
    gap: str | None,
    start: float | None,
    stop: float | None,
    intrinsics: str | None,
    dense: bool,
    force: bool,
    as_json: bool,
) -> None:
    """Run the method on every keyframe pair of SOURCE and record every intermediate.

    SOURCE is a folder in TUM RGB-D or Bonn layout.
    """
    from vlmm_log.api import process as run
    from vlmm_log.settings import Settings

    options: dict[str, object] = {
        "flow.estimator": flow,
        "flow.weights": weights,
        "objects.segmenter": segmenter,
        "objects.embedder": embedder,
        "objects.prior": prior,
        "keyframes.gap": int(gap) if gap and len(gap) < 5 and gap.isascii() and gap.isdigit() else gap,
        "read.start_s": start,
        "read.stop_s": stop,
        "read.intrinsics": intrinsics,
        "log.dense": True if dense else None,
    }
    given = {name: value for name, value in options.items() if value is not None}
    settings = Settings.load(profile, toml, sets, given)
    rrd = rrd or Path(f"{source.resolve().name}.rrd")  # the closing table names it
    with _progress() as progress:
        done = run(source, rrd=rrd, map=map_file, queries=queries, settings=settings, force=force, progress=progress)
    if as_json:
        click.echo(json.dumps(_report(done), indent=2))
    else:
        _print_table(done)
    if not done.end.complete:
        sys.exit(INTERRUPTED)


@cli.command(
    epilog="Examples: vlmm-log query walking.rrd 'how many chairs moved'; vlmm-log query map.json 'the door that opens'"
)
@click.argument("source", metavar="MAP_OR_RRD", type=click.Path(path_type=Path))
@click.argument("text", metavar="TEXT")
@click.option("--parser", metavar="NAME", help="default, paper or llm:URL; if not given, the map's own.")
@click.option("--set", "sets", multiple=True, metavar="A.B=V", help="Change one of the map's settings; repeatable.")
@click.option("--limit", type=click.IntRange(1), default=20, show_default=True, help="Answers to print.")
@click.option("--explain", is_flag=True, help="Print how the query was understood, too.")
@click.option("--rrd", type=click.Path(path_type=Path), help="Write the hits as a recording that opens with the other.")
@click.option("--masks", type=click.Path(path_type=Path), help="Folder for the hits' masks, a PNG a frame (of a .rrd).")
@click.option("--grid", type=click.Path(path_type=Path), help="Occupancy grid: .npz, or .yaml with its .pgm for ROS.")
@click.option("--force", is_flag=True, help="Replace existing outputs.")
@click.option("--json", "as_json", is_flag=True, help="Print the answer as JSON.")
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
        _print_answer(found, limit, explain)
    if not found.answer.matches:
        sys.exit(NOTHING)


def main() -> None:
    """Run the command line. Exit codes: 0 done, 1 the answer is no, 2 cannot be used, 130 interrupted."""
    debug = "--debug" in sys.argv[1:]
    os.environ.setdefault("OPENCV_LOG_LEVEL", "ERROR")  # a damaged image is told by us, once
    try:
        cli.main(args=[a for a in sys.argv[1:] if a != "--debug"], prog_name="vlmm-log", standalone_mode=False)
    except click.exceptions.NoArgsIsHelpError as e:
        click.echo(e.format_message(), err=True)
        sys.exit(2)
    except click.ClickException as e:
        where = f"{e.ctx.command_path}: " if isinstance(e, click.UsageError) and e.ctx else "vlmm-log: "
        click.echo(f"{where}{e.format_message()}", err=True)
        sys.exit(2)
    except click.exceptions.Abort:
        sys.exit(INTERRUPTED)
    except Exception as e:  # noqa: BLE001  one line for the user, the traceback on request
        from vlmm_log.types import InputError

        if debug:
            traceback.print_exc()
        elif isinstance(e, InputError | OSError):
            click.echo("; ".join([f"vlmm-log: {e}", *getattr(e, "__notes__", [])]), err=True)
        else:
            click.echo(
                f"vlmm-log: internal error: {type(e).__name__}: {e}; run again with --debug and report it", err=True
            )
        sys.exit(2)


@contextmanager
def _progress() -> Iterator[Callable[[int, int], None]]:
    """A bar with pairs/s and time left on a terminal; else a plain line now and then. On stderr."""
    if not sys.stderr.isatty():
        yield _plain_lines()
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = [BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[rate]}"), TimeRemainingColumn()]
    began = time.monotonic()
    with Progress(TextColumn("pairs"), *columns, console=Console(stderr=True)) as bar:
        task = bar.add_task("pairs", total=None, rate="")

        def update(done: int, expected: int) -> None:
            rate = f"{done / (time.monotonic() - began):.1f}/s"
            bar.update(task, completed=done, total=max(expected, done), rate=rate)

        yield update


def _plain_lines(every_s: float = 5.0) -> Callable[[int, int], None]:
    began = last = time.monotonic()

    def update(done: int, expected: int) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last >= every_s:
            last = now
            rate = done / (now - began)
            left = max(expected - done, 0) / rate
            click.echo(f"pair {done} of {expected}, {rate:.1f} pairs/s, {left:.0f} s left", err=True)

    return update


def _report(done: Processed) -> dict[str, object]:
    return {
        "source": done.run.source,
        "reader": done.run.reader,
        "notes": [*done.run.notes, *done.end.told],
        "complete": done.end.complete,
        "input_hash": done.end.input_hash,
        "frames": done.end.frames,
        "outputs": [str(path) for path in done.outputs],
        "figures": done.summary.figures(),
        "elements": _elements_line(done),
        "answers": [
            {"query": a.text, "matches": a.matches, "ids": a.ids.tolist(), "reasons": list(a.reasons)}
            for a in done.answers
        ],
        "skipped": dict(done.summary.skipped),
        "versions": done.run.versions,
    }


def printable(text: str) -> str:
    """A label as a terminal may show it: control and direction characters as escapes."""
    return "".join(c if c.isprintable() else f"\\u{ord(c):04x}" for c in text)


def _print_answer(found: Found, limit: int, explain: bool) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console(markup=False)
    answer, elements = found.answer, found.elements
    if explain:
        console.print(answer.explanation, highlight=False)
    if answer.returns == "count":
        console.print(str(answer.matches), highlight=False)
    elif not answer.matches:
        console.print(f"nothing in {len(elements)} elements answers {answer.text!r}", highlight=False)
    if answer.matches:
        table = Table(title=Text(f"{answer.matches} of {len(elements)} elements"), title_justify="left")
        for name in ("id", "label", "class", "score", "position m", "why"):
            table.add_column(name, overflow="fold")
        for row in found.report(limit)["answers"]:
            place = " ".join(f"{x:.2f}" for x in row["position"])
            cells = (row["id"], row["label"], row["motion_class"], f"{row['score']:.2f}", place, row["reason"])
            table.add_row(*(Text(printable(str(cell))) for cell in cells))
        console.print(table)
    if answer.returns == "mask" and not found.outputs:
        console.print("asks for where: --masks FOLDER or --rrd F writes the pixels", highlight=False)
    for told in found.told:
        console.print(f"  {told}", highlight=False)
    for path in found.outputs:
        console.print(f"wrote {path}", highlight=False, soft_wrap=True)


ROWS = {  # figure -> what the table calls it, how it is written
    "pairs": ("pairs", "{:.0f}"),
    "unreliable_pairs": ("pairs with unreliable ego-motion", "{:.0f}"),
    "coverage": ("coverage (pixels scored)", "{:.1%}"),
    "flagged_share": ("flagged (d_M above tau_px)", "{:.2%}"),
    "static_d_m2_median": ("d_M^2 median (2.366 expected of a still world)", "{:.2f}"),
    "calibrating_noise_scale": ("noise.scale that would make it 2.366", "{:.2f}"),
    "residual_median_m": ("residual median", "{:.4f} m"),
    "instances": ("instances a frame", "{:.0f}"),
    "ego_inlier_share": ("ego-refinement inliers", "{:.1%}"),
    "flow_ms": ("flow", "{:.1f} ms"),
    "matches_ms": ("noise of the matches", "{:.1f} ms"),
    "ego_ms": ("ego-refinement", "{:.1f} ms"),
    "motion_ms": ("motion channel", "{:.1f} ms"),
    "segments_ms": ("segmenter", "{:.1f} ms"),
    "embed_ms": ("embedder", "{:.1f} ms"),
    "aggregate_ms": ("observations", "{:.1f} ms"),
    "associate_ms": ("association", "{:.1f} ms"),
    "map_ms": ("map and fusion", "{:.1f} ms"),
}


def _elements_line(done: Processed) -> str:
    from collections import Counter

    classes = Counter(e.motion_class.name.lower() for e in done.map.world.elements.values())
    moved = sum(len(e.intervals) > 0 for e in done.map.world.elements.values())
    counts = ", ".join(f"{n} {name}" for name, n in sorted(classes.items()))
    return f"{len(done.map.world.elements)} elements: {counts or 'none'}; {moved} seen to move at some time"


def _print_table(done: Processed) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console(markup=False)  # names may hold brackets
    title = Text(f"{done.run.source} ({done.run.reader}), medians over pairs")
    table = Table(title=title, title_justify="left")
    table.add_column("figure")
    table.add_column("value", justify="right")
    figures = done.summary.figures()
    for name, (label, form) in ROWS.items():
        if name in figures:
            table.add_row(label, form.format(figures[name]))
    for reason, count in sorted(done.summary.skipped.items()):
        table.add_row(Text(f"noted: {reason}"), str(count))
    console.print(table)
    console.print(_elements_line(done), highlight=False)
    for found in done.answers:
        names = ", ".join(f"{i} {done.map.world.elements[i].label}".strip() for i in found.ids[:10].tolist())
        names = printable(names)
        console.print(f"{found.text!r}: {found.matches} of the map's elements{': ' if names else ''}{names}")
    for note in (*done.run.notes, *done.end.told):
        console.print(f"  {note}", highlight=False)
    for path in done.outputs:
        size = path.stat().st_size / 1e6
        state = "" if done.end.complete else " (interrupted: readable up to the last pair)"
        console.print(f"wrote {path}{state}, {size:.1f} MB", highlight=False, soft_wrap=True)
    if not done.end.complete and not done.outputs:
        console.print("interrupted before the first pair: nothing was kept")
