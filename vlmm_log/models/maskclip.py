"""MaskCLIP features of regions, for the paper's ablation: dense features averaged over each mask.

Zhou, Loy and Dai, "Extract Free Dense Labels from CLIP", ECCV 2022.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from vlmm_log.models.clip import prompted
from vlmm_log.models.clip_network import WIDTH, ClipNetwork
from vlmm_log.models.feature_cache import FeatureCache
from vlmm_log.types import Float32, Frame, Segments


class MaskClip:
    """The embedder."""

    threshold = 0.25

    def __init__(self, weights: Path, image_px: int, folder: Path) -> None:
        """The image's longer side becomes ``image_px``. Raises InputError where the weights cannot be used."""
        self._network = ClipNetwork(weights)
        self._image_px = image_px
        self.fingerprint = self._network.space
        self.cache = FeatureCache(folder, WIDTH, f"patches, {image_px} px, {self.fingerprint}")

    def regions(self, frame: Frame, segments: Segments) -> Float32:
        """(n, WIDTH) unit features; zeros for an instance without a pixel."""
        masks = [segments.labels == k + 1 for k in range(len(segments))]
        image = hashlib.sha256(frame.rgb.tobytes()).digest()
        contents = [image + np.packbits(mask).tobytes() if mask.any() else b"" for mask in masks]

        def compute(rows: list[int]) -> Float32:
            patches = self._network.patches(frame.rgb, self._image_px)
            return np.stack([averaged(patches, masks[i].astype(np.float32)) for i in rows])

        return self.cache.remembered(contents, compute)

    def labels(self, labels: Sequence[str]) -> None:
        """None: pixels decide."""

    def texts(self, texts: Sequence[str]) -> Float32:
        """(m, WIDTH) unit features of "a photo of a TEXT"; zeros for a blank text."""
        return prompted(texts, self._network, self.cache)


def averaged(patches: Float32, mask: Float32) -> Float32:
    """(D,) unit mean of (h, w, D) patches, each by the share of the (H, W) mask that lies in it."""
    h, w, width = patches.shape
    shares = cv2.resize(mask, (w, h), interpolation=cv2.INTER_AREA).ravel()
    mean = shares @ patches.reshape(-1, width)
    return np.asarray(mean / max(float(np.linalg.norm(mean)), 1e-12), np.float32)
