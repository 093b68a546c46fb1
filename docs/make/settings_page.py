"""docs/settings.md from the settings themselves. python docs/make/settings_page.py"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import Field, fields
from pathlib import Path
from typing import Any

from vlmm_log.knobs import LARGE, is_table, written
from vlmm_log.settings import PROFILES

PAGE = Path(__file__).resolve().parents[1] / "settings.md"
HEAD = """# Settings

Every knob of a run, its meaning, and its value in the two profiles: `default` is what measured better, `paper` what the
paper prints. Change one with `--set noise.alpha=0.01`, many with a file, `--settings F.toml`:

```toml
profile = "paper"

[keyframes]
gap = "0.1s"

[noise]
alpha = 0.01
```

A file and `--set` change what the profile says; options of a command (`--gap`, `--flow`, ...) come last. A name that
does not exist, a wrong type and a value out of range are errors that say what would be right. A recording, and every
map file, holds all settings of its run.

<!-- made by docs/make/settings_page.py from vlmm_log/settings.py: change it there -->
"""


def text() -> str:
    """The page."""
    default, paper = PROFILES["default"], PROFILES["paper"]
    tables = [f.name for f in fields(default) if is_table(default, f.name)]
    singles = [f for f in fields(default) if f.name not in tables]
    parts = [HEAD, "## Of the whole run\n", *_rows(singles, default, paper, "")]
    for name in tables:
        of_default, of_paper = getattr(default, name), getattr(paper, name)
        parts += [f"\n## {name}\n", f"{type(of_default).__doc__}\n"]
        parts += _rows(fields(of_default), of_default, of_paper, f"{name}.")
    return "\n".join(parts) + "\n"


def _rows(knobs: Any, default: object, paper: object, prefix: str) -> Iterator[str]:
    yield "| setting | default | paper | meaning |"
    yield "|---|---|---|---|"
    for f in knobs:
        a, b = written(getattr(default, f.name)), written(getattr(paper, f.name))
        other = "" if a == b else f"`{b}`"
        allowed = _allowed(f)
        meaning = f"{f.metadata['doc']} ({allowed})" if allowed else f.metadata["doc"]
        cells = (f"`{prefix}{f.name}`", f"`{a}`", other, meaning)
        yield f"| {' | '.join(cell.replace('|', '&#124;') for cell in cells)} |"


def _allowed(f: Field[Any]) -> str:
    """Choices, or the range of a number."""
    low, high, choices, kinds = (f.metadata[name] for name in ("low", "high", "of", "kinds"))
    told = [f"`{choice}`" for choice in choices]
    if low is not None:
        named = "whole, " if int in kinds else ""
        told.append(f"{named}{low:g} and more" if high >= LARGE else f"{named}{low:g} to {high:g}")
    if kinds == (bool,):
        told.append("`true`, `false`")
    if kinds == (int, str):
        told.append("or a time")
    return ", ".join(told)


if __name__ == "__main__":
    PAGE.write_text(text(), "utf-8")
