"""The Ray engine: tasks on a cluster, or on a local one that is started for them."""

from __future__ import annotations

import logging
import os
import socket
import sys
from collections import deque
from collections.abc import Sequence
from typing import Any

from vlmm_log.batches.tasks import Outcome, Running, Task, Work, failed
from vlmm_log.batches.threads import ONE_THREAD
from vlmm_log.types import InputError

ANSWER_S = 10.0


def run_ray(
    tasks: Sequence[Task], work: Work, *, address: str, workers: int | None, retries: int = 0, gpus: float = 0.0
) -> Running:
    """The outcomes of tasks as they end, at most ``workers`` at a time; None: as many as the cluster has CPUs.

    ``address`` "" starts a cluster on this machine and stops it in the end. A task takes a CPU and a share ``gpus``
    of a GPU, and is tried ``retries`` times more where its process or machine dies. Sources and outputs have the same
    paths on all machines. Raises InputError where Ray is missing, no cluster answers, or none has a GPU.
    """
    return _outcomes(_ray(), tasks, work, address, workers, retries, gpus)


def _outcomes(
    ray: Any, tasks: Sequence[Task], work: Work, address: str, workers: int | None, retries: int, gpus: float
) -> Running:
    theirs = ray.is_initialized()
    if not theirs:
        _connect(ray, address, workers)
    running: dict[Any, Task] = {}
    try:
        if gpus and ray.cluster_resources().get("GPU", 0) < gpus:
            raise InputError(f"engine ray: no GPU in the cluster to take a share of {gpus:g} of; leave out --gpus")
        limit = workers or max(int(ray.cluster_resources().get("CPU", 1)), 1)
        paths = {} if address else {"PYTHONPATH": os.pathsep.join(sys.path)}  # on this machine, what is found here
        environment = {"env_vars": ONE_THREAD | paths}
        remote = ray.remote(num_cpus=1, num_gpus=gpus, max_retries=retries, runtime_env=environment)(work)
        waiting = deque(tasks)
        while waiting or running:
            while waiting and len(running) < limit:
                task = waiting.popleft()
                running[remote.remote(task)] = task
            for ended in ray.wait(list(running))[0]:
                yield _outcome(ray, ended, running.pop(ended))
    finally:
        for ended in running:
            ray.cancel(ended, force=True)
        if not theirs:
            ray.shutdown()


def _outcome(ray: Any, ended: Any, task: Task) -> Outcome:
    try:
        outcome: Outcome = ray.get(ended)
    except ray.exceptions.RayError as e:
        first = next((line.strip() for line in str(e).splitlines() if line.strip()), type(e).__name__)
        return failed(task, f"{type(e).__name__}: {first[:300]}")
    return outcome


def _ray() -> Any:
    try:
        import ray
    except ImportError as e:
        raise InputError("engine ray: needs Ray: pip install 'vlmm-log[ray]'; or take --engine local") from e
    return ray


def _connect(ray: Any, address: str, workers: int | None) -> None:
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    _check_answers(address)
    quiet = {"log_to_driver": False, "logging_level": logging.ERROR}
    try:
        if address:
            ray.init(address=address, **quiet)
        else:
            ray.init(address="local", num_cpus=workers, include_dashboard=False, **quiet)
    except (OSError, RuntimeError, ValueError) as e:
        where = f"ray:{address}" if address else "ray"
        raise InputError(f"engine {where}: cannot connect: {next(iter(str(e).splitlines()), '')[:300]}") from e


def _check_answers(address: str) -> None:
    """Ray itself would wait for minutes where nobody listens."""
    host, colon, port = address.removeprefix("ray://").rpartition(":")
    if colon and port.isdigit():
        try:
            socket.create_connection((host.strip("[]"), int(port)), ANSWER_S).close()
        except (OSError, OverflowError) as e:
            raise InputError(f"engine ray:{address}: no cluster answers there: {e}") from e
