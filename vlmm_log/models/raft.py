"""RAFT flow by torchvision's raft_large. Teed and Deng, ECCV 2020.

Tensors, device and padding end here: what goes in and comes out is numpy.
"""

from __future__ import annotations

import re
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from vlmm_log.models.weights import find_raft, fingerprint, reason
from vlmm_log.settings import FlowSettings
from vlmm_log.types import Float32, Frame, InputError

try:
    import torch
    from torch.nn import functional

    from vlmm_log.models.torchvision_operators import declare_missing_operators
except ImportError as e:
    raise InputError("--flow raft needs torch and torchvision: pip install 'vlmm-log[raft]'") from e

KEPT = 8  # frames, 4 MB each at half of 640x480

# Princeton's keys -> torchvision's. torchvision's own keys pass through unchanged.
_PRINCETON = (
    (r"^module\.", ""),
    (r"^fnet\.", "feature_encoder."),
    (r"^cnet\.", "context_encoder."),
    (r"^(feature|context)_encoder\.conv1\.", r"\1_encoder.convnormrelu.0."),
    (r"^(feature|context)_encoder\.norm1\.", r"\1_encoder.convnormrelu.1."),
    (r"^(feature|context)_encoder\.conv2\.", r"\1_encoder.conv."),
    (r"(layer\d\.\d)\.conv(\d)\.", r"\1.convnormrelu\2.0."),
    (r"(layer\d\.\d)\.norm(\d)\.", r"\1.convnormrelu\2.1."),
    (r"^update_block\.encoder\.conv(c|f)([12])\.", r"update_block.motion_encoder.conv\1@\2.0."),
    (r"^update_block\.encoder\.conv\.", "update_block.motion_encoder.conv.0."),
    (r"convc@", "convcorr"),
    (r"convf@", "convflow"),
    (r"^update_block\.gru\.conv([zrq])([12])\.", r"update_block.recurrent_block.convgru\2.conv\1."),
    (r"^update_block\.mask\.0\.", "mask_predictor.convrelu.0."),
    (r"^update_block\.mask\.2\.", "mask_predictor.conv."),
)


class Raft:
    """A flow estimator that holds the network on the best device there is."""

    def __init__(self, s: FlowSettings) -> None:
        self.weights = find_raft(s.weights)
        self.fingerprint = fingerprint(self.weights)
        self._scale, self._updates = s.raft_scale, s.raft_updates
        self._device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
        self._network = load(self.weights).to(self._device)
        self._kept: deque[_Encoded] = deque(maxlen=KEPT)  # the last frames: most come again, as another pair's first

    def __call__(self, first: Frame, second: Frame) -> tuple[Float32, Float32]:
        """Flow (H, W, 2) px both ways, from one batch of two. Images are encoded once, whatever pairs they are in."""
        H, W = first.rgb.shape[:2]
        h, w = (max(128, 8 * round(n * self._scale / 8)) for n in (H, W))  # RAFT wants multiples of 8, 128 at least
        with torch.inference_mode():
            a, b = self._encoded(first, (h, w)), self._encoded(second, (h, w))
            features = torch.cat([a.features, b.features])
            flow = _refined(self._network, features, torch.cat([a.context, b.context]), self._updates)
            flow = functional.interpolate(flow, (H, W), mode="bilinear", align_corners=False)
            flow = flow * flow.new_tensor([W / w, H / h])[None, :, None, None]
            out = flow.permute(0, 2, 3, 1).contiguous().cpu().numpy()
        return out[0], out[1]

    def _encoded(self, frame: Frame, size: tuple[int, int]) -> _Encoded:
        """One image at a time: its numbers do not depend on what else is in a batch, nor on what was kept."""
        for kept in self._kept:
            if kept.frame.index == frame.index and np.array_equal(kept.frame.rgb, frame.rgb):
                return kept
        image = torch.tensor(frame.rgb[None]).to(self._device).permute(0, 3, 1, 2).float() / 127.5 - 1.0
        smaller = size[0] < frame.rgb.shape[0]
        image = functional.interpolate(image, size, mode="bilinear", align_corners=False, antialias=smaller)
        encoded = _Encoded(frame, self._network.feature_encoder(image), self._network.context_encoder(image))
        self._kept.append(encoded)
        return encoded


@dataclass(frozen=True, eq=False)
class _Encoded:
    """What the network's encoders make of a frame."""

    frame: Frame
    features: Any
    context: Any


def _refined(network: Any, features: Any, context: Any, updates: int) -> Any:
    """Flow (2, 2, h, w) px of two encoded images, each to the other: the recurrent part of torchvision's RAFT."""
    from torchvision.models.optical_flow._utils import make_coords_grid, upsample_flow

    network.corr_block.build_pyramid(features, features.flip(0))
    width = network.update_block.hidden_state_size
    hidden, context = torch.split(context, [width, context.shape[1] - width], dim=1)
    hidden, context = torch.tanh(hidden), functional.relu(context)
    start = make_coords_grid(len(features), *features.shape[-2:]).to(features.device)
    at = start
    for _ in range(updates):
        correlation = network.corr_block.index_pyramid(centroids_coords=at)
        hidden, change = network.update_block(hidden, context, correlation, at - start)
        at = at + change
    return upsample_flow(flow=at - start, up_mask=network.mask_predictor(hidden))


def load(path: Path) -> Any:
    """The network with a weights file in Princeton's or torchvision's key layout. Raises InputError."""
    network = _raft_large()
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
        network.load_state_dict(torchvision_keys(state))
    except Exception as e:
        raise InputError(f"{path}: not weights of RAFT large ({reason(e)})") from e
    return network.eval()


def torchvision_keys(state: dict[str, Any]) -> dict[str, Any]:
    """A state dict with Princeton's names changed into torchvision's."""
    renamed = {}
    for key, value in state.items():
        if ".norm3." in key:  # the same tensors as downsample.1
            continue
        for pattern, name in _PRINCETON:
            key = re.sub(pattern, name, key)
        renamed[key] = value
    return renamed


def _raft_large() -> Any:
    try:
        declare_missing_operators()
        from torchvision.models.optical_flow import raft_large
    except ImportError as e:
        raise InputError("--flow raft needs torchvision: pip install 'vlmm-log[raft]'") from e
    return raft_large(weights=None)
