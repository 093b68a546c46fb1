"""SHA-256 of what was fetched, kept beside it: where nobody publishes a hash, the first download decides.

NAME.sha256 is as `sha256sum -c` reads it.
"""

from __future__ import annotations

import re
from datetime import UTC, datetime
from pathlib import Path

from vlmm_log.types import InputError


def checked_sha256(text: str) -> str:
    """A hash in lower case. Raises InputError where it is none."""
    value = text.strip().lower()
    if not re.fullmatch(r"[0-9a-f]{64}", value):
        raise InputError(f"{text!r}: is no SHA-256; it has 64 hexadecimal digits")
    return value


def recorded(file: Path) -> str:
    """The hash that was recorded of a file; "" where none was. Raises InputError where the record is no such."""
    try:
        lines = _record(file).read_text("utf-8").splitlines()
    except FileNotFoundError:
        return ""
    except (OSError, UnicodeDecodeError) as e:
        raise InputError(f"{_record(file)}: cannot be read: {e}; remove it to trust the next download") from e
    for line in lines:
        told, _, name = line.partition("  ")
        if name == file.name:
            return checked_sha256(told)
    raise InputError(f"{_record(file)}: holds no hash of {file.name}; remove it to trust the next download")


def record(file: Path, url: str) -> str:
    """Keep the hash, size and origin of a file beside it; the hash."""
    import pooch

    value = str(pooch.file_hash(str(file)))
    day = datetime.now(UTC).date().isoformat()
    told = [f"# {file.stat().st_size} bytes from {url}, {day}", f"{value}  {file.name}", ""]
    _record(file).write_text("\n".join(told), "utf-8")
    return value


def _record(file: Path) -> Path:
    return file.with_name(file.name + ".sha256")
