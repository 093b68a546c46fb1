"""An OpenAI-compatible chat-completions endpoint, hosted or local: asked patiently, its cost counted.

The key comes from VLMM_LOG_API_KEY alone and leaves this file only in the request's header.
"""

from __future__ import annotations

import ipaddress
import json
import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any
from urllib.parse import SplitResult, urlsplit

from vlmm_log.types import InputError

if TYPE_CHECKING:
    import urllib3

KEY = "VLMM_LOG_API_KEY"
LARGEST = 1 << 20  # bytes of an answer; a chat completion of this use has about a thousand
SECRET = 12  # characters; local endpoints take words like "ollama" for a key
RETRIED = (429, 500, 502, 503, 504)
REMEDIES = {
    401: f"check {KEY}",
    403: f"check {KEY}",
    404: "check the URL and objects.llm_model",
    429: "wait, or check the quota",
}


class EndpointError(InputError):
    """The endpoint gave no answer that can be used. One line: where, what, remedy."""

    def __init__(self, where: str, reason: str, remedy: str) -> None:
        self.reason = reason
        super().__init__(f"{where}: {reason}; {remedy}")


@dataclass(frozen=True)
class Patience:
    """How long an answer is waited for."""

    retries: int = 3  # after the first try
    backoff_s: float = 0.5  # before the second retry; doubles with each
    longest_wait_s: float = 20.0  # also where Retry-After asks for more
    connect_s: float = 5.0
    read_s: float = 60.0


@dataclass(frozen=True)
class Cost:
    """What was asked of an endpoint so far; tokens as it counts them itself."""

    requests: int = 0  # retries not counted
    retries: int = 0
    prompt_tokens: int = 0
    completion_tokens: int = 0

    def __str__(self) -> str:
        tokens = f"{self.prompt_tokens} + {self.completion_tokens} tokens"
        return f"{self.requests} requests, {self.retries} retries, {tokens}"

    def __add__(self, other: Cost) -> Cost:
        return Cost(
            self.requests + other.requests,
            self.retries + other.retries,
            self.prompt_tokens + other.prompt_tokens,
            self.completion_tokens + other.completion_tokens,
        )


PATIENCE = Patience()


class Endpoint:
    """A connection to one model of one endpoint. ``where`` is its URL, ``cost`` what it took so far."""

    def __init__(self, url: str, model: str, patience: Patience = PATIENCE) -> None:
        """``url`` as far as ``/v1``, or whole. Raises InputError where it cannot be used, or not with the key."""
        import urllib3

        parts = _checked_url(url)
        path = parts.path.rstrip("/")
        self.where = f"{parts.scheme}://{parts.netloc}{path}"
        self.model = model
        self.cost = Cost()
        self._url = self.where + ("" if path.endswith("/chat/completions") else "/chat/completions")
        self._headers = {"Content-Type": "application/json", **_authorization(parts, self.where)}
        self._pool = urllib3.PoolManager(timeout=urllib3.Timeout(connect=patience.connect_s, read=patience.read_s))
        self._retry = urllib3.Retry(
            patience.retries,
            allowed_methods={"POST"},
            status_forcelist=RETRIED,
            backoff_factor=patience.backoff_s,
            backoff_max=patience.longest_wait_s,
            retry_after_max=patience.longest_wait_s,  # type: ignore[arg-type]  # declared as int, used as a number
        )

    def __repr__(self) -> str:
        return f"Endpoint({self.where!r}, {self.model!r})"

    def ask(self, system: str, user: str) -> str:
        """The model's answer, which it was told to give as a JSON object: not checked here. Raises EndpointError."""
        messages = [{"role": "system", "content": system}, {"role": "user", "content": user}]
        asked = {"model": self.model, "messages": messages, "temperature": 0, "seed": 0}
        answer = self._post(json.dumps(asked | {"response_format": {"type": "json_object"}}).encode())
        try:
            completion = parsed(answer)
        except ValueError as e:
            raise self._error("its answer is no JSON") from e
        self.cost += _tokens(completion)
        match completion:
            case {"choices": [{"message": {"content": str(content)}}, *_]}:
                return self._without_key(content)
        raise self._error("its answer is no chat completion")

    def _without_key(self, content: str) -> str:
        """The answer: what an endpoint repeats of the key would be told and recorded with it."""
        _, _, key = self._headers.get("Authorization", "").partition(" ")
        return content.replace(key, "[key]") if len(key) >= SECRET else content

    def _post(self, body: bytes) -> bytes:
        """The body of the first answer with status 200; what may pass is tried again."""
        from urllib3.exceptions import HTTPError, ReadTimeoutError

        retry = self._retry
        self.cost += Cost(requests=1)
        while True:
            response, cause = None, None
            try:
                with self._sent(body) as response:
                    if response.status == 200:
                        return self._read(response)
                error = self._status_error(response.status)
                if not retry.is_retry("POST", response.status):
                    raise error
            except ReadTimeoutError as e:  # it had its time: asking again would take as long once more
                raise self._error(_reason(e)) from e
            except HTTPError as e:
                error, response, cause = self._error(_reason(e)), None, e
            if not retry.total:
                raise error from cause
            retry = retry.increment("POST", self._url, response, cause)
            self.cost += Cost(retries=1)
            try:
                retry.sleep(response)
            except (HTTPError, ValueError, OverflowError) as e:
                raise self._error("its Retry-After is no time") from e

    def _sent(self, body: bytes) -> urllib3.BaseHTTPResponse:
        return self._pool.request(
            "POST",
            self._url,
            body=body,
            headers=self._headers,
            retries=False,  # told by ``_retry`` here: the pool's own would read a refusal's body whole
            redirect=False,  # it could carry the key and the labels elsewhere
            preload_content=False,
            decode_content=False,  # no encoding was asked for
        )

    def _read(self, response: urllib3.BaseHTTPResponse) -> bytes:
        """The body; no more than LARGEST bytes are ever held."""
        data = b""
        if (response.length_remaining or 0) <= LARGEST:
            while len(data) <= LARGEST and (more := response.read(LARGEST + 1 - len(data))):
                data += more
            if len(data) <= LARGEST:
                return data
        raise self._error(f"its answer is longer than {LARGEST} bytes")

    def _status_error(self, status: int) -> EndpointError:
        if 300 <= status < 400:
            return EndpointError(self.where, f"status {status}", "redirects are not followed: give the final URL")
        return EndpointError(self.where, f"status {status}", REMEDIES.get(status, "check the endpoint and its log"))

    def _error(self, reason: str) -> EndpointError:
        return EndpointError(self.where, reason, "check the URL, and that it is an OpenAI-compatible endpoint")


