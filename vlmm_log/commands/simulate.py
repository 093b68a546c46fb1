"""``vlmm-log simulate``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from vlmm_log.commands.examples import examples
from vlmm_log.commands.options import AS_JSON, FILE, FORCE
from vlmm_log.commands.telling import show, tell
from vlmm_log.progress import progress

if TYPE_CHECKING:
    from vlmm_log.rendering import Simulated


@click.command(
    epilog=examples(
        "vlmm-log simulate kitchen room",
        "vlmm-log simulate bedroom room --noise nguyen --pose-noise 0.2,0.5",
        "vlmm-log simulate living_room room --frames 300 --seed 7",
    )
)
@click.argument("scene", metavar="SCENE")
@click.argument("out", type=FILE)
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
@FORCE
@AS_JSON
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
    show(done, print_simulated, as_json=as_json)


def print_simulated(done: Simulated) -> None:
    """What was rendered."""
    names = len(set(done.visible))
    tell(
        f"  {done.frames} frames of {done.scene}: {len(done.visible)} objects of {names} names are seen "
        f"of {done.things}, {len(done.movers)} move: {', '.join(done.movers)}",
        f"wrote {done.out}",
    )
