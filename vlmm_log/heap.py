"""Freed memory that stays ours: pairs ask for the same large arrays, and new pages cost as much as filling them."""

from __future__ import annotations

import ctypes
import sys

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # of malloc.h
MOST = 1 << 30  # bytes


def keep_pages() -> None:
    """Let glibc's malloc, where there is one, neither map large arrays one by one nor give the heap's end back."""
    if sys.platform != "linux":
        return
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(M_MMAP_THRESHOLD, MOST)
        mallopt(M_TRIM_THRESHOLD, MOST)
