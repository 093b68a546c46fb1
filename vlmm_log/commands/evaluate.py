"""``vlmm-log eval``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from vlmm_log.commands.examples import examples
from vlmm_log.commands.options import (
    EMBEDDER,
    FILE,
    FLOW,
    FORCE,
    GAP,
    INTRINSICS,
    PROFILE,
    SETS,
    SOURCES,
    TOML,
    WEIGHTS,
    as_settings,
)
from vlmm_log.commands.telling import known, print_rows, tell
from vlmm_log.progress import progress

if TYPE_CHECKING:
    from vlmm_log.evaluation.results import Evaluation
    from vlmm_log.settings import Settings

WIDTH = 110  # of the tables at least: narrower cells are no longer read


@click.command(
    name="eval",
    epilog=examples(
        "vlmm-log eval kitchen bedroom --ablate --baselines --html eval.html",
        "vlmm-log eval kitchen --sweep noise.scale=0.5,1,2",
        "vlmm-log eval walking --truth person --segmenter yolo:yolov8n-seg.onnx",
    ),
)
@SOURCES
@click.option("--truth", metavar="DIR|person", help="simulate's truth/, masks (0, 128, 255), or the person proxy.")
@click.option("--ablate", is_flag=True, help="Both profiles, and default without each of its levers.")
@click.option("--baselines", is_flag=True, help="Other ways to the same questions.")
@click.option("--association", is_flag=True, help="Withhold the identities of the masks, and see which are kept.")
@click.option("--pose-noise", metavar="DEG,CM", help="Also with poses off by so much, with and without ego-refinement.")
@click.option("--sweep", "sweeps", multiple=True, metavar="A.B=V1,V2", help="A setting at each value; repeatable.")
@click.option("--calibrate", type=FILE, help="Fit probabilities and write them to this file.")
@click.option("--calibration", type=FILE, help="Judge the probabilities of such a file.")
@PROFILE
@FLOW
@WEIGHTS
@click.option("--segmenter", metavar="NAME", help="If not given: the truth's masks where it has them, else geometric.")
@EMBEDDER
@GAP
@INTRINSICS
@TOML
@SETS
@click.option("--html", type=FILE, help="Write one page with tables, charts, worst frames.")
@click.option("--rrd", "recordings", type=FILE, help="Folder for a recording of each way.")
@click.option("--json", "json_file", type=FILE, help="Write all of it as JSON; - prints it.")
@FORCE
@as_settings
def evaluate(
    sources: tuple[Path, ...],
    truth: str | None,
    ablate: bool,
    baselines: bool,
    association: bool,
    pose_noise: str | None,
    sweeps: tuple[str, ...],
    calibrate: Path | None,
    calibration: Path | None,
    segmenter: str | None,
    html: Path | None,
    recordings: Path | None,
    json_file: Path | None,
    force: bool,
    settings: Settings,
) -> None:
    """Judge the method on logs of which the truth is known: SOURCE/truth, or --truth.

    Several logs are judged together. Settings as asked come first; what is compared with them follows.
    """
    from vlmm_log.assessment import evaluate as run
    from vlmm_log.evaluation.plans import Comparison, parse_pose_noise, parse_sweeps
    from vlmm_log.evaluation.report import to_json

    compare = Comparison(
        profiles=ablate,
        levers=ablate,
        baselines=baselines,
        association=association,
        sweeps=parse_sweeps(sweeps),
        pose_noise=None if pose_noise is None else parse_pose_noise(pose_noise),
    )
    printed = json_file == Path("-")
    with progress("pairs", compiles=True) as told:
        done = run(
            sources,
            truth=truth,
            settings=settings,
            compare=compare,
            segmenter=segmenter,
            calibration=calibration,
            calibrate=calibrate,
            html=html,
            json=None if printed else json_file,
            recordings=recordings,
            force=force,
            progress=told,
        )
    if printed:
        click.echo(to_json([done]), nl=False)
    else:
        print_evaluation(done)
        tell(*(f"wrote {path}" for path in (calibrate, html, json_file, recordings) if path is not None))


def print_evaluation(e: Evaluation) -> None:
    """Tables of an evaluation: pixels, elements, identities, calibration."""
    for log in e.logs:
        tell(f"{log.name}: {log.truth}; {log.frames} frames, {log.judged_pairs} of {log.pairs} pairs judged")
    _print_pixels(e)
    if e.objects:
        _print_objects(e)
    for a in e.association:
        tell(f"identities, {a.trial}: IDF1 {_figure(a.idf1, '{:.3f}')}, {a.elements} elements for {a.things} things")
    tell(*(f"ECE of {c.name}: {_figure(c.ece, '{:.3f}')} ({c.count} {c.unit}s)" for c in e.calibration))
    tell(f"static d_M^2 median {_figure(e.static_d_m2, '{:.2f}')} (2.366 expected)")
    if e.sigma_z is not None:
        a_m, b = e.sigma_z
        tell(f"depth noise of static pixels: --set noise.sigma_z_a={a_m:.5f} --set noise.sigma_z_b={b:.5f}")


def _print_pixels(e: Evaluation) -> None:
    rows = [
        (
            *(r.trial, r.score, _figure(r.ap, "{:.3f}"), _figure(r.scored_ap, "{:.3f}"), _figure(r.coverage, "{:.1%}")),
            *(_figure(x, "{:.1%}") for x in (r.recall, r.static_flags, r.far_flags, r.far_flags_at_recall)),
        )
        for r in e.pixels
    ]
    head = ("settings or baseline", "score", "AP", "scored", "coverage", "recall", "static", "far", "equal recall")
    share = _figure(e.pixels[0].prevalence if e.pixels else float("nan"), "{:.1%}")
    print_rows(f"moving pixels, {share} of all; flags of static ones", head, rows, boxed=False, at_least=WIDTH)


def _print_objects(e: Evaluation) -> None:
    rows = [
        (
            r.name,
            *(_figure(ap, "{:.3f}") for ap in r.ap.values()),
            *(_figure(d.f1, "{:.2f}") for d in r.decisions.values()),
        )
        for r in e.objects
    ]
    queries = tuple(e.objects[0].ap)
    head = ("elements", *(f"AP {q}" for q in queries), *(f"F1 {q}" for q in queries))
    print_rows("queries", head, [(*row, *[""] * (len(head) - len(row))) for row in rows], boxed=False, at_least=WIDTH)


def _figure(value: float, form: str) -> str:
    """A dash where nothing could be judged."""
    return known(value, form) or "–"
