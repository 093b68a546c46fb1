"""The method over a log: what each pair of keyframes teaches."""

from __future__ import annotations

import hashlib
from collections.abc import Generator, Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass, replace

import numpy as np

from vlmm_log.elements import Instances, WorldMap
from vlmm_log.pipeline.ego import refine_ego
from vlmm_log.pipeline.flow import estimate_flow
from vlmm_log.pipeline.fusion import fuse
from vlmm_log.pipeline.keyframes import Gap, pairs, prefetched
from vlmm_log.pipeline.matches import match
from vlmm_log.pipeline.motion import measure_motion
from vlmm_log.pipeline.objects import gather_instances, place
from vlmm_log.pipeline.odometry import locate
from vlmm_log.pipeline.posterior import posterior
from vlmm_log.pipeline.tracks import Tracks, associate, carrying, remember
from vlmm_log.pipeline.world_map import Still, background, empty_map, still_points, update
from vlmm_log.protocols import Models, Observe, unseen
from vlmm_log.settings import KeyframeSettings, Settings
from vlmm_log.types import Ego, Features, Float32, Frame, FramePair, Odometry, Skipped, freeze

READ_AHEAD = 4  # frames


@dataclass(frozen=True, eq=False)
class World:
    """What the pairs so far have taught."""

    map: WorldMap
    tracks: Tracks
    has_poses: bool  # whether the log has any: then the map lies in their world
    odometry: Odometry | None = None


def empty_world(s: Settings, *, has_poses: bool) -> World:
    """Nothing yet."""
    return World(empty_map(s.map), Tracks(), has_poses)


@dataclass(frozen=True, eq=False)
class Look:
    """What a pair shows by itself, whatever came before: all that ``learn`` asks of it."""

    ego: Ego
    instances: Instances
    features: Features
    carrier: Float32  # see tracks.carrying
    still: Still

    def __post_init__(self) -> None:
        freeze(self)


def step(pair: FramePair, world: World, models: Models, s: Settings, observe: Observe = unseen) -> World:
    """What this pair teaches."""
    return learn(pair, look(pair, models, s, observe), world, models, s, observe)


def look(pair: FramePair, models: Models, s: Settings, observe: Observe = unseen) -> Look:
    """What moved between the frames of a pair: needs nothing but the pair, so that pairs may be taken side by side."""
    flow = observe(estimate_flow(pair, models.flow))
    segments = observe(models.segment(pair.first))
    matches = observe(match(pair, flow, s.gate, s.noise))
    ego = observe(refine_ego(matches, segments, s.ego, randomness(s.seed, pair)))
    motion = observe(measure_motion(matches, ego))
    if models.calibration is not None:
        observe(posterior(motion, models.calibration.pixel))
    features = observe(Features(models.embed.regions(pair.first, segments)))
    instances = observe(gather_instances(pair, segments, motion, s.objects))
    return Look(ego, instances, features, carrying(flow), still_points(pair, motion))


def learn(pair: FramePair, seen: Look, world: World, models: Models, s: Settings, observe: Observe = unseen) -> World:
    """What a look at the next pair teaches: where it was taken, which element each instance is, what they add up to."""
    ego = seen.ego
    odometry = observe(locate(pair, ego, world.odometry))
    sightings = observe(place(seen.instances, pair, ego, odometry, s.objects))
    tracked = observe(associate(sightings, seen.features, world.tracks, pair.first.stamp_ns, s.tracks))
    after = replace(world, tracks=remember(world.tracks, tracked, pair, seen.carrier, s.tracks), odometry=odometry)
    if world.has_poses and not odometry.anchored:
        first = pair.first
        observe(Skipped(first.stamp_ns, f"pair of frame {first.index}", "no pose yet: not in the map", first.index))
        return after
    if not ego.reliable:  # told by ``ego``; nothing of it enters the map
        return after
    curve = None if models.calibration is None else models.calibration.element
    grown = update(world.map, tracked, background(seen.still, odometry, s.map.voxel_m))
    return replace(after, map=observe(fuse(grown, models.prior, s.map, curve)))


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