def parsed(text: str | bytes) -> Any:
    """JSON as the standard has it. Raises ValueError, also for NaN, Infinity and what is nested too deeply."""
    try:
        return json.loads(text, parse_constant=_refuse)
    except RecursionError as e:
        raise ValueError("nested too deeply") from e


def _refuse(constant: str) -> None:
    raise ValueError(f"{constant} is no JSON")


def _checked_url(url: str) -> SplitResult:
    """Its parts. What is wrong is told without the URL where that may hold a secret."""
    try:
        parts = urlsplit(url)
        usable = parts.scheme in ("http", "https") and bool(parts.hostname) and parts.port != 0
    except ValueError:  # a port that is no number, an open bracket
        usable = False
    if not usable or not url.isascii() or not url.isprintable() or " " in url:
        raise InputError("llm: no URL that can be asked; write it as llm:http://localhost:11434/v1")
    if "@" in parts.netloc or parts.query or parts.fragment:
        raise InputError(
            f"llm:{parts.scheme}://{parts.hostname}: settings are logged, so the URL may hold no user, password, "
            f"query or fragment; the key comes from {KEY}"
        )
    return parts


def _authorization(parts: SplitResult, where: str) -> dict[str, str]:
    key = os.environ.get(KEY, "").strip()
    if not key:
        return {}
    if not key.isascii() or not key.isprintable():
        raise InputError(f"{KEY}: holds characters that no header may; set it again")
    if parts.scheme == "http" and not _is_loopback(str(parts.hostname)):
        raise InputError(f"{where}: the key in {KEY} is not sent over plain http; use https, or unset it")
    return {"Authorization": f"Bearer {key}"}


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _reason(e: BaseException | None) -> str:
    from urllib3.exceptions import NewConnectionError
    from urllib3.exceptions import TimeoutError as TimedOut

    match e:
        case NewConnectionError():
            return "cannot be reached"
        case TimedOut():
            return "timed out"
        case _:
            return f"no answer ({type(e).__name__})"


def _tokens(completion: object) -> Cost:
    match completion:
        case {"usage": {"prompt_tokens": int(asked), "completion_tokens": int(answered)}}:
            return Cost(prompt_tokens=max(asked, 0), completion_tokens=max(answered, 0))
    return Cost()
