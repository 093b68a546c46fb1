"""The command line: parse, call one function, print. Errors end here, in one line."""

from __future__ import annotations

import json
import os
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import click

from vlmm_log.progress import progress
from vlmm_log.tables import (
    print_answer,
    print_batch,
    print_batch_difference,
    print_converted,
    print_dataset,
    print_datasets,
    print_diagnosis,
    print_difference,
    print_evaluation,
    print_info,
    print_rendered,
    print_run,
    print_simulated,
    printable,
    run_report,
)
from vlmm_log.version import __version__

if TYPE_CHECKING:
    from vlmm_log.comparison.tolerance import Choice, Tolerance
    from vlmm_log.settings import Settings

NOTHING = FOUND = FAILED = 1
INTERRUPTED = 130


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="vlmm-log")
@click.option("--debug", is_flag=True, help="Show the traceback of an error.")
def cli(debug: bool) -> None:
    """What moved in a recording, and how sure are we?"""


C = TypeVar("C", bound=Callable[..., None])
READING = (
    click.argument("source", type=click.Path(path_type=Path)),
    click.option("--topics", metavar="ROLE=NAME,...", help="Of a bag: rgb, depth, info, depth_info, pose."),
    click.option("--intrinsics", metavar="F|FX,FY,CX,CY", help="camera.txt, numbers in px, or freiburg1, bonn, ..."),
    click.option("--start", type=float, help="Seconds from the log's first frame."),
    click.option("--stop", type=float, help="Seconds from the log's first frame."),
    click.option("--settings", "toml", type=click.Path(path_type=Path), help="TOML file of settings."),
    click.option("--set", "sets", multiple=True, metavar="A.B=V", help="One setting; repeat as needed."),
)


def reads_a_log(command: C) -> C:
    """Add SOURCE and the options that say how to read it."""
    for decorate in reversed(READING):
        command = decorate(command)
    return command


def says_how_to_read(command: C) -> C:
    """Add the options of ``reads_a_log`` without SOURCE."""
    for decorate in reversed(READING[1:]):
        command = decorate(command)
    return command


def _settings(
    toml: Path | None,
    sets: tuple[str, ...],
    topics: str | None,
    intrinsics: str | None,
    start: float | None,
    stop: float | None,
    profile: str | None = None,
    **others: object,
) -> Settings:
    """Settings of a command's options, those that were given."""
    from vlmm_log.settings import Settings

    options: dict[str, object] = {"read.topics": topics, "read.intrinsics": intrinsics}
    options |= {"read.start_s": start, "read.stop_s": stop}
    options |= {name.replace("__", "."): value for name, value in others.items()}
    return Settings.load(profile, toml, sets, {name: value for name, value in options.items() if value is not None})


