"""What is compared: the settings as asked, profiles, levers taken away one at a time, sweeps, disturbed poses."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from vlmm_log import se3
from vlmm_log.evaluation.trial import Plan, WithoutIdentities
from vlmm_log.protocols import Models
from vlmm_log.settings import PROFILES, Settings
from vlmm_log.types import Frame, FramePair, InputError

TRUSTED = ("ego.model=off", "ego.pose_sigma_rad=0.0", "ego.pose_sigma_m=0.0")  # poses thought exact
LEVERS: Mapping[str, tuple[str, ...]] = {  # what is put back to what the paper has
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


@dataclass(frozen=True)
class Comparison:
    """What is compared beside the settings as asked."""

    profiles: bool = False
    levers: bool = False
    baselines: bool = False
    association: bool = False
    sweeps: tuple[tuple[str, tuple[str, ...]], ...] = ()  # setting, values
    pose_noise: tuple[float, float] | None = None  # degrees, cm


def parse_pose_noise(text: str) -> tuple[float, float]:
    """Degrees and cm of "1.5,3". Raises InputError."""
    try:
        deg, cm = (float(part) for part in text.split(","))
    except ValueError:
        deg = cm = float("nan")
    if not (0 <= deg < 180 and 0 <= cm < math.inf):
        raise InputError(f"--pose-noise {text}: give degrees and cm, as in 1.5,3")
    return deg, cm


def parse_sweeps(texts: Sequence[str]) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Settings and their values, of "objects.quantile=0.5,0.75", each once. Raises InputError."""
    found: dict[str, tuple[str, ...]] = {}
    for text in texts:
        name, _, values = (part.strip() for part in text.partition("="))
        listed = [value for part in values.split(",") if (value := part.strip())]
        if not name or not listed:
            raise InputError(f"--sweep {text}: give a setting and its values, as in objects.quantile=0.5,0.75,0.9")
        found[name] = tuple(dict.fromkeys([*found.get(name, ()), *listed]))
    return tuple(found.items())


def plans(s: Settings, compare: Comparison) -> list[Plan]:
    """All trials: the settings as asked first."""
    of_profiles = profiles(s)
    name = s.profile if s == of_profiles[s.profile] else "as set"
    found = [Plan(name, s, raw=True)]
    if compare.profiles:
        found += [Plan(n, p, raw=True) for n, p in of_profiles.items() if n != name]
        found.append(Plan("paper, poses trusted", of_profiles["paper"].changed(TRUSTED), raw=True))
    if compare.levers:
        found += [Plan(n, p) for n, p in _without_levers(s).items()]
    for setting, values in compare.sweeps:
        found += [Plan(n, p) for n, p in _swept(s, setting, values).items()]
    if compare.pose_noise is not None:
        deg, cm = compare.pose_noise
        disturb = partial(_disturbed, float(np.deg2rad(deg)), cm / 100.0, s.seed)
        told = f"poses off by {deg:g} deg, {cm:g} cm"
        off = s.changed(TRUSTED)
        found += [
            Plan("poses trusted", off),
            Plan(f"{name}, {told}", s, disturb),
            Plan(f"poses trusted, {told}", off, disturb),
        ]
    if compare.association:
        found.append(Plan("identities withheld", s, _withheld, same_ids=False))
    return found


def _disturbed(
    sigma_rad: float, sigma_m: float, seed: int, pair: FramePair, models: Models
) -> tuple[FramePair, Models]:
    """Poses with Gaussian errors, each frame's own. Both ends of a pair have one."""

    def moved(frame: Frame) -> Frame:
        if frame.T_world_cam is None:
            return frame
        draw = np.random.default_rng([seed, 7, frame.index]).standard_normal(6)
        axis = draw[:3] / np.linalg.norm(draw[:3]) * sigma_rad  # the whole angle, and the whole offset, about an axis
        offset = draw[3:] / np.linalg.norm(draw[3:]) * sigma_m
        return replace(frame, T_world_cam=frame.T_world_cam @ se3.exp(np.concatenate([axis, offset])))

    return FramePair(moved(pair.first), moved(pair.second)), models


def _withheld(pair: FramePair, models: Models) -> tuple[FramePair, Models]:
    return pair, replace(models, segment=WithoutIdentities(models.segment))


def profiles(s: Settings) -> dict[str, Settings]:
    """Each profile, what concerns reading, flow, masks, gap and seed as in ``s``."""
    return {name: _as_asked(p, s) for name, p in PROFILES.items()}


def _without_levers(s: Settings) -> dict[str, Settings]:
    """``s`` without each lever that it has."""
    taken = {f"without {name}": s.changed(sets) for name, sets in LEVERS.items()}
    return {name: without for name, without in taken.items() if without != s}


def _swept(s: Settings, name: str, values: tuple[str, ...]) -> dict[str, Settings]:
    """``s`` with a setting at each value. Raises InputError for a setting that all trials share."""
    found = {f"{name}={value}": s.changed([f"{name}={value}"]) for value in values}
    if any(replace(_as_asked(one, s), seed=one.seed, profile=s.profile) != one for one in found.values()):
        raise InputError(
            f"--sweep {name}: all trials share their pairs, flow, masks and names; run eval once for each value, "
            f"with --set {name}=VALUE"
        )
    return found


OF_MODELS = ("segmenter", "yolo_score", "yolo_iou", "yolo_names", "embedder", "crop_px", "prior", "llm_model")


def _as_asked(profile: Settings, s: Settings) -> Settings:
    objects = replace(profile.objects, **{name: getattr(s.objects, name) for name in OF_MODELS})
    return replace(profile, seed=s.seed, read=s.read, keyframes=s.keyframes, flow=s.flow, objects=objects, log=s.log)
