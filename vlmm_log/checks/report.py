"""What an examination finds: findings with their remedy, and evidence for what is in order or cannot be told."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field


@dataclass(frozen=True)
class Finding:
    """Something that is wrong."""

    check: str  # "pose convention", "depth scale", ...
    message: str  # one line, with the figures that decide
    remedy: str  # what to add to the command line, or a sentence where only the user can mend it
    figures: dict[str, float] = field(default_factory=dict)  # named with their units


@dataclass(frozen=True)
class Evidence:
    """Something that was examined and is in order, or that the data do not decide."""

    check: str
    message: str
    figures: dict[str, float] = field(default_factory=dict)


Told = Iterator[Finding | Evidence]
"""What a check says."""


@dataclass(frozen=True)
class Diagnosis:
    """All that was found in a source."""

    source: str
    findings: tuple[Finding, ...]
    evidence: tuple[Evidence, ...]

    @property
    def remedies(self) -> str:
        """All that is to be added to the command line."""
        return " ".join(f.remedy for f in self.findings if sets_of(f.remedy))

    def report(self) -> dict[str, object]:
        """As JSON holds it: what is not known is left out of the figures."""
        findings, evidence = ([_plain(x) for x in told] for told in (self.findings, self.evidence))
        return {"source": self.source, "findings": findings, "evidence": evidence, "remedies": self.remedies}


def _plain(told: Finding | Evidence) -> dict[str, object]:
    return asdict(told) | {"figures": {name: x for name, x in told.figures.items() if math.isfinite(x)}}


def sets_of(remedy: str) -> tuple[str, ...]:
    """The ``a.b=v`` texts of a remedy's flags; none where it is a sentence."""
    if not remedy.startswith("--"):
        return ()
    words = shlex.split(remedy)
    values = zip(words[::2], words[1::2], strict=True)
    return tuple(f"read.intrinsics={value}" if flag == "--intrinsics" else value for flag, value in values)
