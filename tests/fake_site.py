"""A site with files on the loopback: ranges, validators, redirects, and connections that are cut."""

from __future__ import annotations

import re
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler

from loopback import serving


@dataclass
class Served:
    """What lies at a path."""

    body: bytes = b""
    tag: str = '"1"'
    ranges: bool = True  # whether it is sent from the middle
    compares: bool = True  # If-Range with the tag, before a range is sent
    cuts: list[int] = field(default_factory=list)  # bytes after which the connection is closed, a request each
    status: list[int] = field(default_factory=list)  # instead of an answer, a request each; the last for ever
    headers: dict[str, str] = field(default_factory=dict)


class FakeSite:
    """``files`` by path, and the ``asked`` headers of each request."""

    def __init__(self, url):
        self.url, self.files, self.asked = url, {}, []


@contextmanager
def fake_site():
    """A FakeSite while the block lasts."""
    with serving(_Handler) as (url, server):
        server.site = FakeSite(url)
        yield server.site


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    def do_GET(self):
        site = self.server.site
        site.asked.append((self.path, dict(self.headers)))
        served = site.files.get(self.path, Served(status=[404]))
        self.close_connection = True
        if served.status:
            status = served.status.pop(0) if len(served.status) > 1 else served.status[0]
            return self._head(status, 0, served.headers) if status else self._send(served)
        return self._send(served)

    def _send(self, served):
        start = re.fullmatch(r"bytes=(\d+)-", self.headers.get("Range", ""))
        same = not served.compares or self.headers.get("If-Range") == served.tag
        begin = int(start[1]) if start and served.ranges and same else 0
        tag = {"ETag": served.tag} if served.tag else {}
        if begin >= len(served.body) > 0:
            return self._head(416, 0, {"Content-Range": f"bytes */{len(served.body)}"})
        length = len(served.body) - begin
        if begin:
            tag["Content-Range"] = f"bytes {begin}-{len(served.body) - 1}/{len(served.body)}"
        self._head(206 if begin else 200, length, tag | served.headers)
        upto = served.cuts.pop(0) if served.cuts else length
        with suppress(OSError):  # the client had enough
            self.wfile.write(served.body[begin : begin + upto])
        return None

    def _head(self, status, length, headers):
        self.send_response(status)
        for name, value in {"Content-Length": str(length), "Connection": "close", **headers}.items():
            self.send_header(name, value)
        self.end_headers()

    def log_message(self, *args):
        """Say nothing."""
