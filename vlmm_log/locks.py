"""Locks of open files, which end with the process that took them."""

from __future__ import annotations

import errno
import fcntl

NONE_HERE = (errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOLCK)  # as some network mounts say


def locked(descriptor: int) -> bool | None:
    """Whether the file is now this process's alone; None where its file system has no locks.

    Raises OSError where it cannot be asked.
    """
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError as e:
        if e.errno in NONE_HERE:
            return None
        raise
    return True