@cli.command(
    epilog="Example: vlmm-log process rgbd_dataset_freiburg3_walking_xyz --rrd walking.rrd && rerun walking.rrd"
)
@reads_a_log
@click.option(
    "--rrd", type=click.Path(path_type=Path), help="Rerun recording to write; SOURCE-name.rrd if no recording is named."
)
@click.option("--mcap", type=click.Path(path_type=Path), help="MCAP file to write: the same content as messages.")
@click.option("--mcap-schema", type=click.Choice(["ros2", "foxglove"]), default="ros2", show_default=True)
@click.option("--map", "map_file", type=click.Path(path_type=Path), help="Map to write: .json, .parquet or .ply.")
@click.option("--query", "queries", multiple=True, metavar="TEXT", help="Log what it finds at every pair; repeatable.")
@click.option("--profile", help="default, or paper: what the paper prints.")
@click.option("--flow", type=click.Choice(["dis", "raft"]), help="Optical flow: dis needs no weights.")
@click.option("--weights", help="RAFT weights: a file, or a folder with raft*.pth.")
@click.option("--segmenter", metavar="NAME", help="geometric (default), yolo:FILE.onnx, masks:FOLDER or none.")
@click.option("--embedder", metavar="NAME", help="words (default), clip, maskclip; clip:WEIGHTS.")
@click.option("--prior", metavar="NAME", help="Movability prior: table (default) or llm:URL.")
@click.option("--gap", metavar="K", help="Distance of a pair: frames (3) or seconds (0.1s).")
@click.option("--calibration", help="File of eval --calibrate: p_moving of pixels and elements.")
@click.option("--dense", is_flag=True, help="Write full float32 tensors and covariances.")
@click.option("--workers", type=click.IntRange(1), default=1, show_default=True, help="Processes that share the work.")
@click.option("--resume", is_flag=True, help="Keep what pairs show until all is written; go on where such a run ended.")
@click.option("--force", is_flag=True, help="Replace an existing output once the new one is complete.")
@click.option("--json", "as_json", is_flag=True, help="Print the closing figures as JSON.")
def process(
    source: Path,
    rrd: Path | None,
    mcap: Path | None,
    mcap_schema: str,
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
    calibration: str | None,
    topics: str | None,
    start: float | None,
    stop: float | None,
    intrinsics: str | None,
    dense: bool,
    workers: int,
    resume: bool,
    force: bool,
    as_json: bool,
) -> None:
    """Run the method on every keyframe pair of SOURCE and record every intermediate.

    SOURCE is a folder in TUM RGB-D or Bonn layout, rgb/ and depth/ folders with or without poses, 7-Scenes frames, a
    .bag, a ROS 2 bag folder, a .db3 or an .mcap.
    """
    from vlmm_log.api import process as run
    from vlmm_log.heap import keep_pages

    settings = _settings(
        toml,
        sets,
        topics,
        intrinsics,
        start,
        stop,
        profile,
        flow__estimator=flow,
        flow__weights=weights,
        objects__segmenter=segmenter,
        objects__embedder=embedder,
        objects__prior=prior,
        keyframes__gap=_gap(gap),
        calibration__file=calibration,
        log__dense=True if dense else None,
    )
    if rrd is None and mcap is None:
        rrd = Path(f"{source.absolute().name}.rrd")  # the closing table names it
    keep_pages()
    with progress("pairs") as told:
        done = run(
            source,
            rrd=rrd,
            mcap=mcap,
            map=map_file,
            mcap_schema=mcap_schema,
            queries=queries,
            settings=settings,
            force=force,
            progress=told,
            workers=workers,
            resume=resume,
        )
    if as_json:
        click.echo(json.dumps(run_report(done), indent=2))
    else:
        print_run(done)
    if done.resumed:
        click.echo(f"went on after {done.resumed} pairs of an earlier run", err=True)
    if not done.end.complete:
        again = "the same command goes on from here" if resume else "with --resume it could go on from here"
        click.echo(f"interrupted: {again}", err=True)
        sys.exit(INTERRUPTED)


