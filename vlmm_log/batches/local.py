"""The local engine: worker processes, each replaced when it dies. A dead worker is its log's failure and no other's."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Sequence
from dataclasses import asdict
from queue import SimpleQueue

from vlmm_log.batches.tasks import Outcome, Running, State, Task, Work, failed
from vlmm_log.batches.threads import ONE_THREAD

START = "import json, sys; sys.path[:] = json.loads(sys.argv[1]); from vlmm_log.batches.worker import serve; "
START += "serve(*sys.argv[2:])"
Ended = SimpleQueue[Outcome | BaseException]


def run_local(tasks: Sequence[Task], work: Work, *, workers: int, retries: int = 0) -> Running:
    """The outcomes of tasks as they end. ``work`` is a function of a module: workers import it by name.

    A task whose process dies is tried ``retries`` times more. Closing the iterator ends the workers at once.
    """
    ended: Ended = SimpleQueue()
    crew = [Worker(work) for _ in range(min(workers, len(tasks)))]
    left = _Left(tasks, len(crew))
    threads = [threading.Thread(target=_attend, args=(w, left, ended, retries), daemon=True) for w in crew]
    for thread in threads:
        thread.start()
    try:
        for _ in tasks:
            outcome = ended.get()
            if isinstance(outcome, BaseException):
                raise outcome
            yield outcome
    finally:
        for worker in crew:
            worker.stop()
        for thread in threads:
            thread.join()


class _Left:
    """Tasks that nobody has taken yet, and how many workers take them."""

    def __init__(self, tasks: Sequence[Task], workers: int) -> None:
        self._tasks, self._workers = deque(tasks), workers
        self._changing = threading.Lock()

    def take(self) -> Task | None:
        """The next one; None where there are no more, and the worker goes."""
        with self._changing:
            if self._tasks:
                return self._tasks.popleft()
            self._workers -= 1
            return None

    def give_back(self, task: Task) -> bool:
        """Whether others take tasks; then one of them does this one, and the worker goes."""
        with self._changing:
            if self._workers == 1:
                return False
            self._tasks.appendleft(task)
            self._workers -= 1
            return True


def _attend(worker: Worker, left: _Left, ended: Ended, retries: int) -> None:
    """Give one worker task after task."""
    try:
        while not worker.stopped and (task := left.take()) is not None:
            try:
                outcome = worker.do(task)
                for _ in range(retries):
                    if isinstance(outcome, Outcome):
                        break
                    outcome = worker.do(task)
            except _NotStartedError as e:
                if left.give_back(task):
                    return
                outcome = str(e)
            ended.put(failed(task, outcome) if isinstance(outcome, str) else outcome)
    except BaseException as e:  # noqa: BLE001  told to who waits for outcomes
        ended.put(e)


class _NotStartedError(Exception):
    """The system gives no more processes."""


class Worker:
    """A process that does one task at a time, started when there is one."""

    def __init__(self, work: Work) -> None:
        paths = json.dumps([path or os.getcwd() for path in sys.path])  # noqa: PTH109
        self.command = [sys.executable, "-P", "-c", START, paths, work.__module__, work.__qualname__]
        self.stopped = False
        self._process: subprocess.Popen[str] | None = None
        self._changing = threading.Lock()

    def do(self, task: Task) -> Outcome | str:
        """What came of a task, or how the process died. Raises _NotStartedError where there can be none."""
        process = self._running()
        if process is None:
            return "interrupted"
        assert process.stdin
        assert process.stdout
        try:
            process.stdin.write(json.dumps(asdict(task)) + "\n")
            process.stdin.flush()
            line = process.stdout.readline()
        except BrokenPipeError:
            line = ""
        if line.endswith("\n"):
            told = json.loads(line)
            return Outcome(**told | {"state": State(told["state"])})
        return _death(process.wait())

    def stop(self) -> None:
        """End the process, whatever it does."""
        with self._changing:
            self.stopped = True
            if self._process is not None:
                self._process.kill()

    def _running(self) -> subprocess.Popen[str] | None:
        with self._changing:
            if self.stopped:
                return None
            if self._process is None or self._process.poll() is not None:
                self._process = self._started()
            return self._process

    def _started(self) -> subprocess.Popen[str]:
        try:
            return subprocess.Popen(
                self.command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                encoding="utf-8",
                env=os.environ | ONE_THREAD,
                start_new_session=True,  # Ctrl-C is for the parent
            )
        except OSError as e:
            raise _NotStartedError(f"no process can be started: {e.strerror or e}; give fewer --workers") from e


def _death(code: int) -> str:
    if code >= 0:
        return f"its process ended with exit code {code}; what it said is above"
    name = signal.Signals(-code).name
    hint = ": out of memory?" if name == "SIGKILL" else ""
    return f"its process was ended by {name}{hint}"
