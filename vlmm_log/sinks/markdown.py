"""Texts of logs within Markdown."""

from __future__ import annotations

import re


def plain(text: str) -> str:
    """Markdown that reads as the text, on one line: no link or image of a log's makes a viewer fetch anything."""
    return re.sub(r"([\\`*_{}\[\]<>|#~!])", r"\\\1", " ".join(text.split()))