@cli.command(
    epilog="Examples: vlmm-log batch logs/* --out maps; "
    "vlmm-log batch logs/* --out maps --segmenter 'masks:{source}/masks'; vlmm-log batch logs/* --out maps --engine ray"
)
@click.argument("sources", nargs=-1, required=True, metavar="SOURCE...", type=click.Path(path_type=Path))
@click.option(
    "--out", required=True, type=click.Path(path_type=Path), help="Folder: a folder a log, manifest, summary."
)
@click.option("--engine", default="local", show_default=True, metavar="local|ray[:ADDRESS]")
@click.option("--workers", type=click.IntRange(1), help="Logs at a time, on one thread each; one a core.")
@click.option("--retries", type=click.IntRange(0), default=0, show_default=True, help="For a log whose process dies.")
@click.option("--gpus", type=click.FloatRange(0), default=0.0, help="With ray: the share of a GPU that a log takes.")
@click.option("--mcap", is_flag=True, help="Write run.mcap, too: the same content as ROS 2 messages.")
@click.option("--no-rrd", is_flag=True, help="Write no run.rrd.")
@click.option("--query", "queries", multiple=True, metavar="TEXT", help="Log what it finds at every pair; repeatable.")
@click.option("--profile", help="default, or paper: what the paper prints.")
@click.option("--flow", type=click.Choice(["dis", "raft"]), help="Optical flow: dis needs no weights.")
@click.option("--weights", help="RAFT weights: a file, or a folder with raft*.pth.")
@click.option("--segmenter", metavar="NAME", help="As of process; {source} in a name is the log's path.")
@click.option("--embedder", metavar="NAME", help="words (default), clip, maskclip; clip:WEIGHTS.")
@click.option("--prior", metavar="NAME", help="Movability prior: table (default) or llm:URL.")
@click.option("--gap", metavar="K", help="Distance of a pair: frames (3) or seconds (0.1s).")
@click.option("--calibration", help="File of eval --calibrate: p_moving of pixels and elements.")
@click.option("--dense", is_flag=True, help="Write full float32 tensors and covariances.")
@says_how_to_read
@click.option("--json", "as_json", is_flag=True, help="Print how the logs stand as JSON.")
def batch(
    sources: tuple[Path, ...],
    out: Path,
    engine: str,
    workers: int | None,
    retries: int,
    gpus: float,
    mcap: bool,
    no_rrd: bool,
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
    calibration: str | None,
    topics: str | None,
    start: float | None,
    stop: float | None,
    intrinsics: str | None,
    dense: bool,
    as_json: bool,
) -> None:
    """Process many logs into OUT, a folder each; what is finished there is not done again. Exit code 1: one failed.

    A folder bears the log's name and a hash of its content, the settings and the versions. After Ctrl-C or a crash the
    same command goes on with what is unfinished.
    """
    from vlmm_log.batches.tasks import State
    from vlmm_log.fleet import batch as run

    settings = _settings(
        toml,
        sets,
        topics,
        intrinsics,
        start,
        stop,
        profile,
        flow__estimator=flow,
        flow__weights=weights,
        objects__segmenter=segmenter,
        objects__embedder=embedder,
        objects__prior=prior,
        keyframes__gap=_gap(gap),
        calibration__file=calibration,
        log__dense=True if dense else None,
    )
    kinds = {"rrd": not no_rrd, "mcap": mcap}
    with progress("logs") as told:
        done = run(
            sources,
            out,
            settings=settings,
            queries=queries,
            recordings=[kind for kind, wanted in kinds.items() if wanted],
            engine=engine,
            workers=workers,
            retries=retries,
            gpus=gpus,
            progress=told,
        )
    if as_json:
        click.echo(json.dumps(done.report(), indent=2))
    else:
        print_batch(done)
    if not done.complete:
        sys.exit(INTERRUPTED)
    if done.of(State.FAILED):
        sys.exit(FAILED)


@cli.command(epilog="Example: vlmm-log info walking.bag")
@reads_a_log
@click.option("--json", "as_json", is_flag=True, help="Print it as JSON.")
def info(
    source: Path,
    topics: str | None,
    intrinsics: str | None,
    start: float | None,
    stop: float | None,
    toml: Path | None,
    sets: tuple[str, ...],
    as_json: bool,
) -> None:
    """Say what SOURCE holds: topics or lists, rates, sizes, intrinsics, poses, gaps."""
    from vlmm_log.survey import info as run

    told = run(source, settings=_settings(toml, sets, topics, intrinsics, start, stop))
    if as_json:
        click.echo(json.dumps(told.report(), indent=2))
    else:
        print_info(told)


@cli.command(epilog="Example: vlmm-log doctor walking.bag")
@reads_a_log
@click.option("--json", "as_json", is_flag=True, help="Print it as JSON.")
def doctor(
    source: Path,
    topics: str | None,
    intrinsics: str | None,
    start: float | None,
    stop: float | None,
    toml: Path | None,
    sets: tuple[str, ...],
    as_json: bool,
) -> None:
    """Check SOURCE's conventions from its data, and name the flag that mends what is wrong. Exit code 1: findings.

    Inverted poses, quaternion order, axes, the pose-to-camera transform, depth scale, colour-depth registration, time
    offsets, intrinsics, duplicated and unsynchronised frames.
    """
    from vlmm_log.diagnosis import doctor as run

    settings = _settings(toml, sets, topics, intrinsics, start, stop)
    with progress("checks") as told:
        diagnosis = run(source, settings=settings, progress=told)
    if as_json:
        click.echo(json.dumps(diagnosis.report(), indent=2))
    else:
        print_diagnosis(diagnosis)
    if diagnosis.findings:
        sys.exit(FOUND)


