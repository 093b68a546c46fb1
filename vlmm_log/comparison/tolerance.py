"""How far two numbers may be apart, and which entities are compared."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from fnmatch import fnmatchcase

from vlmm_log.types import InputError

TIMES = "stats/stage_ms/*"  # what a stage took is no result


@dataclass(frozen=True)
class Tolerance:
    """|a - b| <= atol + rtol |b|; by entity, else for all. Units are those of the entity (poses: cm and degrees)."""

    atol: float = 0.0
    rtol: float = 0.0
    atols: Mapping[str, float] = field(default_factory=dict)  # pattern of entities -> atol
    rtols: Mapping[str, float] = field(default_factory=dict)

    def check(self, entities: Iterable[str]) -> None:
        """Raise InputError where a pattern fits none of the entities."""
        _check("a tolerance of", (*self.atols, *self.rtols), entities)

    def of(self, entity: str) -> tuple[float, float]:
        """atol and rtol of an entity. The last pattern that fits counts."""
        return _last(self.atols, entity, self.atol), _last(self.rtols, entity, self.rtol)

    @staticmethod
    def parse(atols: Iterable[str], rtols: Iterable[str]) -> Tolerance:
        """From texts: "0.01" for all entities, "world/camera=0.1" for those that fit. Raises InputError."""
        (atol, by_atol), (rtol, by_rtol) = _parsed("--atol", atols), _parsed("--rtol", rtols)
        return Tolerance(atol, rtol, by_atol, by_rtol)


@dataclass(frozen=True)
class Choice:
    """Which entities are compared: patterns as of file names, "world/camera/image/residual/*"."""

    only: tuple[str, ...] = ()
    ignore: tuple[str, ...] = ()

    def check(self, entities: Iterable[str]) -> None:
        """Raise InputError where ``only`` fits none of the entities: nothing would be compared, and all be the same."""
        _check("--only", self.only, entities)

    def takes(self, entity: str) -> bool:
        """Whether an entity is compared. What a stage took is compared only where it is asked for."""
        if self.only and not any(_fits(entity, pattern) for pattern in self.only):
            return False
        ignored = self.ignore if self.only else (*self.ignore, TIMES)
        return not any(_fits(entity, pattern) for pattern in ignored)


def _check(option: str, patterns: Iterable[str], entities: Iterable[str]) -> None:
    known = sorted(entities)
    for pattern in patterns:
        if not any(_fits(entity, pattern) for entity in known):
            near = get_close_matches(pattern.strip("/"), known, 1, 0.0)
            raise InputError(f"{option} {pattern}: no entity is called so{f'; there is {near[0]}' if near else ''}")


def _fits(entity: str, pattern: str) -> bool:
    plain = pattern.strip("/")
    return fnmatchcase(entity, plain) or entity.startswith(f"{plain}/")


def _last(by_pattern: Mapping[str, float], entity: str, otherwise: float) -> float:
    return next((value for pattern, value in reversed([*by_pattern.items()]) if _fits(entity, pattern)), otherwise)


def _parsed(option: str, texts: Iterable[str]) -> tuple[float, dict[str, float]]:
    for_all, by_pattern = 0.0, {}
    for text in texts:
        pattern, equals, number = text.rpartition("=")
        try:
            value = float(number)
        except ValueError:
            value = -1.0
        if not 0 <= value < math.inf or (equals and not pattern):
            raise InputError(f"{option} {text}: give a number of at least 0, or ENTITY=NUMBER")
        if pattern:
            by_pattern[pattern] = value
        else:
            for_all = value
    return for_all, by_pattern
