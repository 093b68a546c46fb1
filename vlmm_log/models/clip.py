"""CLIP features of regions: each instance cut out along its mask, alone on a plain ground."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from vlmm_log.models.clip_network import MEAN_COLOR, WIDTH, ClipNetwork
from vlmm_log.models.feature_cache import FeatureCache
from vlmm_log.types import Float32, Frame, Segments, UInt8

PROMPT = "a photo of a {}"


class Clip:
    """The embedder."""

    threshold = 0.25

    def __init__(self, weights: Path, crop_px: int, folder: Path) -> None:
        """Features are kept in ``folder``. Raises InputError where the weights cannot be used."""
        self._network = ClipNetwork(weights)
        self._crop_px = crop_px
        self.fingerprint = self._network.space
        self.cache = FeatureCache(folder, WIDTH, f"cut out, {crop_px} px, {self.fingerprint}")

    def regions(self, frame: Frame, segments: Segments) -> Float32:
        """(n, WIDTH) unit features; zeros for an instance without a pixel."""
        cuts = [cut_out(frame.rgb, segments.labels == k + 1) for k in range(len(segments))]

        def compute(rows: list[int]) -> Float32:
            return self._network.images([_scaled(cuts[i], self._crop_px) for i in rows])

        return self.cache.remembered([cut.tobytes() for cut in cuts], compute)

    def labels(self, labels: Sequence[str]) -> None:
        """None: pixels decide."""

    def texts(self, texts: Sequence[str]) -> Float32:
        """(m, WIDTH) unit features of "a photo of a TEXT"; zeros for a blank text."""
        return prompted(texts, self._network, self.cache)


def prompted(texts: Sequence[str], network: ClipNetwork, cache: FeatureCache) -> Float32:
    """(m, WIDTH) unit features of texts in the prompt; zeros for a blank one."""
    whole = [text.encode("utf-8", "replace").decode().strip() for text in texts]  # a terminal may give half characters
    prompts = [PROMPT.format(text) if text else "" for text in whole]
    contents = [prompt.encode() for prompt in prompts]
    return cache.remembered(contents, lambda rows: network.texts([prompts[i] for i in rows]))


def cut_out(rgb: UInt8, mask: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> UInt8:
    """(s, s, 3) the mask's bounding box, padded to a square about it; outside the mask the encoder's mean colour."""
    u, v, w, h = cv2.boundingRect(mask.view(np.uint8))
    side = max(w, h)
    square = np.empty((side, side, 3), np.uint8)
    square[:] = np.round(MEAN_COLOR * 255)
    top, left = (side - h) // 2, (side - w) // 2
    inside = mask[v : v + h, u : u + w]
    square[top : top + h, left : left + w][inside] = rgb[v : v + h, u : u + w][inside]
    return square


def _scaled(square: UInt8, px: int) -> UInt8:
    how = cv2.INTER_AREA if square.shape[0] > px else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(square, (px, px), interpolation=how), np.uint8)