@cli.command(epilog="Examples: vlmm-log convert rgbd_dataset_freiburg1_xyz xyz.mcap; vlmm-log convert walking.bag tum/")
@reads_a_log
@click.argument("out", type=click.Path(path_type=Path))
@click.option("--to", help="mcap, bag, ros2, ros2-mcap or tum; if not given, by OUT's name.")
@click.option("--compressed", is_flag=True, help="Encoded colour and compressedDepth instead of bare pixels.")
@click.option("--force", is_flag=True, help="Replace an existing output once the new one is complete.")
@click.option("--json", "as_json", is_flag=True, help="Print what was written as JSON.")
def convert(
    source: Path,
    out: Path,
    topics: str | None,
    intrinsics: str | None,
    start: float | None,
    stop: float | None,
    toml: Path | None,
    sets: tuple[str, ...],
    to: str | None,
    compressed: bool,
    force: bool,
    as_json: bool,
) -> None:
    """Write SOURCE's images and poses into another container: OUT.mcap, OUT.bag, a ROS 2 bag folder or a TUM folder.

    Without loss: depth, poses and stamps come back bit for bit.
    """
    from vlmm_log.conversion import convert as run

    settings = _settings(toml, sets, topics, intrinsics, start, stop)
    form = "compressed" if compressed else "raw"
    with progress("images") as told:
        done = run(source, out, settings=settings, to=to or "", images=form, force=force, progress=told)
    if as_json:
        click.echo(json.dumps(done.report(), indent=2))
    else:
        print_converted(done)


@cli.command(
    epilog="Examples: vlmm-log simulate kitchen out; vlmm-log simulate bedroom out --noise nguyen --pose-noise 0.2,0.5"
)
@click.argument("scene", metavar="SCENE")
@click.argument("out", type=click.Path(path_type=Path))
@click.option("--frames", type=int, default=90, show_default=True, help="At 30 a second.")
@click.option("--seed", type=int, default=0, show_default=True, help="Decides what stands where and all noise.")
@click.option("--noise", default="clean", show_default=True, help="clean, kinect_quadratic, nguyen or disparity.")
@click.option("--flying-pixels", type=float, help="Share of depth edges that fly between; 0.3, 0 with clean.")
@click.option("--holes", type=float, help="Share of shadowed or grazed depth that is unseen; 0.9, 0 with clean.")
@click.option("--blobs", type=float, help="Small holes an image; 4, 0 with clean.")
@click.option(
    "--readout", type=float, default=0.0, show_default=True, help="Seconds from an image's first row to its last."
)
@click.option(
    "--depth-offset", type=float, default=0.0, show_default=True, help="Seconds from colour to its depth image."
)
@click.option("--pose-noise", default="0,0", show_default=True, metavar="DEG,CM", help="Sigmas of groundtruth.txt.")
@click.option("--gap", type=int, default=3, show_default=True, help="Frames that flow and motion span.")
@click.option("--force", is_flag=True, help="Replace an existing folder once the new one is complete.")
@click.option("--json", "as_json", is_flag=True, help="Print what was rendered as JSON.")
def simulate(
    scene: str,
    out: Path,
    frames: int,
    seed: int,
    noise: str,
    flying_pixels: float | None,
    holes: float | None,
    blobs: float | None,
    readout: float,
    depth_offset: float,
    pose_noise: str,
    gap: int,
    force: bool,
    as_json: bool,
) -> None:
    """Render a room to OUT, a TUM RGB-D folder with all that is true about it in OUT/truth.

    SCENE is kitchen, living_room or bedroom. Truth: instances, rigid parts, their poses, depth, camera, flow, motion.
    """
    from vlmm_log.rendering import parse_pose_noise
    from vlmm_log.rendering import simulate as run
    from vlmm_log.simulation.noise import sensor

    with progress("frames") as told:
        done = run(
            scene,
            out,
            frames=frames,
            seed=seed,
            noise=sensor(noise, flying_pixels, holes, blobs),
            readout_s=readout,
            depth_offset_s=depth_offset,
            pose_noise=parse_pose_noise(pose_noise),
            gap=gap,
            force=force,
            progress=told,
        )
    if as_json:
        click.echo(json.dumps(done.report(), indent=2))
    else:
        print_simulated(done)


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
        print_answer(found, limit, explain)
    if not found.answer.matches:
        sys.exit(NOTHING)


