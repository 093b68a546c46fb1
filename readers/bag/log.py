"""A bag as a log: topics chosen, cameras and poses read, images synchronised as they stream by."""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

from vlmm_log.protocols import Log
from vlmm_log.readers import conventions
from vlmm_log.readers.assembly import Assembly
from vlmm_log.readers.bag.cameras import Cameras, cameras
from vlmm_log.readers.bag.clock import recorded_at
from vlmm_log.readers.bag.containers import Container, Message, is_container, open_container
from vlmm_log.readers.bag.image_stream import shots
from vlmm_log.readers.bag.messages import TRANSFORMS
from vlmm_log.readers.bag.ranking import TF
from vlmm_log.readers.bag.synchronise import LATENESS_NS, Pair, synchronised
from vlmm_log.readers.bag.topics import Choice, choose, parse_topics
from vlmm_log.readers.bag.trajectories import WORLDS, read_poses, read_tree, refusals
from vlmm_log.readers.bag.transforms import Tree
from vlmm_log.readers.intrinsics import Intrinsics
from vlmm_log.readers.poses import Poses
from vlmm_log.readers.stamps import FOREVER_NS, limit_ns, until_ns
from vlmm_log.readers.stored import Shot, Stream, stream
from vlmm_log.settings import ReadSettings
from vlmm_log.types import Float64, Frame, InputError, Skipped

STILL_NS = 5_000_000_000
LARGEST_TOLERANCE_S = 1.0  # beyond it, images would have to be held back for longer than they may be late


class Bag:
    """The reader."""

    name = "bag"

    def recognises(self, path: Path) -> bool:
        """A .bag, .mcap or .db3, or a folder of the latter two."""
        return is_container(path)

    def open(self, path: Path, s: ReadSettings) -> Log:
        """The log of a bag. Raises InputError where topics or cameras are missing."""
        if s.association_s > LARGEST_TOLERANCE_S:
            raise InputError(f"read.association_s = {s.association_s}: at most {LARGEST_TOLERANCE_S:g} s for a bag")
        container = open_container(path)
        choice = choose(container, parse_topics(s.topics))
        return BagLog(container, s, choice)


