"""A download over HTTP that goes on where it was cut, as long as the file there is still the same.

What came so far lies in NAME.partial; NAME.partial.from says of which version of the file it is a part.
"""

from __future__ import annotations

import ipaddress
import json
import os
import re
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO
from urllib.parse import urljoin, urlsplit

from vlmm_log.locks import locked
from vlmm_log.protocols import Progress
from vlmm_log.types import InputError

if TYPE_CHECKING:
    import urllib3
    from urllib3 import BaseHTTPResponse

CHUNK = 1 << 16  # bytes
REDIRECTS = 5
RETRIED = (408, 429, 500, 502, 503, 504)
GOES_ON = "the same command goes on from there"
Tell = Callable[[str], None]


@dataclass(frozen=True)
class Patience:
    """How long a server is waited for."""

    tries: int = 5
    wait_s: float = 1.0  # after the first try; doubles with each
    connect_s: float = 10.0
    read_s: float = 30.0


@dataclass(frozen=True)
class Version:
    """Which content of a URL is meant."""

    url: str
    validator: str = ""  # strong ETag, else Last-Modified: what If-Range takes; "": there is none
    size: int = 0  # bytes; 0: not told


def download(
    url: str, out: Path, partial: Path, *, most: int, progress: Progress, tell: Tell, patience: Patience = Patience()
) -> None:
    """Write what ``url`` holds to ``out``, no more than ``most`` bytes, by way of ``partial``.

    Bytes that an earlier try left there are kept if the server says that they belong to the same content.
    ``progress`` is told MB done and expected, ``tell`` what is not as expected. Raises InputError where no more can be
    had; what came is kept.
    """
    check_url(url)
    try:
        with _held(partial) as f:
            begun = _begun(url, partial)
            if not begun.size or f.tell() != begun.size:
                _persist(url, f, partial, most, progress, tell, patience)
        partial.replace(out)
        _note(partial).unlink(missing_ok=True)
    except OSError as e:
        raise InputError(f"{partial}: cannot be written: {e.strerror or e}; what came is kept") from e


def _persist(
    url: str, f: BinaryIO, partial: Path, most: int, progress: Progress, tell: Tell, patience: Patience
) -> None:
    """Try until the file is whole."""
    from urllib3.exceptions import HTTPError

    for tried in range(patience.tries):
        try:
            with _opened(url, f, partial, patience, tell) as (response, version):
                _check_size(url, version.size, f.tell(), most, partial)
                _note(partial).write_text(json.dumps(asdict(version)), "utf-8")
                _fill(f, response, version, most, progress)
            return
        except HTTPError as e:
            if tried + 1 == patience.tries:
                kept = f"{f.tell() / 1e6:.1f} MB are kept, {GOES_ON}" if f.tell() else "try again later"
                raise InputError(f"{url}: {_reason(e)}; {kept}") from e
            time.sleep(patience.wait_s * 2**tried)


def check_url(url: str, first: str = "") -> None:
    """Raises InputError for what is not asked: anything but https (http from this machine to itself), and secrets."""
    try:
        parts = urlsplit(url)
        host = parts.hostname or ""
    except ValueError:
        raise InputError("no URL that can be asked; write it as https://host/path") from None
    here = parts.scheme == "http" and _is_loopback(host) and (not first or _is_loopback(urlsplit(first).hostname or ""))
    if not host or not (parts.scheme == "https" or here) or not url.isascii() or not url.isprintable() or " " in url:
        raise InputError(f"{parts.scheme}://{host}: only https is asked; write it as https://host/path")
    if "@" in parts.netloc:
        raise InputError(f"{parts.scheme}://{host}: the URL may hold no user or password")


@contextmanager
def _held(partial: Path) -> Iterator[BinaryIO]:
    """The file, open at its end, for this process alone."""
    with partial.open("ab") as f:
        if locked(f.fileno()) is False:
            raise InputError(f"{partial}: another download writes to it; wait for it, or name another folder")
        yield f
        f.flush()
        os.fsync(f.fileno())


@contextmanager
def _opened(
    url: str, f: BinaryIO, partial: Path, patience: Patience, tell: Tell
) -> Iterator[tuple[BaseHTTPResponse, Version]]:
    """The answer whose body comes after what ``f`` holds, and what it is an answer of."""
    import urllib3

    begun = _begun(url, partial)
    if f.tell() and not begun.validator:
        tell("of what was begun it is not known whether it is still the same: from the start")
        _empty(f)
    timeout = urllib3.Timeout(connect=patience.connect_s, read=patience.read_s)
    with urllib3.PoolManager(timeout=timeout) as pool:
        response = _asked(pool, url, f.tell(), begun.validator)
        if f.tell() and not _continues(response, f.tell(), begun):
            why = _why_anew(response, begun)
            if response.status != 200:
                response.close()
                response = _asked(pool, url, 0, "")
            if response.status == 200:
                tell(why)
                _empty(f)
        with response:
            if response.status != (206 if f.tell() else 200):
                raise _refused(url, response.status)
            yield response, _version(url, response)