@cli.command(
    epilog="Examples: vlmm-log diff before.rrd after.rrd; vlmm-log diff a.rrd b.mcap --atol 0.01 --html diff.html"
)
@click.argument("a", type=click.Path(path_type=Path))
@click.argument("b", type=click.Path(path_type=Path))
@click.option("--atol", multiple=True, metavar="[ENTITY=]X", help="Absolute tolerance; repeatable. Poses: cm, degrees.")
@click.option("--rtol", multiple=True, metavar="[ENTITY=]X", help="Tolerance relative to B; repeatable.")
@click.option("--only", multiple=True, metavar="ENTITY", help="Compare these alone: names or patterns; repeatable.")
@click.option("--ignore", multiple=True, metavar="ENTITY", help="Leave these out; repeatable.")
@click.option("--json", "json_file", type=click.Path(path_type=Path), help="Write all of it as JSON; - prints it.")
@click.option(
    "--html", type=click.Path(path_type=Path), help="Write it as one page, with pictures of the worst frames."
)
@click.option("--rrd", type=click.Path(path_type=Path), help="Write A, B and their difference as one recording.")
@click.option("--force", is_flag=True, help="Replace existing outputs.")
def diff(
    a: Path,
    b: Path,
    atol: tuple[str, ...],
    rtol: tuple[str, ...],
    only: tuple[str, ...],
    ignore: tuple[str, ...],
    json_file: Path | None,
    html: Path | None,
    rrd: Path | None,
    force: bool,
) -> None:
    """Say what differs between two recordings (.rrd, .mcap) or maps: B against A. Exit code 1: something does.

    Two folders of batch are compared log by log.

    Settings and inputs first, then the first frame and the earliest stage that differ, then every entity. ENTITY is a
    name as in the viewer, world/camera/image/residual/d_m, or a pattern, "world/map/*".
    """
    from vlmm_log.batches.manifest import is_batch
    from vlmm_log.compare import diff as run
    from vlmm_log.comparison.report import report
    from vlmm_log.comparison.tolerance import Choice, Tolerance

    tolerance, choice = Tolerance.parse(atol, rtol), Choice(only, ignore)
    printed = json_file == Path("-")
    if is_batch(a) and is_batch(b):
        _diff_batches(a, b, tolerance, choice, {"--html": html, "--rrd": rrd}, json_file, force)
        return
    with progress("entities") as told:
        done = run(
            a,
            b,
            tolerance=tolerance,
            choice=choice,
            json=None if printed else json_file,
            html=html,
            rrd=rrd,
            force=force,
            progress=told,
        )
    if printed:
        click.echo(json.dumps(report(done), indent=1))
    else:
        print_difference(done)
        for path in (json_file, html, rrd):
            if path is not None:
                click.echo(f"wrote {printable(str(path))}")
    if not done.same:
        sys.exit(FOUND)


def _diff_batches(
    a: Path,
    b: Path,
    tolerance: Tolerance,
    choice: Choice,
    others: dict[str, Path | None],
    json_file: Path | None,
    force: bool,
) -> None:
    from vlmm_log.compare_batches import diff_batches
    from vlmm_log.outputs import claim, replacing

    for name, path in others.items():
        if path is not None:
            raise click.UsageError(f"{name} is for two recordings; give those of one log")
    printed = json_file == Path("-")
    if json_file is not None and not printed:
        claim([json_file], force=force)
    with progress("logs") as told:
        done = diff_batches(a, b, tolerance=tolerance, choice=choice, progress=told)
    text = json.dumps(done.report(), indent=1) + "\n"
    if printed:
        click.echo(text, nl=False)
    else:
        print_batch_difference(done)
    if json_file is not None and not printed:
        with replacing(json_file, force=force) as (partial,):
            partial.write_text(text, encoding="utf-8")
        click.echo(f"wrote {printable(str(json_file))}")
    if not done.same:
        sys.exit(FOUND)


