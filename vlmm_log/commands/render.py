"""``vlmm-log render``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from vlmm_log.commands.examples import examples
from vlmm_log.commands.options import AS_JSON, FILE, FORCE
from vlmm_log.commands.telling import show, tell
from vlmm_log.progress import progress

if TYPE_CHECKING:
    from vlmm_log.picturing import Rendered


@click.command(
    epilog=examples(
        "vlmm-log render walking.rrd --frame 60 -o frame.png",
        "vlmm-log render walking.mcap --video walking.mp4 --panels rgb,d_m",
    )
)
@click.argument("recording", type=FILE)
@click.option("--frame", type=int, metavar="N", help="The frame, as the viewer and tables number it.")
@click.option("-o", "--out", type=FILE, help="Picture to write: .png or .jpg.")
@click.option("--video", type=FILE, help="Video to write: .mp4.")
@click.option("--panels", metavar="NAME,...", help="Of them, in this order: rgb,depth,flow,d_m,validity,elements, ...")
@click.option("--fps", type=float, help="Of the video; as the frames were taken if not given.")
@click.option("--start", type=float, help="Seconds from the recording's first pair.")
@click.option("--stop", type=float, help="Seconds from the recording's first pair.")
@FORCE
@AS_JSON
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
    show(done, print_rendered, as_json=as_json)


def print_rendered(done: Rendered) -> None:
    """What was drawn, and what is missing in it."""
    tell(*(f"noted: {line}" for line in done.told))
    shown = f"frame {done.first}" if done.fps is None else f"{done.frames} frames at {done.fps:g}/s"
    tell(f"wrote {done.out}: {shown}, {done.size[0]} x {done.size[1]} px: {', '.join(done.panels)}")
