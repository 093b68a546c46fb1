"""Every command with outputs, in one process: python all_outputs.py WORKERS. ``room`` and ``masks`` lie in the folder.

What is printed goes to NAME.txt, the rest under its own name.
"""

import contextlib
import io
import locale
import sys
from pathlib import Path

PROCESS = ["room", "--segmenter", "masks:room/truth/instances", "--set", "keyframes.gap=1"]
QUERY = ["--query", "things that moved", "--query", "the fastest thing"]


def commands(workers):
    """Name, and what follows ``vlmm-log``."""
    outputs = ["--rrd", "a.rrd", "--mcap", "a.mcap", "--map", "a.json"]
    coarse = ["--set", "noise.scale=2"]
    return {
        "process": ["process", *PROCESS, *QUERY, *outputs, "--workers", workers],
        "coarse": ["process", *PROCESS, *QUERY, *coarse, "--rrd", "b.rrd", "--map", "b.parquet"],
        "query": ["query", "a.json", "everything", "--json", "--grid", "grid.yaml"],
        "diff": ["diff", "a.rrd", "b.rrd", "--json", "diff.json", "--html", "diff.html"],
        "info": ["info", "room", "--json"],
        "doctor": ["doctor", "room", "--json"],
        "eval": ["eval", "room", "--json", "eval.json", "--html", "eval.html", "--calibrate", "calibration.json"],
        "convert": ["convert", "room", "twin.mcap"],
    }


def main():
    """Run them."""
    from vlmm_log.cli import cli

    with contextlib.suppress(locale.Error):
        locale.setlocale(locale.LC_ALL, "")  # as a program around ours may
    for name, arguments in commands(sys.argv[1]).items():
        told = io.StringIO()
        code = 0
        with contextlib.redirect_stdout(told):
            try:
                cli.main(arguments, standalone_mode=False)
            except SystemExit as e:
                code = e.code
        Path(f"{name}.txt").write_text(f"{code}\n{told.getvalue()}", "utf-8")


if __name__ == "__main__":
    main()
