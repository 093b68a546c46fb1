"""Dense Inverse Search flow by OpenCV: needs no weights. Kroeger et al., ECCV 2016."""

from __future__ import annotations

import cv2
import numpy as np

from vlmm_log.settings import FlowSettings
from vlmm_log.types import Float32, Frame

PRESETS = {
    "ultrafast": cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST,
    "fast": cv2.DISOPTICAL_FLOW_PRESET_FAST,
    "medium": cv2.DISOPTICAL_FLOW_PRESET_MEDIUM,
}


class Dis:
    """A flow estimator that keeps OpenCV's work buffers between pairs."""

    def __init__(self, s: FlowSettings) -> None:
        self._dis = cv2.DISOpticalFlow.create(PRESETS[s.dis_preset])

    def __call__(self, first: Frame, second: Frame) -> tuple[Float32, Float32]:
        """Flow (H, W, 2) px both ways."""
        a = cv2.cvtColor(first.rgb, cv2.COLOR_RGB2GRAY)
        b = cv2.cvtColor(second.rgb, cv2.COLOR_RGB2GRAY)
        return self._one_way(a, b), self._one_way(b, a)

    def _one_way(self, a: cv2.typing.MatLike, b: cv2.typing.MatLike) -> Float32:
        return np.asarray(self._dis.calc(a, b, None), np.float32)  # type: ignore[call-overload]
