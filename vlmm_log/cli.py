"""The command line: its commands, and where errors end, in one line."""

from __future__ import annotations

import io
import os
import sys
import traceback
from contextlib import suppress

import click

from vlmm_log.commands.batch import batch
from vlmm_log.commands.completion import completion
from vlmm_log.commands.convert import convert
from vlmm_log.commands.datasets import datasets
from vlmm_log.commands.diff import diff
from vlmm_log.commands.doctor import doctor
from vlmm_log.commands.evaluate import evaluate
from vlmm_log.commands.examples import examples
from vlmm_log.commands.exits import INTERRUPTED, UNHEARD, UNUSABLE
from vlmm_log.commands.info import info
from vlmm_log.commands.process import process
from vlmm_log.commands.query import query
from vlmm_log.commands.render import render
from vlmm_log.commands.simulate import simulate
from vlmm_log.commands.view import view
from vlmm_log.version import __version__

NO_MEMORY = (
    "failed to map segment",
    "annot allocate",
    "nable to allocate",
    "new thread",
    "nsufficient memory",
    "os error 11",
    "bad_alloc",
)
"""What libraries say instead of raising MemoryError."""
COMMANDS = (batch, completion, convert, datasets, diff, doctor, evaluate, info, process, query, render, simulate, view)


@click.group(
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog=examples(
        "vlmm-log datasets get freiburg3_walking_xyz",
        "vlmm-log info rgbd_dataset_freiburg3_walking_xyz",
        "vlmm-log process rgbd_dataset_freiburg3_walking_xyz --rrd walking.rrd",
        "vlmm-log query walking.rrd 'things that moved'",
        "vlmm-log view walking.rrd",
    ),
)
@click.version_option(__version__, prog_name="vlmm-log")
@click.option("--debug", is_flag=True, help="Show the traceback of an error.")
def cli(debug: bool) -> None:
    """What moved in a recording, and how sure are we?"""


for _command in COMMANDS:
    cli.add_command(_command)


def main() -> None:
    """Run the command line. Exit codes: 0 done, 1 the answer is no, 2 cannot be used, 130 interrupted, 141 unheard."""
    debug = "--debug" in sys.argv[1:]
    _open_streams()
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # no sum takes more; idle threads would spin beside the work
    os.environ.setdefault("OPENCV_LOG_LEVEL", "ERROR")  # a damaged image is told by us, once
    os.environ.setdefault("JOBLIB_MULTIPROCESSING", "0")  # not needed, and it warns where /dev/shm is full
    if not debug:
        sys.unraisablehook = _unraisable
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # an encoding that lacks a letter of a name is no error
    stdout = sys.stdout
    try:
        cli.main(args=[a for a in sys.argv[1:] if a != "--debug"], prog_name="vlmm-log", standalone_mode=False)
    except click.exceptions.NoArgsIsHelpError as e:
        _end(e.format_message())
    except click.ClickException as e:
        where = e.ctx.command_path if isinstance(e, click.UsageError) and e.ctx else "vlmm-log"
        _end(f"{where}: {e.format_message()}")
    except click.exceptions.Abort:
        sys.exit(INTERRUPTED)
    except SystemExit:
        if sys.stdout is not stdout:  # click has put it aside: nobody reads on, and its exit code would be an answer
            sys.exit(UNHEARD)
        raise
    except Exception as e:  # noqa: BLE001  one line for the user, the traceback on request
        if debug:
            with suppress(OSError):
                traceback.print_exc()
            sys.exit(UNUSABLE)
        _end("; ".join([f"vlmm-log: {_told(e)}", *getattr(e, "__notes__", [])]))


def _told(e: Exception) -> str:
    """An error in one line."""
    from vlmm_log.types import InputError

    reason = e.__cause__ if isinstance(e, InputError) else e  # its own words may be names of files
    if _no_memory(reason):
        why = f" ({' '.join(str(e).split())[:200]})" if str(e) else ""
        return f"out of memory{why}: give fewer --workers, or a window by --start and --stop"
    if isinstance(e, InputError):
        return str(e)
    if isinstance(e, OSError):
        return str(e) if e.filename or not e.strerror else f"cannot be written: {e.strerror}"
    return f"internal error: {type(e).__name__}: {' '.join(str(e).split())}; run again with --debug and report it"


def _no_memory(e: BaseException | None) -> bool:
    """Whether memory was missing first of all."""
    if e is None:
        return False
    said = str(getattr(e, "strerror", None) or e)
    return isinstance(e, MemoryError) or any(w in said for w in NO_MEMORY) or _no_memory(e.__cause__)


def _unraisable(told: sys.UnraisableHookArgs) -> None:
    """Half-made objects of libraries complain when they are collected, after the error that is told; ours is a bug."""
    frames = [str(frame.f_globals.get("__name__")) for frame, _ in traceback.walk_tb(told.exc_traceback)]
    rooms = [str(getattr(told.object, "__module__", "")), *frames]
    if any(room.partition(".")[0] == __package__ for room in rooms):
        sys.__unraisablehook__(told)


def _end(line: str) -> None:
    """Say why, if anybody listens, and end."""
    with suppress(OSError):
        click.echo(line, err=True)
    sys.exit(UNUSABLE)


def _open_streams() -> None:
    """Standard streams that the caller closed lead nowhere: else the next file that is opened takes their place."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            lowest = os.open(os.devnull, os.O_RDWR)
            assert lowest == number
            setattr(sys, name, os.fdopen(lowest, "w" if number else "r"))
