"""torchvision beside a torch that its compiled operators were not built for."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from typing import Any

import torch


@cache
def declare_missing_operators() -> Any:
    """Import torchvision; where its operators do not fit this torch, declare them and import it again.

    torchvision from PyPI beside a CPU build of torch is such a pair. RAFT and CLIP use none of the operators. Gives
    what keeps the declarations alive, None where none was needed. Raises ImportError where torchvision is missing.
    """
    try:
        import_module("torchvision")
    except RuntimeError as e:
        if "torchvision::nms" not in str(e):
            raise
        library: Any = torch.library.Library("torchvision", "DEF")  # type: ignore[no-untyped-call]
        library.define("nms(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")
        library.define("qnms(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")
        import_module("torchvision")
        return library
    return None
