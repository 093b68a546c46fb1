"""The cameras of a bag: colour intrinsics, depth scale, and how depth lies to colour."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from vlmm_log.readers import intrinsics
from vlmm_log.readers.bag.containers import Container, Message, MessageError
from vlmm_log.readers.bag.messages import camera_of
from vlmm_log.readers.bag.topics import Choice
from vlmm_log.readers.bag.transforms import Tree
from vlmm_log.readers.conventions import rigid_from_text
from vlmm_log.readers.intrinsics import Intrinsics
from vlmm_log.settings import ReadSettings
from vlmm_log.types import Float64, InputError


@dataclass(frozen=True, eq=False)
class Cameras:
    """What images are measured with."""

    rgb: Intrinsics
    depth: tuple[Intrinsics, Float64] | None  # see stored.StoredLog
    units_per_meter: float
    notes: tuple[str, ...]


def cameras(container: Container, choice: Choice, tree: Callable[[], Tree], s: ReadSettings) -> Cameras:
    """The cameras of the chosen topics. Raises InputError where one is missing."""
    notes: list[str] = []
    own = _info(container, choice.info, choice.rgb.topic.name)
    if own is None and not s.intrinsics:
        raise InputError(
            f"{container.path}: no camera_info for {choice.rgb.topic.name}; "
            "give --topics info=NAME or --intrinsics fx,fy,cx,cy"
        )
    rgb = intrinsics.asked(s, own, container.path)
    units = s.depth_units_per_meter or _logged_units(container, choice, notes) or _standard_units(choice)
    return Cameras(rgb, _depth_camera(container, choice, rgb, tree, s, notes), units, tuple(notes))


def _info(container: Container, topic: str, image_topic: str) -> Intrinsics | None:
    """The camera that the topic's first readable message describes."""
    for k, message in enumerate(container.messages([topic] if topic else [], container.start_ns, container.stop_ns)):
        if isinstance(message, Message):
            try:
                return camera_of(message.decode(), topic, image_topic)
            except MessageError:
                pass
        if k > 20:
            break
    return None


def _standard_units(choice: Choice) -> float:
    """REP 118: 16 bits are millimetres, floats metres."""
    return 1.0 if choice.depth.encoding.startswith(("32FC1", "64FC1")) else 1000.0


def _logged_units(container: Container, choice: Choice, notes: list[str]) -> float:
    """A scale that the log itself holds, as `convert` or a RealSense recorder writes it; 0 where there is none."""
    base = choice.depth.topic.name.removesuffix("/compressedDepth").removesuffix("/compressed")
    for topic in container.topics:
        ours = topic.name == f"{base}/units_per_meter"
        realsense = topic.name.endswith("/Depth_Units/value")
        if not (ours or realsense) or choice.depth.encoding.startswith(("32FC1", "64FC1")):
            continue
        for message in container.messages([topic.name], container.start_ns, container.stop_ns):
            value: Any = message.decode() if isinstance(message, Message) else None
            number = float(getattr(value, "data", 0.0))
            if number > 0 and np.isfinite(number):
                notes.append(f"depth scale from {topic.name}")
                return number if ours else round(1.0 / number, 6)
    return 0.0


def _depth_camera(
    container: Container,
    choice: Choice,
    rgb: Intrinsics,
    tree: Callable[[], Tree],
    s: ReadSettings,
    notes: list[str],
) -> tuple[Intrinsics, Float64] | None:
    depth_topic = choice.depth.topic.name
    claimed = any(word in depth_topic.lower() for word in ("aligned", "registered", "depth_to_rgb", "depth_to_color"))
    if s.depth_to_rgb == "registered":
        return None
    T = _extrinsic(s.depth_to_rgb) if s.depth_to_rgb else None
    own = _info(container, choice.depth_info, depth_topic)
    if T is None and (claimed or choice.rgb.frame == choice.depth.frame):
        if own is None or _same_grid(own, rgb):
            if choice.rgb.frame != choice.depth.frame:
                notes.append(f"{depth_topic} is taken as registered to colour, by its name; its frame says otherwise")
            return None
        T = np.eye(4)
    if T is None:
        T = tree().still_transform(choice.rgb.frame, choice.depth.frame)
    if T is None:
        raise InputError(
            f"{container.path}: depth ({choice.depth.frame!r}) is not registered to colour ({choice.rgb.frame!r}) "
            "and no still transform joins the two; give --set read.depth_to_rgb='tx,ty,tz,qx,qy,qz,qw' "
            "(registered: the pixels coincide) or a registered topic by --topics depth=NAME"
        )
    if own is None:
        raise InputError(
            f"{container.path}: no camera_info for {depth_topic}, which is not registered to colour; "
            "give --topics depth_info=NAME"
        )
    return own, T


def _extrinsic(text: str) -> Float64:
    T = rigid_from_text(text)
    if T is None:
        raise InputError(f"read.depth_to_rgb = {text!r}: give 'tx,ty,tz,qx,qy,qz,qw' in m, or registered")
    return T


def _same_grid(depth: Intrinsics, rgb: Intrinsics) -> bool:
    """Whether two cameras see the same pixels: then registered depth needs nothing."""
    bare = replace(depth, source=rgb.source, distortion=rgb.distortion, model=rgb.model, depth_scale=rgb.depth_scale)
    sizes_known = depth.width and rgb.width
    same = np.allclose([bare.fx, bare.fy, bare.cx, bare.cy], [rgb.fx, rgb.fy, rgb.cx, rgb.cy], rtol=1e-3)
    return bool(same and (not sizes_known or (depth.width, depth.height) == (rgb.width, rgb.height)))
