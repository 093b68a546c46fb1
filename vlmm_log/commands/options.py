"""Options that several commands share, and the settings that they make."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from vlmm_log.settings import Settings

Command = Callable[..., None]
Option = Callable[[Command], Command]


def _gap(_context: click.Context, _option: click.Parameter, text: str | None) -> int | str | None:
    """Frames as a number, seconds as they are written."""
    return int(text) if text and len(text) < 5 and text.isascii() and text.isdigit() else text


FILE = click.Path(path_type=Path)
SOURCE = click.argument("source", type=FILE)
SOURCES = click.argument("sources", nargs=-1, required=True, metavar="SOURCE...", type=FILE)

FORCE = click.option("--force", is_flag=True, help="Replace what exists once the new one is complete.")
AS_JSON = click.option("--json", "as_json", is_flag=True, help="Print it as JSON.")

# "a__b" is where the value goes: setting a.b
TOPICS = click.option(
    "--topics", "read__topics", metavar="ROLE=NAME,...", help="Of a bag: rgb, depth, info, depth_info, pose."
)
INTRINSICS = click.option(
    "--intrinsics",
    "read__intrinsics",
    metavar="F|FX,FY,CX,CY",
    help="camera.txt, numbers in px, or freiburg1, bonn, ...",
)
START = click.option("--start", "read__start_s", type=float, help="Seconds from the log's first frame.")
STOP = click.option("--stop", "read__stop_s", type=float, help="Seconds from the log's first frame.")
TOML = click.option("--settings", "toml", type=FILE, help="TOML file of settings.")
SETS = click.option("--set", "sets", multiple=True, metavar="A.B=V", help="One setting; repeat as needed.")
READING = (TOPICS, INTRINSICS, START, STOP, TOML, SETS)

PROFILE = click.option("--profile", help="default, or paper: what the paper prints.")
FLOW = click.option(
    "--flow", "flow__estimator", type=click.Choice(["dis", "raft"]), help="Optical flow: dis needs no weights."
)
WEIGHTS = click.option("--weights", "flow__weights", help="RAFT weights: a file, or a folder with raft*.pth.")
EMBEDDER = click.option(
    "--embedder", "objects__embedder", metavar="NAME", help="words (default), clip, maskclip; clip:WEIGHTS."
)
PRIOR = click.option("--prior", "objects__prior", metavar="NAME", help="Movability prior: table (default) or llm:URL.")
GAP = click.option(
    "--gap",
    "keyframes__gap",
    metavar="K",
    callback=_gap,
    help="Distance of a pair: frames (3) or seconds (0.1s).",
)
CALIBRATION = click.option(
    "--calibration", "calibration__file", help="File of eval --calibrate: p_moving of pixels and elements."
)
DENSE = click.option("--dense", "log__dense", is_flag=True, help="Write full float32 tensors and covariances.")

QUERIES = click.option(
    "--query", "queries", multiple=True, metavar="TEXT", help="Log what it finds at every pair; repeatable."
)


def segmenter(told: str) -> Option:
    """--segmenter, of which each command has something else to tell."""
    return click.option("--segmenter", "objects__segmenter", metavar="NAME", help=told)


def method(of_segmenter: str) -> Option:
    """The options that say how to look at a log."""
    return added(PROFILE, FLOW, WEIGHTS, segmenter(of_segmenter), EMBEDDER, PRIOR, GAP, CALIBRATION, DENSE)


def added(*options: Option) -> Option:
    """Several options as one, in this order in the help."""

    def decorate(command: Command) -> Command:
        for option in reversed(options):
            command = option(command)
        return command

    return decorate


def as_settings(command: Command) -> Command:
    """Call the command with the ``settings`` that its options make."""

    @wraps(command)
    def called(**given: Any) -> None:
        settings = taken(given)
        command(settings=settings, **given)

    return called


def taken(given: dict[str, Any]) -> Settings:
    """The settings of a command's options, which are taken from the others; those not given leave theirs as they are.

    Raises InputError where there is no such setting, or it is out of range.
    """
    from vlmm_log.settings import Settings

    chosen = {name: given.pop(name) for name in list(given) if "__" in name}
    told = {name: value for name, value in chosen.items() if value is not None and value is not False}
    options = {name.replace("__", "."): value for name, value in told.items()}
    return Settings.load(given.pop("profile", None), given.pop("toml"), given.pop("sets"), options)
