"""The file of a Rerun recording, written by ourselves: Rerun's own writer ends at the first refused write.

Whoever then flushes the stream, or only lets go of it, may wait for ever (rerun-sdk 0.41). So Rerun writes into a pipe,
which takes everything.
"""

from __future__ import annotations

import fcntl
import os
from contextlib import suppress
from pathlib import Path
from threading import Thread
from types import TracebackType

import rerun as rr
import rerun.blueprint as rrb

PATIENCE_S = 60.0
FOOTER = b"RRF2FOOT"  # starts the last twelve bytes of a whole recording
PIPE = 1 << 20  # bytes that may wait for the disk


class RrdFile:
    """Takes all that a stream is given from now on. Raises OSError where there can be no such file."""

    def __init__(self, rec: rr.RecordingStream, path: Path, blueprint: rrb.Blueprint | None = None) -> None:
        self._rec, self._path = rec, path
        self._failure: OSError | None = None
        self._file = path.open("wb", buffering=0)
        read, write = os.pipe()
        if hasattr(fcntl, "F_SETPIPE_SZ"):
            with suppress(PermissionError):  # more than this user's share
                fcntl.fcntl(write, fcntl.F_SETPIPE_SZ, PIPE)
        self._copier = Thread(target=self._copy, args=(read,), name=f"writer of {path.name}", daemon=True)
        self._copier.start()
        try:
            rec.save(f"/dev/fd/{write}", default_blueprint=blueprint)
        except RuntimeError as e:  # no such folder here, or too many files are open
            raise OSError(f"{e}") from e
        finally:
            os.close(write)  # the stream has opened its own

    def __enter__(self) -> RrdFile:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def flush(self) -> None:
        """Hand everything over. Raises OSError where the disk refused something before, or takes nothing."""
        try:
            self._rec.flush(timeout_sec=PATIENCE_S)
        except RuntimeError as e:
            raise OSError(f"{e}") from e
        if self._failure is not None:
            raise self._failure

    def finish(self) -> None:
        """Write the footer. Raises OSError where the file is not whole on the disk; it is closed anyway."""
        self.close()
        if self._failure is not None:
            raise self._failure
        with self._path.open("rb") as file:
            file.seek(-len(FOOTER) - 4, os.SEEK_END)
            if not file.read().startswith(FOOTER):
                raise OSError("its footer is missing")

    def close(self) -> None:
        """Let go of the file, whole or not."""
        self._rec.disconnect()  # writes all that waits, and the footer
        self._copier.join()

    def _copy(self, pipe: int) -> None:
        """All that comes, until the stream is disconnected; of what a disk refuses only the reason is kept."""
        waiting = memoryview(bytearray(PIPE))
        with os.fdopen(pipe, "rb", buffering=0) as stream, self._file as file:
            while size := stream.readinto(waiting):
                part = waiting[:size]
                try:
                    while part and self._failure is None:
                        part = part[file.write(part) :]
                except OSError as e:
                    self._failure = e
            try:
                os.fsync(file.fileno())
            except OSError as e:
                self._failure = self._failure or e
