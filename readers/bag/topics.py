"""Which topics are colour, depth, camera and poses: a ranked guess from types, names, counts and first messages."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from vlmm_log.readers.bag.containers import Container, Message, MessageError, Topic
from vlmm_log.readers.bag.messages import (
    CAMERAS,
    ENCODED_IMAGES,
    IMAGES,
    POSES,
    TRANSFORMS,
    UNREADABLE,
    frame_of,
    image_of,
)
from vlmm_log.types import InputError

ROLES = ("rgb", "depth", "info", "depth_info", "pose")
DEPTH_ENCODINGS = ("16UC1", "mono16", "32FC1", "64FC1")
TRUTH = ("groundtruth", "ground_truth", "mocap", "vicon", "optitrack", "qualisys", "/gt")
NO_COLOUR = ("infra", "thermal", "mask", "debug", "overlay", "annotated", "depth_color", "fisheye")
NO_DEPTH = ("confidence", "mask", "infra", "debug", "points", "disparity")
DRIVERS = ("image_raw", "image_color", "image_rect", "image_rect_color")  # what cameras call an image, not detectors
TF = "tf"  # the pose "topic" that stands for the transform tree


@dataclass(frozen=True, eq=False)
class Stream:
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


@dataclass(frozen=True, eq=False)
class Choice:
    """Which topic plays which role, and what else could have."""

    rgb: Stream
    depth: Stream
    info: str  # "" where there is none
    depth_info: str
    pose: str  # a topic, "tf", "tf:FRAME" or ""
    ranked: Mapping[str, tuple[Candidate, ...]]  # role -> best first


def parse_topics(text: str) -> dict[str, str]:
    """'rgb=/a,depth=/b' as a dict of roles. Raises InputError."""
    given: dict[str, str] = {}
    for part in filter(None, (part.strip() for part in text.split(","))):
        role, equals, name = part.partition("=")
        if not equals or role.strip() not in ROLES or not name.strip():
            raise InputError(f"--topics {text}: write role=topic, with roles {', '.join(ROLES)}; a bare tf as pose")
        given[role.strip()] = name.strip()
    return given


def choose(container: Container, given: Mapping[str, str]) -> Choice:
    """Topics for every role: those given, else the best of a ranking. Raises InputError where none can be."""
    given = {role: _checked(container, role, name) for role, name in given.items()}
    streams = [s for t in container.topics if t.type in IMAGES and (s := first_image(container, t)) is not None]
    named = {s.topic.name: s for s in streams}
    depths = [s for s in streams if _is_depth(s)]
    colours = [s for s in streams if not _is_depth(s)]
    ranked = {"depth": _ranked(depths, _depth_score)}
    depth = _taken(container, "depth", given, named, ranked)
    ranked["rgb"] = _ranked(colours, partial(_rgb_score, beside=depth))
    rgb = _taken(container, "rgb", given, named, ranked)
    if rgb.topic.name == depth.topic.name:
        raise InputError(
            f"{container.path}: {rgb.topic.name} cannot be both colour and depth; give --topics rgb=..,depth=.."
        )
    cameras = [t for t in container.topics if t.type in CAMERAS]
    ranked["info"] = _infos(cameras, rgb.topic.name)
    ranked["depth_info"] = _infos(cameras, depth.topic.name)
    ranked["pose"] = _poses(container.topics)
    chosen = {
        role: given[role] if role in given else (ranked[role][0].topic if ranked[role] else "")
        for role in ("info", "depth_info", "pose")
    }
    pose = "" if chosen["pose"] == "none" else chosen["pose"]
    return Choice(rgb, depth, chosen["info"], chosen["depth_info"], pose, ranked)


def _checked(container: Container, role: str, name: str) -> str:
    """What was given for a role; any topic of transforms as pose is the whole tree. Raises InputError."""
    types = {t.type for t in container.topics if t.name == name}
    if role == "pose" and (name in (TF, "none") or name.startswith(f"{TF}:")):
        return name
    if not types:
        raise InputError(f"{container.path}: no topic {name} for {role}; there are {_names(container.topics)}")
    if role == "pose" and types & TRANSFORMS:
        return TF
    wanted = {"pose": POSES, "info": CAMERAS, "depth_info": CAMERAS}.get(role, types)
    if not types & wanted:
        raise InputError(
            f"{container.path}: topic {name} for {role} is of type {', '.join(sorted(types))}; name another"
        )
    return name


def first_image(container: Container, topic: Topic) -> Stream | None:
    """What the first readable of a topic's first messages says; None where none can be read."""
    for k, message in enumerate(container.messages([topic.name], container.start_ns, container.stop_ns)):
        if isinstance(message, Message) and message.topic.type == topic.type:
            try:
                content: Any = message.decode()
                image = image_of(content, topic.type)
                encoding = image.encoding or _form(content, image.data)
                return Stream(topic, encoding, frame_of(content), (image.height, image.width))
            except (MessageError, *UNREADABLE):
                pass
        if k > 20:
            break
    return None


