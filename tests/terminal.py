"""A command in a terminal of so many columns: what it would show there, escapes and all."""

import fcntl
import os
import pty
import struct
import subprocess
import sys
import termios

COMMAND = [sys.executable, "-c", "from vlmm_log.cli import main; main()"]


def in_terminal(*args, cwd, columns, rows=24, until=None, **variables):
    """Exit code and text of ``vlmm-log *args`` where stdout and stderr are one terminal. Killed at ``until``."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))
    unset = ("COLUMNS", "LINES", "NO_COLOR", "FORCE_COLOR")
    known = {name: value for name, value in os.environ.items() if name not in unset}
    env = known | {"TERM": "xterm-256color"} | variables
    command = [*COMMAND, *map(str, args)]
    with subprocess.Popen(command, cwd=cwd, env=env, stdin=theirs, stdout=theirs, stderr=theirs) as running:
        os.close(theirs)
        shown = b""
        while True:
            try:
                piece = os.read(ours, 65536)
            except OSError:  # its last writer is gone
                break
            if not piece:
                break
            shown += piece
            if until is not None and until.encode() in shown:
                running.kill()
    os.close(ours)
    return running.returncode, shown.decode()
