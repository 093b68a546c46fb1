"""Take a picture of a recording in the headless Rerun viewer, and list what the viewer complains about.

    python examples/viewer_picture.py RECORDING.rrd PICTURE.png [FRAME]

Needs Vulkan; a software driver will do (Debian: mesa-vulkan-drivers).
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import cv2
import numpy as np
import rerun_cli
from rerun.experimental import ViewerClient

T = TypeVar("T")
ABOUT_THE_MACHINE = ("egui_wgpu", "re_renderer", "re_viewer::headless", "re_grpc_server", "re_server")


def take_picture(recording: Path, picture: Path, frame: int, size: str = "1280x800") -> list[str]:
    """Write the picture at a frame; give the errors of views and the viewer's own warnings."""
    viewer = Path(rerun_cli.__file__).with_name("rerun")  # the wrapper script would leave it running
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        port = s.getsockname()[1]
    arguments = [
        "--headless",
        "--window-size",
        size,
        "--port",
        str(port),
        "--hide-welcome-screen",
        "--bind",
        "127.0.0.1",
    ]
    with tempfile.TemporaryDirectory() as runtime:
        environment = {**os.environ, "XDG_RUNTIME_DIR": runtime}
        silent = subprocess.DEVNULL
        process = subprocess.Popen([viewer, *arguments], env=environment, stdout=silent, stderr=silent)
        try:
            client = _patient(lambda: _connected(port))
            client.open(str(recording.resolve()))
            _patient(lambda: _shown(client))
            client.set_time("frame", sequence=frame, play_state="paused")
            time.sleep(5)  # images are decoded in the background
            picture.parent.mkdir(parents=True, exist_ok=True)
            _patient(lambda: client.save_screenshot(str(picture.resolve())))
            reports = [f"{view.name}: {report}" for view in client.get_state().views for report in view.reports]
            entries = [e for e in client.get_logs() if e.level in ("WARN", "ERROR")]
            return reports + [e.message for e in entries if not e.target.startswith(ABOUT_THE_MACHINE)]
        finally:
            process.kill()
            process.wait()


def lighten(picture: Path, most_bytes: int = 300_000) -> None:
    """Drop bits of colour until the PNG file is small enough for a README."""
    pixels = cv2.imread(str(picture))
    for bits in (8, 6, 5, 4):
        if picture.stat().st_size <= most_bytes:
            return
        coarse = (pixels >> (8 - bits)) * np.float32(255 / (2**bits - 1))
        cv2.imwrite(str(picture), coarse.astype(np.uint8), [cv2.IMWRITE_PNG_COMPRESSION, 9])


def _connected(port: int) -> ViewerClient:
    client = ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
    client.get_state()
    return client


def _shown(client: ViewerClient) -> None:
    if len(client.get_state().views) < 3:
        raise RuntimeError("the recording is not shown yet")


def _patient(attempt: Callable[[], T], seconds: float = 60) -> T:
    deadline = time.monotonic() + seconds
    while True:
        try:
            return attempt()
        except Exception:  # the client raises many types while the viewer starts
            if time.monotonic() > deadline:
                raise
            time.sleep(1)


if __name__ == "__main__":
    picture = Path(sys.argv[2])
    problems = take_picture(Path(sys.argv[1]), picture, int(sys.argv[3]) if len(sys.argv) > 3 else 0, "1100x680")
    lighten(picture)
    print("\n".join(problems) or f"wrote {picture}")
    sys.exit(bool(problems))
