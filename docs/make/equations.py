"""Equations become MathML while the pages are built: they show without a script and without a network."""

from __future__ import annotations

import re
from html import unescape
from typing import Any

from latex2mathml.converter import convert

EQUATION = re.compile(
    r'<(span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</\1>', re.DOTALL
)  # as arithmatex leaves it


def on_page_content(html: str, **_: Any) -> str:
    """mkdocs calls it with each page's HTML."""
    return EQUATION.sub(_mathml, html)


def _mathml(found: re.Match[str]) -> str:
    display = "block" if found[2] == "[" else "inline"
    return convert(unescape(found[3]).strip(), display=display)
