"""``view``: what it would start, what it says is missing, and the page that it serves."""

import json
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from contextlib import contextmanager
from itertools import chain
from pathlib import Path

import pytest

import render_room
import vlmm_log
from vlmm_log.types import InputError
from vlmm_log.viewing import prepare


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs")
    render_room.write_tum(folder / "room", 5)
    vlmm_log.process(folder / "room", rrd=folder / "a.rrd", mcap=folder / "a.mcap")
    return folder / "a.rrd", folder / "a.mcap"


def test_one_recording_is_opened_as_it_is(recordings, tmp_path):
    path = recordings[0]
    viewed = prepare([path], tmp_path, web=False)
    assert (viewed.file, viewed.told) == (path, ())
    assert viewed.command[1:] == (str(path), "--bind", "127.0.0.1")


def test_an_mcap_is_shown_as_the_recording_that_it_could_have_been(recordings, tmp_path):
    viewed = prepare(recordings[1:], tmp_path, web=False)
    assert viewed.file.suffix == ".rrd"
    assert vlmm_log.diff(recordings[1], viewed.file).same
    looks = {e.entity for e in vlmm_log.diff(recordings[0], viewed.file).entities}
    steps = {
        "flow/fb_error",
        "residual/d_m",
        "residual/p_stat",
        "residual/norm",
        "residual/sigma_z",
    }  # here they are floats
    units = {"depth"}  # its range is in the source's units there, in millimetres here
    named = {"instances"}  # the nameless have names of their own here: their numbers
    assert looks <= {f"world/camera/image/{name}" for name in steps | units | named}


def test_two_recordings_are_merged(recordings, tmp_path):
    viewed = prepare(recordings, tmp_path, web=False)
    assert viewed.file.stat().st_size > recordings[0].stat().st_size
    assert viewed.file.parent == tmp_path


@pytest.mark.parametrize(("share", "incomplete"), [(0.9999, False), (0.5, True)])  # without the footer; in the middle
def test_of_a_torn_recording_what_is_whole_is_shown_and_the_rest_told(recordings, tmp_path, share, incomplete):
    torn = tmp_path / "torn.rrd.partial"
    data = recordings[0].read_bytes()
    torn.write_bytes(data[: int(share * len(data))])
    viewed = prepare([torn], tmp_path, web=False)
    assert viewed.file.name == "torn.rrd"
    assert any("incomplete" in line for line in viewed.told) == incomplete
    assert any("did not finish" in line for line in viewed.told)
    verify = [sys.executable, "-m", "rerun_cli", "rrd", "print", viewed.file]
    assert subprocess.run(verify, capture_output=True, check=False).returncode == 0


def test_what_is_no_recording_is_refused(tmp_path):
    (tmp_path / "map.json").write_text("{}")
    for name in ("map.json", "absent.rrd"):
        with pytest.raises(InputError, match="not a recording"):
            prepare([tmp_path / name], tmp_path, web=False)


def free_port():
    """One whose follower is free, too."""
    with socket.socket() as s, socket.socket() as beside:
        s.bind(("127.0.0.1", 0))
        port = s.getsockname()[1]
        beside.bind(("127.0.0.1", port + 1))
    return port


def listening(pid):
    """(address, port) of the listening sockets of a process: of IPv4 and IPv6."""
    held = {str(link.readlink()) for link in Path(f"/proc/{pid}/fd").iterdir()}
    tables = [Path(f"/proc/{pid}/net/{name}").read_text().splitlines()[1:] for name in ("tcp", "tcp6")]
    rows = [row.split() for row in chain(*tables)]
    own = [row[1].split(":") for row in rows if row[3] == "0A" and f"socket:[{row[9]}]" in held]
    return {(address, int(port, 16)) for address, port in own}


LOOPBACK = "0100007F"  # 127.0.0.1 as /proc/net/tcp writes it
on_linux = pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="no /proc/net/tcp to see sockets in")


@on_linux
def test_a_viewer_window_listens_on_loopback_alone(recordings, tmp_path):
    port = free_port()
    command = [*prepare(recordings[:1], tmp_path, web=False).command, "--headless", "--port", str(port)]
    with open_viewer(command) as viewer:
        assert eventually(lambda: listening(viewer.pid)) == {(LOOPBACK, port)}


@contextmanager
def open_viewer(command):
    viewer = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield viewer
    finally:
        viewer.terminate()
        viewer.wait(timeout=20)


def eventually(ask, timeout_s=60):
    """The first answer that is not empty."""
    deadline = time.monotonic() + timeout_s
    while not (answer := ask()) and time.monotonic() < deadline:
        time.sleep(0.2)
    return answer


def page_at(port):
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}", timeout=5) as answer:
            return answer.read()
    except OSError:
        return b""


def test_the_page_is_served_on_loopback(recordings):
    port = free_port()
    command = [sys.executable, "-c", "from vlmm_log.cli import main; main()"]
    command += ["view", recordings[0], "--web", "--port", str(port), "--json"]
    serving = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    try:
        assert b"rerun" in eventually(lambda: page_at(port)).lower()
        if Path("/proc/net/tcp").exists():
            (viewer,) = Path(f"/proc/{serving.pid}/task/{serving.pid}/children").read_text().split()
            assert listening(viewer) == {(LOOPBACK, port), (LOOPBACK, port + 1)}, "the page and its data, no more"
            assert not listening(serving.pid)
    finally:
        serving.send_signal(signal.SIGTERM)
        assert serving.wait(timeout=20) == 0
    told = json.loads(serving.stdout.read())
    assert told == {"file": str(recordings[0]), "told": [], "url": told["url"]}
    assert told["url"].startswith(f"http://127.0.0.1:{port}?url=rerun")
    for own in (port, port + 1):
        with socket.socket() as s:
            assert s.connect_ex(("127.0.0.1", own)), "the viewer ended, too"
