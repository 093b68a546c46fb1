"""Lines at the end of a help, as they are typed."""

from __future__ import annotations


def examples(*lines: str) -> str:
    """Of a command's epilog; click folds no line after its mark."""
    return "\n".join(["\b", "Examples:", *(f"  {line}" for line in lines)])
