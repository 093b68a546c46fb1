"""The settings that are compared: profiles, and each lever of ``default`` alone put back to what the paper has."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from vlmm_log.settings import PROFILES, Settings

LEVERS: Mapping[str, tuple[str, ...]] = {  # what is taken from ``default``
    "balanced instances": ("ego.instance_share=1.0",),
    "whitened inliers": ("ego.inlier=metric",),
    "row-linear ego": ("ego.model=rigid",),
    "ego-refinement": ("ego.model=off",),
    "sigma_z in metres": ("noise.sigma_z_z0=0.0004",),
    "own lateral noise": ("noise.sigma_px_first=1.5", "noise.sigma_px_second=1.5"),
    "forward-backward variance": ("noise.fb_variance=0.0",),
    "displacement noise": ("noise.displacement=0.0",),
    "edge inflation": ("noise.edge_inflation=0.0",),
    "texture covariance": ("noise.flow_sigma=0.0",),
    "flow spread": ("noise.flow_spread=0.0",),
    "depth band": ("gate.depth_band=0.0",),
    "occlusion": ("gate.occlusion_sigma=0.0",),
    "coherence of flagged pixels": ("objects.coherence=all",),
    "parts and intervals": ("map.part=1.0", "map.interval_pairs=1000"),
}


def profiles(s: Settings) -> dict[str, Settings]:
    """Each profile, what concerns reading, flow, masks, gap and seed as in ``s``."""
    return {name: _as_asked(p, s) for name, p in PROFILES.items()}


def without_levers(s: Settings) -> dict[str, Settings]:
    """``s`` without each lever."""
    return {f"without {name}": s.changed(sets) for name, sets in LEVERS.items()}


def swept(s: Settings, name: str, values: tuple[str, ...]) -> dict[str, Settings]:
    """``s`` with a setting at each value."""
    return {f"{name}={value}": s.changed([f"{name}={value}"]) for value in values}


def _as_asked(profile: Settings, s: Settings) -> Settings:
    objects = replace(
        profile.objects,
        segmenter=s.objects.segmenter,
        embedder=s.objects.embedder,
        prior=s.objects.prior,
        yolo_names=s.objects.yolo_names,
    )
    return replace(profile, seed=s.seed, read=s.read, keyframes=s.keyframes, flow=s.flow, objects=objects, log=s.log)
