"""Models of one's own: masks by a rule of mine, movability by mine, and the method over a log with them.

    python examples/own_models.py LOG

A model is anything with the call that vlmm_log.protocols lists; nothing is inherited or registered.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import cv2
import numpy as np

from vlmm_log import Settings, open_log
from vlmm_log.elements import Movability, WorldMap
from vlmm_log.models.load import load_models
from vlmm_log.pipeline.run import Tally, empty_world, keyframe_pairs, step
from vlmm_log.types import Frame, Segments, Skipped

EVER = 10**18  # ns


def near_things(frame: Frame) -> Segments:
    """A Segmenter: connected pixels nearer than the frame's median depth, of at least a hundredth of it."""
    near = np.nan_to_num(frame.depth, nan=np.inf) < np.nanmedian(frame.depth)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(near.astype(np.uint8))
    large = [k for k in range(1, len(stats)) if stats[k, cv2.CC_STAT_AREA] > labels.size / 100]
    of = np.zeros(len(stats), np.int32)
    of[large] = np.arange(1, len(large) + 1)
    n = len(large)
    return Segments(of[labels], ("thing",) * n, np.ones(n, np.float32), np.full(n, -1, np.int64))


def half(label: str) -> Movability:
    """A MovabilityPrior: no opinion."""
    return Movability(0.5, f"mine, of {label!r}")


def mapped(path: str, sets: tuple[str, ...] = ()) -> WorldMap:
    """The map of a log by these models, and the built-in ones for the rest."""
    s = Settings.load(sets=sets)
    models = replace(load_models(s)[0], segment=near_things, prior=half)
    log = open_log(path, s.read)
    world = empty_world(s, has_poses=log.has_poses)
    for item in keyframe_pairs(log.frames(0, EVER), s, Tally()):
        if isinstance(item, Skipped):
            print(f"{item.what}: {item.reason}")
        else:
            world = step(item, world, models, s)
    return world.map


if __name__ == "__main__":
    for element in mapped(sys.argv[1]).elements.values():
        kind = element.motion_class.name.lower()
        print(f"{element.id} {element.label}: {kind}, o {element.o:.2f}, kappa {element.kappa:.2f}")
