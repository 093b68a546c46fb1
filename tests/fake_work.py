"""Work for the engines of a batch that needs no log: what it does stands in the task's queries."""

import os
import signal
import time
from pathlib import Path

from vlmm_log.batches.tasks import Outcome, State


def work(task):
    (what,) = task.queries
    match what:
        case "die":
            os.kill(os.getpid(), signal.SIGKILL)
        case "abort":
            os.abort()
        case "exit":
            os._exit(7)
        case "die once":
            marker = Path(task.out) / "died"
            if not marker.exists():
                marker.touch()
                os.kill(os.getpid(), signal.SIGKILL)
        case "print":
            print("no outcome", flush=True)
            os.write(1, b"nor this\n")
        case "tick":
            while True:
                (Path(task.out) / "ticks").write_text(str(time.monotonic_ns()))
                time.sleep(0.02)
    return Outcome(task.source, State.DONE, row={"threads": os.environ["OMP_NUM_THREADS"]})