@cli.command(
    name="eval",
    epilog="Examples: vlmm-log eval kitchen bedroom --ablate --baselines --html eval.html; "
    "vlmm-log eval walking --truth person --segmenter yolo:yolov8n-seg.onnx",
)
@click.argument("sources", nargs=-1, required=True, metavar="SOURCE...", type=click.Path(path_type=Path))
@click.option("--truth", metavar="DIR|person", help="simulate's truth/, masks (0, 128, 255), or the person proxy.")
@click.option("--ablate", is_flag=True, help="Both profiles, and default without each of its levers.")
@click.option("--baselines", is_flag=True, help="Other ways to the same questions.")
@click.option("--association", is_flag=True, help="Withhold the identities of the masks, and see which are kept.")
@click.option("--pose-noise", metavar="DEG,CM", help="Also with poses off by so much, with and without ego-refinement.")
@click.option("--sweep", "sweeps", multiple=True, metavar="A.B=V1,V2", help="A setting at each value; repeatable.")
@click.option("--calibrate", type=click.Path(path_type=Path), help="Fit probabilities and write them to this file.")
@click.option("--calibration", type=click.Path(path_type=Path), help="Judge the probabilities of such a file.")
@click.option("--profile", help="default, or paper: what the paper prints.")
@click.option("--flow", type=click.Choice(["dis", "raft"]), help="Optical flow: dis needs no weights.")
@click.option("--weights", help="RAFT weights: a file, or a folder with raft*.pth.")
@click.option("--segmenter", metavar="NAME", help="If not given: the truth's masks where it has them, else geometric.")
@click.option("--embedder", metavar="NAME", help="words (default), clip, maskclip; clip:WEIGHTS.")
@click.option("--gap", metavar="K", help="Distance of a pair: frames (3) or seconds (0.1s).")
@click.option("--intrinsics", metavar="F|FX,FY,CX,CY", help="camera.txt, numbers in px, or freiburg1, bonn, ...")
@click.option("--settings", "toml", type=click.Path(path_type=Path), help="TOML file of settings.")
@click.option("--set", "sets", multiple=True, metavar="A.B=V", help="One setting; repeat as needed.")
@click.option("--html", type=click.Path(path_type=Path), help="Write one page with tables, charts, worst frames.")
@click.option("--rrd", "recordings", type=click.Path(path_type=Path), help="Folder for a recording of each way.")
@click.option("--json", "json_file", type=click.Path(path_type=Path), help="Write all of it as JSON; - prints it.")
@click.option("--force", is_flag=True, help="Replace existing outputs.")
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
    profile: str | None,
    flow: str | None,
    weights: str | None,
    segmenter: str | None,
    embedder: str | None,
    gap: str | None,
    intrinsics: str | None,
    toml: Path | None,
    sets: tuple[str, ...],
    html: Path | None,
    recordings: Path | None,
    json_file: Path | None,
    force: bool,
) -> None:
    """Judge the method on logs of which the truth is known: SOURCE/truth, or --truth.

    Several logs are judged together. Settings as asked come first; what is compared with them follows.
    """
    from vlmm_log.assessment import evaluate as run
    from vlmm_log.evaluation.plans import Comparison, parse_pose_noise, parse_sweeps
    from vlmm_log.evaluation.report import to_json

    settings = _settings(
        toml,
        sets,
        None,
        intrinsics,
        None,
        None,
        profile,
        flow__estimator=flow,
        flow__weights=weights,
        objects__embedder=embedder,
        keyframes__gap=_gap(gap),
    )
    compare = Comparison(
        profiles=ablate,
        levers=ablate,
        baselines=baselines,
        association=association,
        sweeps=parse_sweeps(sweeps),
        pose_noise=None if pose_noise is None else parse_pose_noise(pose_noise),
    )
    printed = json_file == Path("-")
    with progress("pairs") as told:
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
        for path in (calibrate, html, json_file, recordings):
            if path is not None:
                click.echo(f"wrote {printable(str(path))}")


def _gap(text: str | None) -> int | str | None:
    """Frames as a number, seconds as they are written."""
    return int(text) if text and len(text) < 5 and text.isascii() and text.isdigit() else text


@cli.command(epilog="Examples: vlmm-log view out.rrd; vlmm-log view before.rrd after.rrd; vlmm-log view out.rrd --web")
@click.argument("files", nargs=-1, required=True, metavar="FILE [FILE]", type=click.Path(path_type=Path))
@click.option("--web", is_flag=True, help="Serve it for a browser on this machine (127.0.0.1) instead.")
@click.option("--port", type=click.IntRange(1, 65534), default=9090, show_default=True, help="Of the page, with --web.")
def view(files: tuple[Path, ...], web: bool, port: int) -> None:
    """Show a recording (.rrd, .mcap) in the Rerun viewer, or two side by side under one timeline."""
    from vlmm_log.viewing import view as run

    if len(files) > 2:
        raise click.UsageError("view shows one recording or two")
    sys.exit(run(files, web=web, port=port, tell=lambda line: click.echo(line, err=True)))


