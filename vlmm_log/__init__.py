"""Vision-Language-Motion Maps as a log analysis tool: what moved in a recording, and how sure are we."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from vlmm_log.version import __version__

if TYPE_CHECKING:
    from vlmm_log.api import process
    from vlmm_log.ask import load_map, query
    from vlmm_log.assessment import evaluate
    from vlmm_log.compare import diff
    from vlmm_log.conversion import convert
    from vlmm_log.datasets import get_dataset
    from vlmm_log.diagnosis import doctor
    from vlmm_log.fleet import batch
    from vlmm_log.picturing import render
    from vlmm_log.readers import open_log
    from vlmm_log.rendering import simulate
    from vlmm_log.settings import Settings
    from vlmm_log.survey import info

__all__ = [
    "Settings",
    "__version__",
    "batch",
    "convert",
    "diff",
    "doctor",
    "evaluate",
    "get_dataset",
    "info",
    "load_map",
    "open_log",
    "process",
    "query",
    "render",
    "simulate",
]

_HOME = {
    "Settings": "vlmm_log.settings",
    "batch": "vlmm_log.fleet",
    "convert": "vlmm_log.conversion",
    "diff": "vlmm_log.compare",
    "doctor": "vlmm_log.diagnosis",
    "evaluate": "vlmm_log.assessment",
    "get_dataset": "vlmm_log.datasets",
    "info": "vlmm_log.survey",
    "load_map": "vlmm_log.ask",
    "open_log": "vlmm_log.readers",
    "process": "vlmm_log.api",
    "query": "vlmm_log.ask",
    "render": "vlmm_log.picturing",
    "simulate": "vlmm_log.rendering",
}


if not TYPE_CHECKING:  # else a type checker takes any name for one of ours

    def __getattr__(name: str) -> Any:  # so that a name costs its imports only when it is used
        if name not in _HOME:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        import importlib

        return getattr(importlib.import_module(_HOME[name]), name)
