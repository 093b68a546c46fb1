"""``vlmm-log`` as a process of its own, forked where its libraries are loaded already: a second less a call."""

from __future__ import annotations

import multiprocessing
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

SERVER = multiprocessing.get_context("forkserver")
LOADED = ["api", "cli", "conversion", "fleet", "assessment", "compare", "sinks.rerun"]
SERVER.set_forkserver_preload(
    ["command_line", "killing", "rerun.chunk", "sklearn.feature_extraction", *(f"vlmm_log.{name}" for name in LOADED)]
)


@dataclass(frozen=True)
class Done:
    """What came of a command."""

    returncode: int  # negative: the signal that ended it
    stdout: str
    stderr: str


def command(*args: object, cwd: Path, before: Callable[[], None] | None = None, timeout: float = 300) -> Done:
    """A command that ends, in a folder; ``before`` is called in its process, and must be known by name there."""
    with TemporaryDirectory() as told:
        child = SERVER.Process(target=run, args=(str(cwd), tuple(map(str, args)), told, dict(os.environ), before))
        child.start()
        child.join(timeout)
        if child.is_alive():
            child.kill()
            raise AssertionError(f"{args} hangs")
        return Done(child.exitcode, *(Path(told, name).read_text() for name in ("stdout", "stderr")))


def run(cwd: str, args: tuple[str, ...], told: str, env: dict[str, str], before: Callable[[], None] | None) -> None:
    """In the forked process."""
    from vlmm_log.cli import main

    os.chdir(cwd)
    os.environ.clear()
    os.environ.update(env)
    for number, name in ((1, "stdout"), (2, "stderr")):
        os.dup2(os.open(Path(told, name), os.O_WRONLY | os.O_CREAT), number)
    sys.argv = ["vlmm-log", *args]
    if before is not None:
        before()
    main()


def no_network() -> None:
    """From now on a socket is an error, in this process."""

    def refuse(event: str, _: object) -> None:
        if event.startswith("socket."):
            raise RuntimeError(event)

    sys.addaudithook(refuse)