@cli.command(
    epilog="Examples: vlmm-log render walking.rrd --frame 60 -o frame.png; "
    "vlmm-log render walking.mcap --video walking.mp4 --panels rgb,d_m --start 1 --stop 3"
)
@click.argument("recording", type=click.Path(path_type=Path))
@click.option("--frame", type=int, metavar="N", help="The frame, as the viewer and tables number it.")
@click.option("-o", "--out", type=click.Path(path_type=Path), help="Picture to write: .png or .jpg.")
@click.option("--video", type=click.Path(path_type=Path), help="Video to write: .mp4.")
@click.option("--panels", metavar="NAME,...", help="Of them, in this order: rgb,depth,flow,d_m,validity,elements, ...")
@click.option("--fps", type=float, help="Of the video; as the frames were taken if not given.")
@click.option("--start", type=float, help="Seconds from the recording's first pair.")
@click.option("--stop", type=float, help="Seconds from the recording's first pair.")
@click.option("--force", is_flag=True, help="Replace an existing output once the new one is complete.")
@click.option("--json", "as_json", is_flag=True, help="Print what was written as JSON.")
def render(
    recording: Path,
    frame: int | None,
    out: Path | None,
    video: Path | None,
    panels: str | None,
    fps: float | None,
    start: float | None,
    stop: float | None,
    force: bool,
    as_json: bool,
) -> None:
    """Draw a frame of a recording (.rrd, .mcap) as a picture, or its pairs as a video, without a viewer.

    Further panels: instances, norm, sigma_z, p_stat, fb_error, p_moving, score, truth, outcome. Those that the
    recording lacks are left out and told.
    """
    from vlmm_log.picturing import render as run

    if (frame is None or out is None) == (video is None):
        raise click.UsageError("give --frame N and -o F.png, or --video F.mp4")
    if video is not None and (frame is not None or out is not None):
        raise click.UsageError("--frame and -o are of a picture, --video is another call")
    names = [] if panels is None else [name.strip() for name in panels.split(",")]
    with progress("frames") as told:
        done = run(
            recording,
            video or out or "",
            frame=frame,
            panels=names,
            fps=fps,
            start=start,
            stop=stop,
            force=force,
            progress=told,
        )
    if as_json:
        click.echo(json.dumps(done.report(), indent=2))
    else:
        print_rendered(done)


@cli.group(name="datasets")
def datasets_group() -> None:
    """Recorded sequences to try this on, from their official sites. Nothing is fetched but by `get`."""


@datasets_group.command(name="list", epilog="Example: vlmm-log datasets list")
@click.option("--to", type=click.Path(path_type=Path), default=Path(), help="Folder to look in for what is there.")
@click.option("--json", "as_json", is_flag=True, help="Print it as JSON.")
def list_datasets(to: Path, as_json: bool) -> None:
    """Say which sequences can be fetched, and what of them lies in the folder. No server is asked."""
    from vlmm_log.datasets import datasets

    shelved = datasets(to)
    if as_json:
        click.echo(json.dumps([x.report() for x in shelved], indent=2))
    else:
        print_datasets(shelved)


@datasets_group.command(name="get", epilog="Example: vlmm-log datasets get freiburg3_walking_xyz")
@click.argument("name")
@click.option("--to", type=click.Path(path_type=Path), default=Path(), help="Folder to unpack it in; this one.")
@click.option("--url", default="", help="Another place that has the same archive.")
@click.option("--sha256", default="", metavar="HEX", help="What the archive's hash has to be.")
@click.option("--keep-archive", is_flag=True, help="Keep the archive after unpacking.")
@click.option("--force", is_flag=True, help="Replace an existing sequence once the new one is complete.")
@click.option("--json", "as_json", is_flag=True, help="Print what was fetched as JSON.")
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
    if as_json:
        click.echo(json.dumps(got.report(), indent=2))
    else:
        print_dataset(got)


def main() -> None:
    """Run the command line. Exit codes: 0 done, 1 the answer is no, 2 cannot be used, 130 interrupted."""
    debug = "--debug" in sys.argv[1:]
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # no sum takes more; idle threads would spin beside the work
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
        elif isinstance(e, MemoryError):
            click.echo(
                f"vlmm-log: out of memory ({e}): give fewer --workers, or a window by --start and --stop", err=True
            )
        elif isinstance(e, InputError | OSError):
            click.echo("; ".join([f"vlmm-log: {e}", *getattr(e, "__notes__", [])]), err=True)
        else:
            click.echo(
                f"vlmm-log: internal error: {type(e).__name__}: {e}; run again with --debug and report it", err=True
            )
        sys.exit(2)
