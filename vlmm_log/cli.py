"""The command line: its commands, and where errors end, in one line."""

from __future__ import annotations

import io
import os
import sys
import traceback

import click

from vlmm_log.commands.batch import batch
from vlmm_log.commands.completion import completion
from vlmm_log.commands.convert import convert
from vlmm_log.commands.datasets import datasets
from vlmm_log.commands.diff import diff
from vlmm_log.commands.doctor import doctor
from vlmm_log.commands.evaluate import evaluate
from vlmm_log.commands.examples import examples
from vlmm_log.commands.exits import INTERRUPTED
from vlmm_log.commands.info import info
from vlmm_log.commands.process import process
from vlmm_log.commands.query import query
from vlmm_log.commands.render import render
from vlmm_log.commands.simulate import simulate
from vlmm_log.commands.view import view
from vlmm_log.version import __version__

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
    """Run the command line. Exit codes: 0 done, 1 the answer is no, 2 cannot be used, 130 interrupted."""
    debug = "--debug" in sys.argv[1:]
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # no sum takes more; idle threads would spin beside the work
    os.environ.setdefault("OPENCV_LOG_LEVEL", "ERROR")  # a damaged image is told by us, once
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # an encoding that lacks a letter of a name is no error
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
