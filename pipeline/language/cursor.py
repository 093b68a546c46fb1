"""A place in a text's tokens, and what each token was taken for."""

from __future__ import annotations

from collections.abc import Sequence

from vlmm_log.pipeline.language.words import END, Token, also


class Cursor:
    """Reads tokens forward; a rule that fails puts ``at`` back. Each token ends with the role of its last taking."""

    def __init__(self, tokens: Sequence[Token]) -> None:
        self.tokens = tokens
        self.at = 0
        self.behind_target = -1  # place behind the last target of a relation
        self.target_determined = False  # whether that is "the door" rather than "doors"
        self.roles = [""] * len(tokens)  # "word" of a name, "structure", or "unparsed"

    def peek(self, ahead: int = 0) -> Token:
        """The token so far ahead; END before the first and behind the last."""
        return self.tokens[self.at + ahead] if 0 <= self.at + ahead < len(self.tokens) else END

    def value(self, kind: str, ahead: int = 0) -> str | None:
        """The value of a token as that kind; None where it is none."""
        return also(self.peek(ahead), kind)

    def has(self, *kinds: str, ahead: int = 0) -> bool:
        """Whether a token is of one of the kinds."""
        return any(self.value(kind, ahead) is not None for kind in kinds)

    def take(self, role: str = "structure") -> Token:
        """The token here; go on behind it."""
        token = self.peek()
        if token is not END:
            self.roles[self.at] = role
            self.at += 1
        return token

    def accept(self, *kinds: str) -> str | None:
        """Take the token if it is of one of the kinds; its value, else None."""
        for kind in kinds:
            value = self.value(kind)
            if value is not None:
                self.take()
                return value
        return None

    def skip(self, *kinds: str) -> None:
        """Take all tokens of these kinds."""
        while self.has(*kinds):
            self.take()

    def tell(self, start: int) -> None:
        """All from ``start`` to here is not understood."""
        self.roles[start : self.at] = ["unparsed"] * (self.at - start)

    @property
    def question(self) -> bool:
        """Whether what was read asks "which", "what", "who" or "how many"."""
        asks = ("wh", "person", "count")
        return any(also(t, kind) in asks for t in self.tokens[: self.at] for kind in ("thing", "count"))

    @property
    def done(self) -> bool:
        """Whether all was read."""
        return self.at >= len(self.tokens)

    def unparsed(self) -> tuple[str, ...]:
        """Texts of the tokens that no rule took, neighbours joined."""
        groups: list[list[str]] = []
        for i, (token, role) in enumerate(zip(self.tokens, self.roles, strict=True)):
            if role in ("", "unparsed"):
                joined = i > 0 and self.roles[i - 1] in ("", "unparsed")
                groups[-1].append(token.text) if joined else groups.append([token.text])
        return tuple(" ".join(group) for group in groups)
