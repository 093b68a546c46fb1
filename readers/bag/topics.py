"""Which topics are colour, depth, camera and poses: those given, else the best of a ranking."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from vlmm_log.readers.bag.containers import Container, Message, MessageError, Topic
from vlmm_log.readers.bag.messages import CAMERAS, IMAGES, POSES, TRANSFORMS, UNREADABLE, frame_of, image_of
from vlmm_log.readers.bag.ranking import (
    TF,
    Candidate,
    ImageTopic,
    depth_score,
    is_depth,
    ranked,
    ranked_infos,
    ranked_poses,
    rgb_score,
)
from vlmm_log.types import InputError

ROLES = ("rgb", "depth", "info", "depth_info", "pose")


@dataclass(frozen=True, eq=False)
class Choice:
    """Which topic plays which role, and what else could have."""

    rgb: ImageTopic
    depth: ImageTopic
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
    depths = [s for s in streams if is_depth(s)]
    colours = [s for s in streams if not is_depth(s)]
    found = {"depth": ranked(depths, depth_score)}
    depth = _taken(container, "depth", given, named, found)
    found["rgb"] = ranked(colours, partial(rgb_score, beside=depth))
    rgb = _taken(container, "rgb", given, named, found)
    if rgb.topic.name == depth.topic.name:
        raise InputError(
            f"{container.path}: {rgb.topic.name} cannot be both colour and depth; give --topics rgb=..,depth=.."
        )
    cameras = [t for t in container.topics if t.type in CAMERAS]
    found["info"] = ranked_infos(cameras, rgb.topic.name)
    found["depth_info"] = ranked_infos(cameras, depth.topic.name)
    found["pose"] = ranked_poses(container.topics)
    chosen = {
        role: given[role] if role in given else (found[role][0].topic if found[role] else "")
        for role in ("info", "depth_info", "pose")
    }
    pose = "" if chosen["pose"] == "none" else chosen["pose"]
    return Choice(rgb, depth, chosen["info"], chosen["depth_info"], pose, found)


def first_image(container: Container, topic: Topic) -> ImageTopic | None:
    """What the first readable of a topic's first messages says; None where none can be read."""
    for k, message in enumerate(container.messages([topic.name], container.start_ns, container.stop_ns)):
        if isinstance(message, Message) and message.topic.type == topic.type:
            try:
                content: Any = message.decode()
                image = image_of(content, topic.type)
                encoding = image.encoding or _form(content, image.data)
                return ImageTopic(topic, encoding, frame_of(content), (image.height, image.width))
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


def _taken(
    container: Container,
    role: str,
    given: Mapping[str, str],
    streams: Mapping[str, ImageTopic],
    ranked: Mapping[str, tuple[Candidate, ...]],
) -> ImageTopic:
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


def _names(topics: Iterable[Topic]) -> str:
    listed = sorted(f"{t.name} ({t.type})" for t in topics)
    return ", ".join(listed[:12]) + (f" and {len(listed) - 12} more" if len(listed) > 12 else "") if listed else "none"