@dataclass
class BagLog:
    """An opened bag."""

    container: Container
    s: ReadSettings
    choice: Choice
    left_out: list[Skipped] = field(default_factory=list)  # what never became an image: losses, bad poses

    def __post_init__(self) -> None:
        first_ns = self.container.start_ns  # of what has no time of its own
        self.left_out += [replace(x, stamp_ns=x.stamp_ns or first_ns) for x in self.container.losses]
        self._told: list[str] = []
        self._cameras: Cameras = cameras(self.container, self.choice, lambda: self._still, self.s)

    @property
    def name(self) -> str:
        """The file's or folder's name."""
        return self.container.path.resolve().name.encode("utf-8", "backslashreplace").decode()

    @property
    def camera(self) -> Intrinsics:
        """See stored.StoredLog."""
        return self._cameras.rgb

    @property
    def depth_camera(self) -> tuple[Intrinsics, Float64] | None:
        """See stored.StoredLog."""
        return self._cameras.depth

    @property
    def units_per_meter(self) -> float:
        """See stored.StoredLog."""
        return self._cameras.units_per_meter

    @property
    def has_poses(self) -> bool:
        """Whether any pose was read."""
        return self.poses is not None

    @property
    def world_up(self) -> str:
        """That of the poses' world; the camera's -y where there are none."""
        return "-y" if self.poses is None else self.poses.world_up

    @property
    def notes(self) -> list[str]:
        """See protocols.Log."""
        c = self.choice
        told = [f"{self.container.kind}: colour {c.rgb.topic.name}, depth {c.depth.topic.name}"]
        told += [*self._assembly().notes(), *self._cameras.notes, *self._told]
        limited = " in the chosen window" if limit_ns(self.s.stop_s) < FOREVER_NS or self.s.start_s else ""
        found = "no poses"
        if self.poses is not None:
            many = f"{self.poses.stamps_ns.size} poses" if self.poses.moving else "a still pose"
            found = f"{many} from {self.poses.source}"
        told.append(found + limited)
        return [*told, f"the first frame at {self.origin_ns} ns"]

    @property
    def streams(self) -> tuple[Stream, ...]:
        """See stored.StoredLog."""
        c = self.choice
        roles = {c.rgb.topic.name: "rgb", c.depth.topic.name: "depth", c.depth_info: "depth_info", c.info: "info"}
        if self.poses is not None and self.poses.source.startswith(f"{TF}, "):
            roles |= {topic.name: "pose" for topic in self.container.topics if topic.type in TRANSFORMS}
        elif self.poses is not None:
            roles |= {self.poses.source: "pose"}
        return streams_of(self.container, roles)

    @property
    def posed(self) -> str:
        """See stored.StoredLog."""
        if self.poses is not None:
            return self.poses.source
        tried = ", ".join(self._pose_topics(self._still))
        return f"none in what was read of {tried}" if tried else ""

    @property
    def ranked(self) -> Mapping[str, tuple[str, ...]]:
        """See stored.StoredLog."""
        return {
            role: tuple(f"{c.topic} ({c.score:.1f}: {c.why})" for c in candidates)
            for role, candidates in self.choice.ranked.items()
        }

    @property
    def origin_ns(self) -> int:
        """Time of the first frame."""
        return self._first[1].stamp_ns

    def count(self, start_ns: int, stop_ns: int) -> int:
        """See protocols.Log; from the counts of messages, so about right only."""
        both = [t.count for t in (self.choice.rgb.topic, self.choice.depth.topic) if t.count is not None]
        whole = max(self.container.stop_ns - self.container.start_ns, 1)
        share = (min(stop_ns, whole) - max(start_ns, 0)) / whole
        return round(min(both) * min(max(share, 0.0), 1.0)) if both else 0

    def frames(self, start_ns: int, stop_ns: int) -> Iterator[Frame | Skipped]:
        """See protocols.Log. ``Frame.index`` is the message's position in the colour topic."""
        assembly = self._assembly()
        yield from self._lost
        with closing(self._pairs(start_ns, stop_ns)) as pairs:
            for item in pairs:
                since_ns = (item.stamp_ns if isinstance(item, Skipped) else item[1].stamp_ns) - self.origin_ns
                if since_ns >= until_ns(stop_ns) or (start_ns > 0 and since_ns < start_ns):
                    continue
                if isinstance(item, Skipped):
                    yield item
                elif since_ns < 0:
                    depth = item[1]
                    yield Skipped(depth.stamp_ns, depth.what, "stamp lies before the first frame's", item[0].index)
                else:
                    yield from assembly.frames(*item)

    def shots(self, start_ns: int, stop_ns: int) -> Iterator[Shot | Skipped]:
        """See stored.StoredLog."""
        yield from self._lost
        for shot in self._shots(*self._log_window(start_ns, stop_ns)):
            if isinstance(shot, Skipped) or start_ns <= shot.stamp_ns - self.origin_ns < until_ns(stop_ns):
                yield shot

    @property
    def _lost(self) -> list[Skipped]:
        """What never became an image or a pose. Poses are read first, so that what they lost is there."""
        _ = self.poses
        return self.left_out

    def _assembly(self) -> Assembly:
        return Assembly(self.camera, self.units_per_meter, self.poses, self.s, self.depth_camera)

    @cached_property
    def _first(self) -> Pair:
        """The first two images that belong together."""
        shots = self._shots(self.container.start_ns, self.container.stop_ns)
        with closing(synchronised(shots, limit_ns(self.s.association_s))) as pairs:
            for item in pairs:
                if not isinstance(item, Skipped):
                    return item
        raise InputError(
            f"{self.container.path}: no colour image within {self.s.association_s} s of a depth image; "
            "check the stamps or raise --set read.association_s"
        )

    @cached_property
    def _latency_ns(self) -> int:
        """How much later than its stamp the first frame was recorded."""
        topic = self.choice.depth.topic.name
        for message in self.container.messages([topic], self.container.start_ns, self.container.stop_ns):
            if isinstance(message, Message) and message.ordinal == self._first[1].index:
                return message.log_ns - self._first[1].stamp_ns
        return 0

    def _log_window(self, start_ns: int, stop_ns: int) -> tuple[int, int]:
        """The window of log time that holds a window of stamps, with room for images that come early or late."""
        first, last = self.container.start_ns, self.container.stop_ns
        if start_ns > 0:
            first = max(first, self._recorded(start_ns) - LATENESS_NS)
        if stop_ns < FOREVER_NS:
            last = min(last, self._recorded(stop_ns) + LATENESS_NS)
        return first, max(first, last)

    def _recorded(self, since_ns: int) -> int:
        """Log time of the moment so long after the first frame."""
        stamp_ns = self.origin_ns + since_ns - round(self.s.depth_offset_s * 1e9)
        even_ns = self.origin_ns + self._latency_ns + since_ns
        return recorded_at(self.container, self.choice.depth.topic.name, stamp_ns, even_ns)

    def _pairs(self, start_ns: int, stop_ns: int) -> Generator[Pair | Skipped]:
        """By time; what is damaged has only the recorder's, which may be far from that of the stamps."""
        shots = self._shots(*self._log_window(start_ns, stop_ns))
        known = {(x.what, x.reason) for x in self.left_out}  # a damaged chunk may hold images and poses
        new = (x for x in shots if not isinstance(x, Skipped) or (x.what, x.reason) not in known)
        placed = (replace(x, stamp_ns=x.stamp_ns - self._latency_ns) if isinstance(x, Skipped) else x for x in new)
        return synchronised(placed, limit_ns(self.s.association_s))

    def _shots(self, start_ns: int, stop_ns: int) -> Iterator[Shot | Skipped]:
        late_ns = round(self.s.depth_offset_s * 1e9)
        return shots(self.container, self.choice, self._cameras, late_ns, (start_ns, stop_ns))

    @cached_property
    def poses(self) -> Poses | None:
        """See stored.StoredLog; of the window that is asked for."""
        first, last = self._log_window(limit_ns(self.s.start_s), limit_ns(self.s.stop_s))
        room_ns = limit_ns(abs(self.s.pose_offset_s)) + limit_ns(self.s.pose_gap_s)
        window = max(first - room_ns, self.container.start_ns), min(last + room_ns, self.container.stop_ns)
        tree = read_tree(self.container, *window, self.left_out)
        if window[0] > self.container.start_ns:
            self._told += tree.complete(self._still)
        self.left_out += refusals(tree, self.choice, window[0])
        poses = None
        for pose in self._pose_topics(tree):
            poses = read_poses(self.container, replace(self.choice, pose=pose), tree, window, self.left_out, self._told)
            if poses is not None:
                break
            self._told.append(f"no poses could be had from {pose}")
        self._told += [f"transforms: {conflict}" for conflict in tree.conflicts()]
        if poses is None or self.s.poses == "none":
            return None
        return Poses(poses.links, poses.source, conventions.asked(self.s, poses.convention), poses.up)

    def _pose_topics(self, tree: Tree) -> tuple[str, ...]:
        """The one that was asked for; else every candidate, best first. A tree without a world comes last."""
        pose = self.choice.pose
        if not pose or "pose" in parse_topics(self.s.topics):
            return (pose,) if pose else ()
        found = [c.topic for c in self.choice.ranked["pose"]]
        if tree.ancestors(self.choice.rgb.frame)[-1] not in WORLDS:
            found.sort(key=lambda topic: topic == TF)
        return tuple(found)

    @cached_property
    def _still(self) -> Tree:
        """ROS 1 repeats still transforms on /tf, so its beginning is read too."""
        start_ns = self.container.start_ns
        return read_tree(self.container, start_ns, start_ns + STILL_NS, [])


def streams_of(container: Container, roles: Mapping[str, str]) -> tuple[Stream, ...]:
    """Every topic of a container, by its index alone; ``roles`` by topic."""
    found = []
    for topic in container.topics:
        role = roles.get(topic.name, "")
        times = container.log_times(topic.name)
        if times is None:
            found.append(Stream(topic.name, topic.type, role, topic.count, None, None, math.nan))
        else:
            found.append(stream(topic.name, topic.type, role, times))
    return tuple(found)
