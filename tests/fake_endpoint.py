"""An OpenAI-compatible endpoint on the loopback that answers by a script."""

from __future__ import annotations

import json
import time
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler

from loopback import serving


@dataclass(frozen=True)
class Reply:
    """One HTTP answer, or none."""

    body: bytes = b""
    status: int = 200
    headers: dict[str, str] = field(default_factory=dict)
    delay_s: float = 0.0
    closes: bool = False  # the connection, with no answer
    told_length: int | None = None  # other than the body's


def says(content, prompt_tokens=7, completion_tokens=3):
    """A chat completion: a text, or anything else as JSON."""
    text = content if isinstance(content, str) else json.dumps(content)
    usage = {"prompt_tokens": prompt_tokens, "completion_tokens": completion_tokens}
    return Reply(json.dumps({"choices": [{"message": {"content": text}}], "usage": usage}).encode())


@dataclass(frozen=True)
class Asked:
    """One request."""

    path: str
    headers: dict[str, str]
    body: dict

    @property
    def user(self):
        """Its last message."""
        return self.body["messages"][-1]["content"]


class FakeEndpoint:
    """``url`` and what was ``asked`` of it. Each request gets the script's next reply, then the last one for ever."""

    def __init__(self, url, script):
        self.url, self.script, self.asked = url, list(script), []

    def reply(self, asked):
        self.asked.append(asked)
        reply = self.script.pop(0) if len(self.script) > 1 else self.script[0]
        return reply(asked) if callable(reply) else reply


@contextmanager
def fake_endpoint(*script):
    """A FakeEndpoint while the block lasts. A script is of Reply, or of functions from Asked to Reply."""
    with serving(_Handler) as (url, server):
        server.fake = FakeEndpoint(f"{url}/v1", script)
        yield server.fake


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"  # connections are kept

    def do_POST(self):
        body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        reply = self.server.fake.reply(Asked(self.path, dict(self.headers), body))
        time.sleep(reply.delay_s)
        self.close_connection = reply.closes or reply.told_length is not None
        if reply.closes:
            return
        self.send_response(reply.status)
        length = len(reply.body) if reply.told_length is None else reply.told_length
        for name, value in {"Content-Length": str(length), **reply.headers}.items():
            self.send_header(name, value)
        self.end_headers()
        with suppress(OSError):  # the client had enough
            self.wfile.write(reply.body)

    def log_message(self, *args):
        """Say nothing."""
