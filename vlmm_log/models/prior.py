"""The movability prior: "can a LABEL move?" as rho in [0, 1], asked once a label (paper, section III-D).

From a table with its sources, from names near the label, or from a language model that the user names.
"""

from __future__ import annotations

import csv
import hashlib
import json
import re
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from importlib.resources import files
from pathlib import Path
from typing import Protocol

import numpy as np

from vlmm_log.elements import Movability
from vlmm_log.models.endpoint import Endpoint, EndpointError, parsed
from vlmm_log.models.weights import user_cache
from vlmm_log.protocols import Embedder, MovabilityPrior
from vlmm_log.settings import ObjectSettings
from vlmm_log.types import Float32, InputError

UNKNOWN = Movability(0.5, "unknown")
TABLE = files("vlmm_log") / "data" / "movability.csv"
NEAR = 0.5  # similarity from which a name of the table speaks for another one
NEIGHBOURS = 3
FAILURES = 2  # in a row, then the endpoint is not asked again
PROMPT = 1  # version of the question: a change of its wording makes cached answers stale
QUESTION = (
    "You judge objects seen by a robot's camera indoors. Answer with a JSON object and nothing else: "
    '{"movability": x}, x from 0 (fixed, part of the building) to 1 (moves by itself, or is picked up or pushed '
    "about in everyday use)."
)


class TextFeatures(Protocol):
    """What the prior asks of an Embedder."""

    def texts(self, texts: Sequence[str]) -> Float32:
        """(m, D) unit features."""
        ...


def read_table() -> dict[str, Movability]:
    """The table that ships, by normal name."""
    rows = csv.DictReader(TABLE.read_text("utf-8").splitlines())
    return {r["name"]: Movability(float(r["rho"]), f"table: {r['source']}") for r in rows}


def normal(label: str) -> str:
    """Lower case, words apart: "TVStand", "tv_stand" and "TV-stand" are one name."""
    words = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z]{2})", " ", label)
    return " ".join(re.split(r"[\s_-]+", words.lower())).strip()


def _other_numbers(name: str) -> Iterator[str]:
    """The name as singular and as plural, by English endings."""
    for ending, singular in (("ies", "y"), ("ves", "f"), ("ves", "fe"), ("es", ""), ("s", "")):
        if name.endswith(ending):
            yield name.removesuffix(ending) + singular
    yield name + "s"


class TablePrior:
    """The table; for a name it lacks, the names nearest to it in an embedder's text space."""

    def __init__(self, embed: TextFeatures, table: Mapping[str, Movability]) -> None:
        self._embed, self._table, self._names = embed, table, sorted(table)
        self._known: dict[str, Movability] = {}

    def __call__(self, label: str) -> Movability:
        """See protocols.MovabilityPrior. 0.5 where nothing in the table is near."""
        name = normal(label)
        if name not in self._known:
            self._known[name] = self._looked_up(name)
        return self._known[name]

    def _looked_up(self, name: str) -> Movability:
        if not name:
            return UNKNOWN
        exact = next((n for n in (name, *_other_numbers(name)) if n in self._table), None)
        return self._table[exact] if exact else self._transferred(name)

    def _transferred(self, name: str) -> Movability:
        similarity = self._similarities(name).round(4)  # so that equals are in the names' order on every machine
        nearest = np.argsort(-similarity, kind="stable")[:NEIGHBOURS]
        near = [int(i) for i in nearest if similarity[i] >= NEAR]
        if not near:
            return UNKNOWN
        rho = np.average([self._table[self._names[i]].rho for i in near], weights=similarity[near])
        told = ", ".join(f"{self._names[i]} {similarity[i]:.2f}" for i in near)
        return Movability(round(float(rho), 4), f"similar to {told}")

    def _similarities(self, name: str) -> Float32:
        """Cosines (n,) with the table's names, about their mean: in some text spaces all texts lie on one side."""
        names, centre = self._space
        return np.asarray(names @ _unit(self._embed.texts([name]) - centre)[0])

    @cached_property
    def _space(self) -> tuple[Float32, Float32]:
        """Unit features (n, D) of the table's names about their mean, and that mean (D,). Made once needed."""
        features = self._embed.texts(self._names)
        centre = features.mean(axis=0)
        return _unit(features - centre), centre


def _unit(rows: Float32) -> Float32:
    return np.asarray(rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-9), np.float32)


