"""Values of a JSON document, taken with their types checked."""

from __future__ import annotations

import base64
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import numpy as np

from vlmm_log.types import Float32, Float64, InputError, Int64

FEATURE_TYPE = "<f4"
_KINDS = {dict: "an object", list: "a list", str: "a text", int: "an integer", float: "a number", bool: "a truth value"}


@dataclass(frozen=True)
class Field:
    """A value, and where it stands. What is not as asked for raises InputError with path and field."""

    value: object
    path: Path
    name: str = ""  # "elements[3].votes"; "" is the whole document

    def wrong(self, why: str) -> InputError:
        """The error to raise."""
        return InputError(f"{self.path}: {self.name}: {why}" if self.name else f"{self.path}: {why}")

    def _of(self, *kinds: type) -> None:
        if type(self.value) not in kinds:
            raise self.wrong(f"is {_KINDS.get(type(self.value), 'null')}, not {_KINDS[kinds[0]]}")

    def names(self) -> list[str]:
        """The names in an object, each of them Unicode."""
        self._of(dict)
        assert isinstance(self.value, dict)
        return [Field(name, self.path, self.name).text() for name in self.value]

    def member(self, name: str) -> Field:
        """One value of an object."""
        self._of(dict)
        assert isinstance(self.value, dict)
        if name not in self.value:
            raise self.wrong(f"lacks {name!r}")
        return Field(self.value[name], self.path, f"{self.name}.{name}" if self.name else name)

    def members(self, names: Sequence[str]) -> list[Field]:
        """All values of an object that has these names and no other."""
        found = [self.member(name) for name in names]
        unknown = sorted(set(self.names()) - set(names))
        if unknown:
            raise self.wrong(f"has a field {unknown[0][:60]!r} that this version does not know")
        return found

    def items(self) -> list[Field]:
        """The values of a list."""
        return [Field(v, self.path, f"{self.name}[{i}]") for i, v in enumerate(self._list())]

    def length(self) -> int:
        """Of a list."""
        return len(self._list())

    def _list(self) -> list[object]:
        self._of(list)
        assert isinstance(self.value, list)
        return self.value

    def text(self) -> str:
        """A text that is Unicode."""
        self._of(str)
        assert isinstance(self.value, str)
        if not _is_unicode(self.value):
            raise self.wrong("is no Unicode text: half of a surrogate pair")
        return self.value

    def truth(self) -> bool:
        """True or false."""
        self._of(bool)
        return self.value is True

    def integer(self) -> int:
        """An integer of 64 bits."""
        self._of(int)
        return int(self.integers_of([self.value])[0])

    def number(self) -> float:
        """A number."""
        self._of(float, int)
        return float(self.floats_of([self.value])[0])

    def integers(self, *row: int) -> Int64:
        """(n, *row) int64 of a list of integers, or of rows of so many."""
        return self.integers_of(self._flat(*row)).reshape(-1, *row)

    def floats(self, *row: int) -> Float64:
        """(n, *row) float64 of a list of numbers, or of rows of so many."""
        return self.floats_of(self._flat(*row)).reshape(-1, *row)

    def vector(self, length: int) -> Float32:
        """(length,) of a list of so many numbers."""
        values = self.floats()
        if values.size != length:
            raise self.wrong(f"has {values.size} numbers, not {length}")
        return single(values)

    def feature(self) -> Float32:
        """(D,) of base64 with a stated type."""
        dtype, data = self.members(["dtype", "base64"])
        if dtype.text() != FEATURE_TYPE:
            raise dtype.wrong(f"is {dtype.text()[:20]!r}, not {FEATURE_TYPE!r}")
        try:
            return np.frombuffer(base64.b64decode(data.text(), validate=True), FEATURE_TYPE).astype(np.float32)
        except ValueError as e:
            raise data.wrong(f"is not base64 of {FEATURE_TYPE} numbers") from e

    def _flat(self, *row: int) -> list[object]:
        values = self._list()
        for length in row:
            if not set(map(type, values)) <= {list} or not set(map(len, values)) <= {length}:  # type: ignore[arg-type]
                raise self.wrong(f"is not a list of rows of {length}")
            values = list(chain.from_iterable(values))  # type: ignore[arg-type]
        return values

    def integers_of(self, values: list[object]) -> Int64:
        """(n,) int64."""
        if not set(map(type, values)) <= {int}:
            raise self.wrong("not all of it are integers")
        try:
            return np.array(values, np.int64)
        except OverflowError as e:
            raise self.wrong("an integer has more than 64 bits") from e

    def floats_of(self, values: list[object]) -> Float64:
        """(n,) float64."""
        if not set(map(type, values)) <= {int, float}:
            raise self.wrong("not all of it are numbers")
        try:
            return np.array(values, np.float64)
        except OverflowError as e:
            raise self.wrong("a number is too large") from e


def twice(values: Iterable[object]) -> object:
    """The most repeated of the values."""
    return Counter(values).most_common(1)[0][0]


def single(values: Float64) -> Float32:
    """float32; what is too large becomes infinite."""
    with np.errstate(over="ignore"):
        return values.astype(np.float32)


def encoded_feature(feature: Float32) -> dict[str, str]:
    """What ``Field.feature`` reads."""
    data = base64.b64encode(feature.astype(FEATURE_TYPE).tobytes())
    return {"dtype": FEATURE_TYPE, "base64": data.decode("ascii")}


def _is_unicode(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True