def _form(message: Any, data: bytes | memoryview) -> str:
    """What an encoded image says of itself; Foxglove's format names no pixels, so a PNG's own header is asked."""
    form = str(getattr(message, "format", ""))
    head = bytes(data[:26])
    grey_16_bit = head.startswith(b"\x89PNG") and head[24:] == b"\x10\x00"  # IHDR: bits, colour type
    return f"16UC1; {form}" if form == "png" and grey_16_bit else form


def _is_depth(s: Stream) -> bool:
    named = "depth" in s.topic.name.lower() and not any(w in s.topic.name.lower() for w in ("color", "colour", "rgb"))
    registered = "depth" in s.topic.name.lower().rsplit("/", 2)[-2:][0] or "aligned_depth" in s.topic.name.lower()
    if s.topic.type in ENCODED_IMAGES:
        lossless = "jpeg" not in s.encoding.lower()
        return "compresseddepth" in s.encoding.lower() or (lossless and s.encoding.startswith(DEPTH_ENCODINGS))
    return s.encoding in DEPTH_ENCODINGS and (named or registered or s.encoding != "mono16")


def _ranked(streams: Iterable[Stream], score: Any) -> tuple[Candidate, ...]:
    most = max((s.topic.count or 0 for s in streams), default=0) or 1
    found = []
    for s in streams:
        points, why = score(s)
        share = (s.topic.count or 0) / most
        found.append(Candidate(s.topic.name, points + 2 * share, f"{s.topic.count} x {s.encoding}{why}"))
    return tuple(sorted(found, key=lambda c: (-c.score, c.topic)))


def _depth_score(s: Stream) -> tuple[float, str]:
    name = s.topic.name.lower()
    registered = any(word in name for word in ("aligned", "registered", "depth_to_rgb", "depth_to_color"))
    other = any(word in name for word in NO_DEPTH) or _infrared(name)
    raw = s.topic.type not in ENCODED_IMAGES
    points = 3.0 * registered + 1.0 * ("depth" in name) - 4.0 * other + 0.2 * raw
    return points, ", registered to colour by its name" if registered else ""


def _rgb_score(s: Stream, beside: Stream) -> tuple[float, str]:
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


def _infos(cameras: Iterable[Topic], image_topic: str) -> tuple[Candidate, ...]:
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


def _poses(topics: Iterable[Topic]) -> tuple[Candidate, ...]:
    found = []
    order = {"nav_msgs/msg/Path": 0.2, "nav_msgs/msg/Odometry": 0.5}
    trees = [t for t in topics if t.type in TRANSFORMS and t.name.rsplit("/", 1)[-1] != "tf_static"]
    if trees:
        found.append(Candidate(TF, 1.0, "transforms, if they join a world and the camera"))
    for topic in topics:
        if topic.type in POSES and topic.count != 0:
            truth = any(word in topic.name.lower() for word in TRUTH)
            goal = any(word in topic.name.lower() for word in ("goal", "initialpose", "setpoint", "target", "command"))
            score = 2.0 * truth - 3.0 * goal + order.get(topic.type, 0.4)
            why = f"{topic.count} x {topic.type.rsplit('/', 1)[-1]}{', ground truth by its name' if truth else ''}"
            found.append(Candidate(topic.name, score, why))
    return tuple(sorted((c for c in found if c.score > 0), key=lambda c: (-c.score, c.topic)))


def _taken(
    container: Container,
    role: str,
    given: Mapping[str, str],
    streams: Mapping[str, Stream],
    ranked: Mapping[str, tuple[Candidate, ...]],
) -> Stream:
    if role in given:
        if given[role] not in streams:
            raise InputError(f"{container.path}: topic {given[role]} for {role} holds no image that can be read")
        return streams[given[role]]
    if not ranked[role] or (role == "depth" and ranked[role][0].score < 0):  # infrared and the like alone
        what = {"depth": "16UC1, 32FC1 or compressedDepth", "rgb": "colour or grey images"}[role]
        raise InputError(
            f"{container.path}: no {role} topic ({what}); give --topics {role}=NAME; "
            f"there are {_names(container.topics)}"
        )
    return streams[ranked[role][0].topic]


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


def _names(topics: Iterable[Topic]) -> str:
    listed = sorted(f"{t.name} ({t.type})" for t in topics)
    return ", ".join(listed[:12]) + (f" and {len(listed) - 12} more" if len(listed) > 12 else "") if listed else "none"