class LlmPrior:
    """A language model's answers, kept on disk; another prior where it gives none, which the source then says."""

    def __init__(self, endpoint: Endpoint, fallback: MovabilityPrior, folder: Path) -> None:
        """Answers are kept in ``folder``, one file an endpoint, model and prompt."""
        self.endpoint, self._fallback = endpoint, fallback
        self._key = {"endpoint": endpoint.where, "model": endpoint.model, "prompt": PROMPT}
        digest = hashlib.sha256(json.dumps(self._key).encode()).hexdigest()[:16]
        self._file = folder / f"{digest}.json"
        self._cached = self._stored()
        self._known: dict[str, Movability] = {}
        self._failures = 0  # in a row

    def __call__(self, label: str) -> Movability:
        """See protocols.MovabilityPrior. Raises nothing: an endpoint that is down is told by the source."""
        name = normal(label)
        if name not in self._known:
            self._known[name] = self._judged(name)
        return self._known[name]

    def _judged(self, name: str) -> Movability:
        if not name:
            return self._fallback(name)
        if name in self._cached:
            return Movability(self._cached[name], f"llm: {self.endpoint.model}")
        if self._failures >= FAILURES:
            return self._fallen_back(name, f"not asked after {FAILURES} failures in a row")
        try:
            rho = self._asked(name)
        except EndpointError as e:
            self._failures += 1
            return self._fallen_back(name, e.reason)
        self._failures = 0
        if rho is None:
            return self._fallen_back(name, "malformed answer")
        self._cached[name] = rho
        return Movability(rho, f"llm: {self.endpoint.model}{self._store()}")

    def _asked(self, name: str) -> float | None:
        """What the model says; None where it answers malformed twice. Raises EndpointError."""
        question = f"Can this object move? {json.dumps({'label': name})}"
        for text in (question, f'{question}\nOnly a JSON object like {{"movability": 0.25}} can be read.'):
            rho = _movability(self.endpoint.ask(QUESTION, text))
            if rho is not None:
                return rho
        return None

    def _fallen_back(self, name: str, why: str) -> Movability:
        judged = self._fallback(name)
        return Movability(judged.rho, f"{judged.source} (llm: {why})")

    def _stored(self) -> dict[str, float]:
        """Answers on disk. A file that is absent, damaged or of another endpoint holds none, and is written anew."""
        try:
            stored = parsed(self._file.read_bytes())
            if any(stored[name] != value for name, value in self._key.items()):
                return {}
            return {str(name): float(rho) for name, rho in stored["answers"].items() if _is_share(rho)}
        except (OSError, ValueError, LookupError, TypeError, AttributeError):
            return {}

    def _store(self) -> str:
        """Write beside and rename: a reader finds the old file or the new one. Gives what to tell if that fails.

        Answers that another process wrote meanwhile are kept; of two that write in the same moment one wins.
        """
        self._cached = self._stored() | self._cached
        written = json.dumps({**self._key, "answers": dict(sorted(self._cached.items()))}, indent=1)
        try:
            self._file.parent.mkdir(parents=True, exist_ok=True)
            with tempfile.NamedTemporaryFile("w", dir=self._file.parent, suffix=".part", delete=False) as f:
                beside = Path(f.name)
                f.write(written)
            beside.replace(self._file)
        except OSError as e:
            return f" (not cached: {e.strerror or type(e).__name__})"
        return ""


def _movability(answer: str) -> float | None:
    try:
        rho = parsed(answer)["movability"]
    except (ValueError, LookupError, TypeError):
        return None
    return float(rho) if _is_share(rho) else None


def _is_share(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and 0 <= value <= 1  # NaN is not


def load_prior(s: ObjectSettings, embed: Embedder) -> tuple[MovabilityPrior, dict[str, str]]:
    """The prior that the settings name, and what decides its result.

    Raises InputError for an unknown prior, and for an endpoint that may not be asked.
    """
    kind, _, url = s.prior.partition(":")
    if s.prior != "table" and (kind != "llm" or not url):
        raise InputError(f"objects.prior {s.prior!r}: no such prior; it is table or llm:URL")
    versions = {"movability table": f"sha256:{hashlib.sha256(TABLE.read_bytes()).hexdigest()}"}
    table = TablePrior(embed, read_table())
    if s.prior == "table":
        return table, versions
    endpoint = Endpoint(url, s.llm_model)
    versions["movability endpoint"] = f"{endpoint.where} {endpoint.model} prompt {PROMPT}"
    return LlmPrior(endpoint, table, user_cache().with_name("movability")), versions
