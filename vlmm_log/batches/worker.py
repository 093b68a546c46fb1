"""A worker of the local engine: tasks come in on stdin as lines of JSON, outcomes leave on stdout."""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
from dataclasses import asdict
from importlib import import_module
from queue import SimpleQueue

from vlmm_log.batches.tasks import Task, Work


def serve(module: str, name: str) -> None:
    """Do tasks until stdin ends: then its parent is done, or was killed, and nobody waits for the rest."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent is asked, and decides
    channel = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # what a library prints is no outcome
    tasks: SimpleQueue[Task] = SimpleQueue()
    threading.Thread(target=_listen, args=(tasks,), daemon=True).start()
    work: Work = getattr(import_module(module), name)
    while True:
        channel.write(json.dumps(asdict(work(tasks.get()))) + "\n")
        channel.flush()


def _listen(tasks: SimpleQueue[Task]) -> None:
    for line in sys.stdin:
        told = json.loads(line)
        tasks.put(Task(**told | {name: tuple(told[name]) for name in ("queries", "recordings")}))
    os._exit(0)  # at once, also within a task: its staging folder is swept by whoever comes next
