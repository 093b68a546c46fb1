"""The nouns of language: a query as one typed filter tree, and its answer. numpy only."""

from __future__ import annotations

from dataclasses import dataclass

from vlmm_log.types import Float32, Int64, freeze


@dataclass(frozen=True, eq=False)
class Answer:
    """Elements that a query asks for, the best first."""

    text: str  # of the query
    explanation: str  # the filter tree in words, and what could not be parsed
    returns: str  # "objects", "mask" or "count"
    ids: Int64  # (m,)
    scores: Float32  # (m,) what they are ranked by
    reasons: tuple[str, ...]  # (m,) why each is an answer, with the field values that decided

    def __post_init__(self) -> None:
        freeze(self)
