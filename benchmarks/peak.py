"""The most memory that a process held."""

from __future__ import annotations

import resource
from pathlib import Path


def peak_mib() -> float:
    """Of this process alone: `getrusage` begins at what its parent held when it started it."""
    status = Path("/proc/self/status")
    if not status.exists():
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    lines = dict(line.split(":", 1) for line in status.read_text().splitlines())
    return int(lines["VmHWM"].split()[0]) / 1024
