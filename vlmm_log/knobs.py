"""The machinery of settings: a knob's meaning and range, values from TOML and ``a.b=v`` texts, checked one by one.

A name that does not exist is an error that says the nearest one that does.
"""

from __future__ import annotations

import difflib
import math
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import field, fields, replace
from pathlib import Path
from typing import Any, TypeVar

from vlmm_log.types import InputError

T = TypeVar("T")
S = TypeVar("S")
LARGE = 1e12


def knob(
    default: T,
    doc: str,
    *,
    low: float | None = None,
    high: float = LARGE,
    of: tuple[str, ...] = (),
    kinds: tuple[type, ...] = (),
) -> T:
    """A setting: its default, meaning with unit, range (both ends allowed), choices, and types if not the default's."""
    meta = {"doc": doc, "low": low, "high": high, "of": of, "kinds": kinds or (type(default),)}
    field_: T = field(default=default, metadata=meta)
    return field_


def is_table(settings: object, name: str) -> bool:
    """Whether a setting holds settings itself."""
    return hasattr(getattr(settings, name), "__dataclass_fields__")


def leaves(settings: object, prefix: str = "") -> Iterator[tuple[str, object]]:
    """Every setting: its name "a.b" and its value."""
    for f in fields(settings):  # type: ignore[arg-type]
        value = getattr(settings, f.name)
        if is_table(settings, f.name):
            yield from leaves(value, f"{prefix}{f.name}.")
        else:
            yield prefix + f.name, value


def written(value: object) -> str:
    """A value as TOML."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        escaped = value.replace("\\", "\\\\").replace('"', '\\"')
        return '"' + "".join(c if c >= " " and c != "\x7f" else f"\\u{ord(c):04x}" for c in escaped) + '"'
    return repr(value)


def read_toml(path: Path) -> dict[str, Any]:
    """A TOML file. Raises InputError."""
    try:
        return tomllib.loads(path.read_text("utf-8"))
    except OSError as e:
        raise InputError(f"{path}: cannot read the settings: {e.strerror or e}") from e
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as e:
        raise InputError(f"{path}: not a TOML file: {e}") from e


def parse_set(text: str) -> dict[str, Any]:
    """ "a.b=v" as nested tables; a bare word is a text. Raises InputError."""
    name, equals, value = text.partition("=")
    if not equals or not name.strip():
        raise InputError(f"--set {text}: write it as table.name=value, for example --set keyframes.gap=6")
    keys = name.strip().split(".")
    if len(keys) > 2 or "\n" in text:
        raise InputError(f"--set {text[:60]}: one setting each, as in keyframes.gap=6")
    try:
        parsed: Any = tomllib.loads(f"v = {value}")["v"]
    except tomllib.TOMLDecodeError:
        parsed = value.strip()  # a bare word is a text
    except (ValueError, RecursionError) as e:
        raise InputError(f"--set {text[:60]}: the value is too long or too deep") from e
    return nested(name.strip(), parsed)


def nested(name: str, value: Any) -> dict[str, Any]:
    """A value under a name "a.b"."""
    for key in reversed(name.split(".")):
        value = {key: value}
    return dict(value)


def with_values(settings: S, table: Mapping[str, Any], where: str, prefix: str = "") -> S:
    """Settings with a table's values in their place. Raises InputError, which names ``where`` and the setting."""
    known = {f.name: f for f in fields(settings)}  # type: ignore[arg-type]
    values: dict[str, Any] = {}
    for name, value in table.items():
        if name not in known:
            raise InputError(f"{where}: no setting {prefix}{name}{_nearest(name, known, prefix)}")
        current = getattr(settings, name)
        if is_table(settings, name):
            if not isinstance(value, dict):
                raise InputError(f"{where}: {prefix}{name} is a table; set one of its names, as in {name}.NAME=value")
            values[name] = with_values(current, value, where, f"{prefix}{name}.")
        else:
            values[name] = _checked(value, known[name].metadata, f"{where}: {prefix}{name}")
    return replace(settings, **values)  # type: ignore[type-var]


def _nearest(name: str, known: Mapping[str, object], prefix: str) -> str:
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    return f"; nearest is {prefix}{close[0]}" if close else f"; there are {', '.join(known)}"


def _checked(value: Any, meta: Mapping[str, Any], where: str) -> object:
    kinds = meta["kinds"]
    if float in kinds and type(value) is int:
        value = float(value) if abs(value) < LARGE else math.inf
    if type(value) not in kinds:
        raise InputError(f"{where}: {value!r} is not {' or '.join(k.__name__ for k in kinds)}")
    if meta["of"] and isinstance(value, str) and value not in meta["of"]:
        raise InputError(f"{where}: {value!r} is not one of {', '.join(meta['of'])}")
    if isinstance(value, int | float):
        low, high = meta["low"], meta["high"]
        if value != value or (low is not None and value < low) or value > high:
            span = f"at least {low} and finite" if high >= LARGE else f"between {low} and {high}"
            raise InputError(f"{where}: {value} is out of range; it must be {span}")
    return value
