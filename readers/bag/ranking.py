"""How well a topic suits a role: points by type, name, count, first message and what stands beside it."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from vlmm_log.readers.bag.containers import Topic
from vlmm_log.readers.bag.messages import ENCODED_IMAGES, POSES, TRANSFORMS

DEPTH_ENCODINGS = ("16UC1", "mono16", "32FC1", "64FC1")
TRUTH = ("groundtruth", "ground_truth", "mocap", "vicon", "optitrack", "qualisys", "/gt")
NO_COLOUR = ("infra", "thermal", "mask", "debug", "overlay", "annotated", "depth_color", "fisheye")
NO_DEPTH = ("confidence", "mask", "infra", "debug", "points", "disparity")
DRIVERS = ("image_raw", "image_color", "image_rect", "image_rect_color")  # what cameras call an image, not detectors
TF = "tf"  # the pose "topic" that stands for the transform tree


@dataclass(frozen=True, eq=False)
class ImageTopic:
    """An image topic and what its first message says."""

    topic: Topic
    encoding: str  # of StoredImage
    frame: str
    size: tuple[int, int]  # (H, W); (0, 0) for encoded images


@dataclass(frozen=True)
class Candidate:
    """A topic that may play a role."""

    topic: str
    score: float
    why: str


def is_depth(s: ImageTopic) -> bool:
    """Whether an image topic is depth, by its encoding and name."""
    named = "depth" in s.topic.name.lower() and not any(w in s.topic.name.lower() for w in ("color", "colour", "rgb"))
    registered = "depth" in s.topic.name.lower().rsplit("/", 2)[-2:][0] or "aligned_depth" in s.topic.name.lower()
    if s.topic.type in ENCODED_IMAGES:
        lossless = "jpeg" not in s.encoding.lower()
        return "compresseddepth" in s.encoding.lower() or (lossless and s.encoding.startswith(DEPTH_ENCODINGS))
    return s.encoding in DEPTH_ENCODINGS and (named or registered or s.encoding != "mono16")


def ranked(streams: Iterable[ImageTopic], score: Callable[[ImageTopic], tuple[float, str]]) -> tuple[Candidate, ...]:
    """Image topics with their points, best first."""
    most = max((s.topic.count or 0 for s in streams), default=0) or 1
    found = []
    for s in streams:
        points, why = score(s)
        share = (s.topic.count or 0) / most
        found.append(Candidate(s.topic.name, points + 2 * share, f"{s.topic.count} x {s.encoding}{why}"))
    return tuple(sorted(found, key=lambda c: (-c.score, c.topic)))


def depth_score(s: ImageTopic) -> tuple[float, str]:
    """Points of a depth topic, and what they are for."""
    name = s.topic.name.lower()
    registered = any(word in name for word in ("aligned", "registered", "depth_to_rgb", "depth_to_color"))
    other = any(word in name for word in NO_DEPTH) or _infrared(name)
    raw = s.topic.type not in ENCODED_IMAGES
    points = 3.0 * registered + 1.0 * ("depth" in name) - 4.0 * other + 0.2 * raw
    return points, ", registered to colour by its name" if registered else ""


def rgb_score(s: ImageTopic, beside: ImageTopic) -> tuple[float, str]:
    """Points of a colour topic to go with a depth topic, and what they are for."""
    name = s.topic.name.lower()
    named = any(word in name for word in ("rgb", "color", "colour"))
    colour = named or s.encoding.startswith(("rgb", "bgr", "bayer"))
    other = any(word in name for word in NO_COLOUR) or _infrared(name) or s.encoding.startswith(DEPTH_ENCODINGS)
    same_frame = s.frame == beside.frame
    shared = _shared(s.topic.name, beside.topic.name)
    points = 2.0 * colour - 4.0 * other + 1.5 * same_frame + 0.5 * min(shared, 2) + 0.3 * ("rect" in name)
    points += 0.2 * (s.topic.type not in ENCODED_IMAGES) + 0.1 * named + 0.1 * (_base(name).endswith(DRIVERS))
    return points, ", in the depth image's frame" if same_frame else ""


def _infrared(name: str) -> bool:
    """Whether "ir" is a word of a name: of /kinect2/sd/image_ir, not of /iris/camera."""
    return "ir" in re.split(r"[^a-z]+", name)


def ranked_infos(cameras: Iterable[Topic], image_topic: str) -> tuple[Candidate, ...]:
    """Camera topics in the order in which they stand near an image topic; only those of its own namespace."""
    base = _base(image_topic)
    found = []
    for topic in cameras:
        shared = _shared(topic.name, base)
        sibling = topic.name.rsplit("/", 1)[0] in (base.rsplit("/", 1)[0], base)
        realsense = topic.name == base.replace("/image/data", "/info/camera_info")
        if sibling or realsense:
            found.append(Candidate(topic.name, shared + 2.0, "beside the image"))
    return tuple(sorted(found, key=lambda c: (-c.score, c.topic)))


def ranked_poses(topics: Iterable[Topic]) -> tuple[Candidate, ...]:
    """Sources of poses, best first; goals and set-points are none."""
    found = []
    order = {"nav_msgs/msg/Path": 0.2, "nav_msgs/msg/Odometry": 0.5}
    trees = [t.name.rsplit("/", 1)[-1] for t in topics if t.type in TRANSFORMS]
    if trees:
        still = set(trees) == {"tf_static"}  # of a camera on a tripod, but of a robot too
        found.append(Candidate(TF, 0.1 if still else 1.0, "transforms, if they join a world and the camera"))
    for topic in topics:
        if topic.type in POSES and topic.count != 0:
            truth = any(word in topic.name.lower() for word in TRUTH)
            goal = any(word in topic.name.lower() for word in ("goal", "initialpose", "setpoint", "target", "command"))
            score = 2.0 * truth - 3.0 * goal + order.get(topic.type, 0.4)
            why = f"{topic.count} x {topic.type.rsplit('/', 1)[-1]}{', ground truth by its name' if truth else ''}"
            found.append(Candidate(topic.name, score, why))
    return tuple(sorted((c for c in found if c.score > 0), key=lambda c: (-c.score, c.topic)))


def _base(image_topic: str) -> str:
    """An image topic without what its transport adds."""
    for transport in ("/compressed", "/compressedDepth", "/theora"):
        image_topic = image_topic.removesuffix(transport)
    return image_topic


def _shared(a: str, b: str) -> int:
    """How many leading parts two names have in common."""
    count = 0
    for x, y in zip(a.strip("/").split("/"), b.strip("/").split("/"), strict=False):
        if x != y:
            break
        count += 1
    return count
