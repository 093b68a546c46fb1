"""The embedder that settings name."""

from __future__ import annotations

from importlib import metadata

from vlmm_log.models.weights import find_clip, user_cache
from vlmm_log.protocols import Embedder
from vlmm_log.settings import ObjectSettings
from vlmm_log.types import InputError


def load_embedder(s: ObjectSettings) -> tuple[Embedder, dict[str, str]]:
    """The embedder, and the versions and fingerprints that decide its features.

    Raises InputError for an unknown name, and where packages or weights are missing.
    """
    name, colon, weights = s.embedder.partition(":")
    if s.embedder == "words":
        from vlmm_log.models.words import Words

        words = Words()
        return words, {"embedder": words.fingerprint, "scikit-learn": metadata.version("scikit-learn")}
    if name not in ("clip", "maskclip") or (colon and not weights):
        raise InputError(
            f"objects.embedder = {s.embedder!r}: no such embedder; there are words, clip, clip:WEIGHTS, maskclip and "
            "maskclip:WEIGHTS"
        )
    path = find_clip(weights)  # before torch, whose import takes seconds
    features = user_cache().with_name("features")
    if name == "clip":
        from vlmm_log.models.clip import Clip

        clip = Clip(path, s.crop_px, features)
        return clip, _versions(clip.fingerprint)
    from vlmm_log.models.maskclip import MaskClip

    maskclip = MaskClip(path, s.crop_px, features)
    return maskclip, _versions(maskclip.fingerprint)


def _versions(fingerprint: str) -> dict[str, str]:
    return {"embedder": fingerprint} | {name: metadata.version(name) for name in ("torch", "open_clip_torch")}
