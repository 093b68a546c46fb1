"""``view``: a recording in the Rerun viewer; two as their merged recording."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from vlmm_log.recording import Recording, is_mcap, is_recording, open_recording
from vlmm_log.scratch import scratch
from vlmm_log.types import InputError, RunEnd

WEB_PORT, GRPC_PORT = 9090, 9876
LOOPBACK = "127.0.0.1"  # the viewer itself would listen on every interface, without --web too


@dataclass(frozen=True)
class Viewed:
    """What is shown."""

    file: Path
    told: tuple[str, ...]  # what is missing of it
    command: tuple[str, ...]  # that shows it
    url: str  # of the page that shows it; "" of a window

    def report(self) -> dict[str, object]:
        """For scripts."""
        return {"file": str(self.file), "told": list(self.told), "url": self.url or None}


def prepare(files: Sequence[Path], folder: Path, *, web: bool, port: int = WEB_PORT) -> Viewed:
    """The command that shows one recording, or two side by side, merged into ``folder``.

    Any viewer takes connections, from this machine alone here. Raises InputError where a file is no recording.
    """
    for path in files:
        if not path.is_file() or not is_recording(path):
            raise InputError(f"{path}: not a recording; give a .rrd or .mcap")
    told: list[str] = []
    opened = [open_recording(path) for path in files]
    for path, recording in zip(files, opened, strict=True):
        if recording.end is None or not recording.end.complete:
            told.append(f"{path}: incomplete: its run was interrupted or cut off")
        told += [f"{path}: {loss}" for loss in recording.losses]
    shown = files[0]
    if len(files) == 2:
        from vlmm_log.compare import diff

        shown = folder / "merged.rrd"
        diff(files[0], files[1], rrd=shown)
    elif is_mcap(shown):  # its importer knows neither our layout nor the frames' numbers
        shown = _as_rrd(opened[0], folder / "recording.rrd")
    elif opened[0].file != shown or shown.name.endswith(
        ".partial"
    ):  # the viewer goes by the name, and reads no torn end
        shown = Path(shutil.copy(opened[0].file, folder / shown.name.removesuffix(".partial")))
    served = ("--web-viewer", "--web-viewer-port", str(port), "--port", str(_beside(port))) if web else ()
    command = (str(_viewer()), str(shown), "--bind", LOOPBACK, *served)
    url = f"http://{LOOPBACK}:{port}?url=rerun%2Bhttp://{LOOPBACK}:{_beside(port)}/proxy" if web else ""
    return Viewed(shown, tuple(told), command, url)


def _as_rrd(recording: Recording, target: Path) -> Path:
    """The same content as a Rerun recording."""
    from vlmm_log.sinks.redrawn import Redrawn
    from vlmm_log.sinks.rerun import RerunFile

    container = RerunFile(target, recording.run)
    drawn = Redrawn(container)
    try:
        for entry in recording.entries(recording.entities):
            drawn.put(entry)
        drawn.rest()
    finally:  # a refused message leaves no open file
        container.finish(recording.end or RunEnd(False, "", 0, 0))
    return target


def _viewer() -> Path:
    """The program itself: ending the script around it would leave it running."""
    import rerun_cli

    return Path(rerun_cli.__file__).with_name("rerun.exe" if sys.platform == "win32" else "rerun")


def _beside(port: int) -> int:
    return GRPC_PORT if port == WEB_PORT else port + 1


def view(
    files: Sequence[Path], *, web: bool = False, port: int = WEB_PORT, tell: Callable[[Viewed], None] = lambda _: None
) -> None:
    """Show recordings until the viewer is closed. ``tell`` hears before what is shown.

    Raises InputError as ``prepare`` does, and where the viewer cannot be started or ends otherwise.
    """
    with scratch() as folder:
        viewed = prepare(files, Path(folder), web=web, port=port)
        tell(viewed)
        code = _shown(viewed.command)
    if code:
        how = f"was ended by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
        raise InputError(f"the viewer {how}; the recordings are as they were")


def _shown(command: Sequence[str]) -> int:
    """Run the viewer until it is closed, or this program is asked to end; its exit code."""

    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, stop)
    try:
        with subprocess.Popen(command) as viewer:
            try:
                return viewer.wait()
            finally:
                viewer.terminate()
    except KeyboardInterrupt:
        return 0
    except OSError as e:
        raise InputError(f"{command[0]}: the viewer cannot be started: {e.strerror or e}; reinstall rerun-sdk") from e
    finally:
        signal.signal(signal.SIGTERM, before)