def _asked(pool: urllib3.PoolManager, url: str, offset: int, validator: str) -> BaseHTTPResponse:
    """The answer of the last of up to REDIRECTS other places: the file, a range of it, or that there is no such range.

    Raises InputError for any other, HTTPError where asking again may help.
    """
    from urllib3.exceptions import HTTPError

    headers = {"Accept-Encoding": "identity", "User-Agent": "vlmm-log"}
    if offset:
        headers |= {"Range": f"bytes={offset}-", "If-Range": validator}
    asked = url
    for _ in range(REDIRECTS + 1):
        response = pool.request("GET", asked, headers=headers, redirect=False, retries=False, preload_content=False)
        location = response.get_redirect_location()
        if not location and response.status in (200, 206, 416):
            if response.headers.get("Content-Type", "").startswith("text/html"):
                response.close()
                raise InputError(f"{asked}: answers with a web page, not with a file; look at it in a browser")
            return response
        response.close()
        if response.status in RETRIED:
            raise HTTPError(f"status {response.status}")
        if not location:
            raise _refused(asked, response.status)
        asked = urljoin(asked, location)
        check_url(asked, url)
    raise InputError(f"{url}: leads to more than {REDIRECTS} other places; give the final one with --url")


def _continues(response: BaseHTTPResponse, offset: int, begun: Version) -> bool:
    """Whether the body is the rest of what was begun; a server may answer a range and forget to compare."""
    if response.status != 206:
        return False
    told = re.fullmatch(r"bytes (\d+)-\d+/(\d+|\*)", response.headers.get("Content-Range", ""))
    same = _validator(response) in ("", begun.validator)
    return same and told is not None and int(told[1]) == offset and told[2] in ("*", str(begun.size))


def _why_anew(response: BaseHTTPResponse, begun: Version) -> str:
    if response.status == 200 and _version(begun.url, response) == begun:
        return "the server cannot go on in the middle: from the start"
    return "the file there is not the one that was begun: from the start"


def _version(url: str, response: BaseHTTPResponse) -> Version:
    _, _, total = response.headers.get("Content-Range", "").rpartition("/")
    length = total if response.status == 206 else response.headers.get("Content-Length", "")
    return Version(url, _validator(response), int(length) if length.isascii() and length.isdigit() else 0)


def _validator(response: BaseHTTPResponse) -> str:
    tag = response.headers.get("ETag", "")
    return tag if tag.startswith('"') else response.headers.get("Last-Modified", "")


def _fill(f: BinaryIO, response: BaseHTTPResponse, version: Version, most: int, progress: Progress) -> None:
    for data in response.stream(CHUNK, decode_content=False):
        if f.tell() + len(data) > most:
            _empty(f)
            raise InputError(f"{version.url}: sends more than the {most / 1e6:.0f} MB that are expected at most")
        f.write(data)
        progress(f.tell() // 10**6, version.size // 10**6)


def _check_size(url: str, size: int, offset: int, most: int, partial: Path) -> None:
    if size > most:
        raise InputError(f"{url}: has {size / 1e6:.0f} MB, more than the {most / 1e6:.0f} MB that are expected at most")
    free = shutil.disk_usage(partial.parent).free
    if size - offset > free:
        needed = f"{(size - offset) / 1e6:.0f} MB are to come, {free / 1e6:.0f} MB are free"
        raise InputError(f"{partial.parent}: {needed}; make room, or name another folder")


def _empty(f: BinaryIO) -> None:
    f.seek(0)
    f.truncate()


def _begun(url: str, partial: Path) -> Version:
    with suppress(OSError, ValueError, TypeError):
        version = Version(**json.loads(_note(partial).read_text("utf-8")))
        if version.url == url and isinstance(version.validator, str):
            return version
    return Version(url)


def _note(partial: Path) -> Path:
    return partial.with_name(partial.name + ".from")


def _refused(url: str, status: int) -> InputError:
    if status in (404, 410):
        return InputError(f"{url}: is not there any more (status {status}); give its new place with --url")
    return InputError(f"{url}: status {status}; look at it in a browser, or give another place with --url")


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _reason(e: Exception) -> str:
    from urllib3.exceptions import NewConnectionError, ProtocolError, SSLError
    from urllib3.exceptions import TimeoutError as TimedOut

    match e:
        case NewConnectionError():
            return "cannot be reached"
        case SSLError():
            return "the certificate cannot be trusted"
        case TimedOut():
            return "the server does not go on sending"
        case ProtocolError():
            return "the connection was cut"
        case _:
            return str(e).partition("\n")[0][:80]
