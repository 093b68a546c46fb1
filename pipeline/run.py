"""The method over a log: what each pair of keyframes teaches."""

from __future__ import annotations

import hashlib
from collections.abc import Generator, Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass

import numpy as np

from vlmm_log.pipeline.ego import refine_ego
from vlmm_log.pipeline.flow import estimate_flow
from vlmm_log.pipeline.keyframes import Gap, pairs, prefetched
from vlmm_log.pipeline.matches import match
from vlmm_log.pipeline.motion import measure_motion
from vlmm_log.protocols import FlowEstimator, Observe, unseen
from vlmm_log.settings import KeyframeSettings, Settings
from vlmm_log.types import Frame, FramePair, Motion, Skipped

READ_AHEAD = 4  # frames


@dataclass(frozen=True)
class Models:
    """What the method asks of learned or library models."""

    flow: FlowEstimator


def step(pair: FramePair, models: Models, s: Settings, observe: Observe = unseen) -> Motion:
    """What this pair shows of motion."""
    flow = observe(estimate_flow(pair, models.flow))
    matches = observe(match(pair, flow, s.gate, s.noise))
    ego = observe(refine_ego(matches, s.ego, randomness(s.seed, pair)))
    return observe(measure_motion(matches, ego))


@dataclass
class Tally:
    """What a stream of frames held, counted as it goes by."""

    frames: int = 0

    def __post_init__(self) -> None:
        self._digest = hashlib.sha256()

    def counted(self, stream: Iterable[Frame | Skipped]) -> Iterator[Frame | Skipped]:
        """The same stream."""
        for item in stream:
            if isinstance(item, Frame):
                self.frames += 1
                self._add(item)
            yield item

    def input_hash(self) -> str:
        """SHA-256 over every frame's index, stamp, images, intrinsics and pose: alike in any container."""
        return self._digest.hexdigest()

    def _add(self, frame: Frame) -> None:
        pose = b"no pose" if frame.T_world_cam is None else frame.T_world_cam.tobytes()
        self._digest.update(f"{frame.index} {frame.stamp_ns} {frame.rgb.shape}".encode())
        for part in (frame.rgb.data, frame.depth.data, frame.K.tobytes(), pose):
            self._digest.update(part)


def expected_pairs(frames: int, s: KeyframeSettings) -> int:
    """How many pairs a stream of so many frames gives, if none is left out."""
    starts = frames - Gap.parse(s.gap).frames
    return max(-(-starts // s.stride), 0)


def keyframe_pairs(stream: Iterable[Frame | Skipped], s: Settings, tally: Tally) -> Generator[FramePair | Skipped]:
    """Pairs of a stream of frames, decoded ahead in a thread, and all that was left out."""
    with closing(prefetched(tally.counted(stream), READ_AHEAD)) as frames:
        yield from pairs(frames, s.keyframes)


def randomness(seed: int, pair: FramePair) -> np.random.Generator:
    """A generator of the pair's own, so that no result depends on what was processed before."""
    return np.random.default_rng([seed, pair.first.index, pair.second.index])
