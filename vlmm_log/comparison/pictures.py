"""Pictures of the frames that differ most: A, B, and how far they are apart."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vlmm_log.comparison.difference import Difference, EntityDifference
from vlmm_log.comparison.words import figure_words
from vlmm_log.depth_pixels import metres
from vlmm_log.drawing.pictures import coloured, picture
from vlmm_log.entries import DepthMap, Labels, Picture, Raster, Value
from vlmm_log.pages.pictures import data_uri
from vlmm_log.recording import Recording
from vlmm_log.sinks.pair_entries import IMAGE
from vlmm_log.types import UInt8

ENTITIES = (
    "residual/d_m",
    "validity",
    "flow/tensor",
    "instances",
    "residual/sigma_z",
    "depth",
    "rgb",
    "residual/p_stat",
)
FRAMES = {"residual/d_m": 3}  # how many of the worst; one of others
TOGETHER = 4  # entities shown at most


@dataclass(frozen=True)
class Row:
    """Pictures of one entity at one frame, beside each other."""

    entity: str
    frame: int
    told: str
    pictures: tuple[tuple[str, str], ...]  # caption, data URI


def worst_frames(d: Difference, recordings: tuple[Recording, Recording]) -> list[Row]:
    """The worst frames of the entities that can be looked at."""
    by_name = {e.entity: e for e in d.entities}
    chosen = [by_name[f"{IMAGE}/{name}"] for name in ENTITIES if f"{IMAGE}/{name}" in by_name]
    rows = []
    for e in [e for e in chosen if e.frames][:TOGETHER]:
        frames = _worst(e, FRAMES.get(e.entity.removeprefix(f"{IMAGE}/"), 1))
        colour = _at(recordings[0], f"{IMAGE}/rgb", frames)
        a, b = (_at(recording, e.entity, frames) for recording in recordings)
        for frame in (f for f in frames if f in a and f in b):
            shown = [("colour, A", colour[frame])] if frame in colour and e.entity != f"{IMAGE}/rgb" else []
            pictures = [(name, picture(e.entity, value)) for name, value in (*shown, ("A", a[frame]), ("B", b[frame]))]
            pictures.append(("|A - B|", apart(a[frame], b[frame])))
            uris = tuple((name, data_uri(pixels)) for name, pixels in pictures if pixels is not None)
            rows.append(Row(e.entity, frame, _told(e, frame), uris))
    return rows


def _told(e: EntityDifference, frame: int) -> str:
    one = next(f for f in e.frames if f.at.index == frame)
    return figure_words(one.figures)


def _worst(e: EntityDifference, most: int) -> list[int]:
    ranked = sorted(e.frames, key=lambda f: f.badness, reverse=True)
    return [f.at.index for f in ranked if f.at.index is not None][:most]


def _at(recording: Recording, entity: str, frames: Collection[int]) -> Mapping[int, Value]:
    shown = (Picture, Raster, Labels, DepthMap)
    entries = (e for e in recording.entries([entity], frames) if e.index in frames and isinstance(e.value, shown))
    return {e.index: e.value for e in entries if e.index is not None}


def apart(a: Value, b: Value) -> UInt8 | None:
    """Where two values differ, bright; None where they cannot be laid over each other."""
    match a, b:
        case Labels(x), Labels(y) if x.shape == y.shape:
            return np.asarray(np.where((x != y)[..., None], np.uint8(255), np.uint8(0)).repeat(3, axis=2), np.uint8)
        case Raster(x, _), Raster(y, _) if x.shape == y.shape and x.ndim == 2:
            return _distance(x.astype(np.float32) - y.astype(np.float32))
        case Raster(x, ("u", "v")), Raster(y, _) if x.shape == y.shape:
            return _distance(np.hypot(*(x.astype(np.float32) - y.astype(np.float32))))
        case DepthMap(), DepthMap():
            try:
                return _distance(metres(a) - metres(b))
            except ValueError:
                return None
        case Picture(), Picture():
            u, v = picture("", a), picture("", b)
            if u is None or v is None or u.shape != v.shape:
                return None
            return _distance(np.abs(u.astype(np.float32) - v.astype(np.float32)).max(axis=-1))
        case _:
            return None


def _distance(difference: NDArray[Any]) -> UInt8:
    """Distances up to their 99th percentile."""
    size = np.abs(difference)
    known = size[np.isfinite(size)]
    return coloured(size, 0.0, max(float(np.percentile(known, 99)) if known.size else 0.0, 1e-6), cv2.COLORMAP_MAGMA)
