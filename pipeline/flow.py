"""Dense flow both ways and its round trip."""

from __future__ import annotations

import numpy as np

from vlmm_log.pipeline import flow_kernels
from vlmm_log.protocols import FlowEstimator
from vlmm_log.types import FlowField, FramePair


def estimate_flow(pair: FramePair, estimator: FlowEstimator) -> FlowField:
    """The flow of a pair both ways, with the forward-backward error of each pixel."""
    forward, backward = estimator(pair.first, pair.second)
    forward, backward = np.ascontiguousarray(forward, np.float32), np.ascontiguousarray(backward, np.float32)
    fb_error = np.empty(forward.shape[:2], np.float32)
    flow_kernels.round_trip(forward, backward, fb_error)
    return FlowField(forward, backward, fb_error)
