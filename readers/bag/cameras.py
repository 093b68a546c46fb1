"""The cameras of a bag: colour intrinsics, depth scale, and how depth lies to colour."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from vlmm_log.readers import intrinsics
from vlmm_log.readers.bag.containers import Container, Message, MessageError
from vlmm_log.readers.bag.messages import UNREADABLE, camera_of
from vlmm_log.readers.bag.topics import Choice
from vlmm_log.readers.bag.transforms import Tree
from vlmm_log.readers.conventions import rigid_from_text
from vlmm_log.readers.intrinsics import Intrinsics
from vlmm_log.settings import ReadSettings
from vlmm_log.types import Float64, InputError, Skipped

NO_FRAMES = ("", "0")  # frame ids that say nothing; RealSense's own recorder gives "0" to all of its cameras


@dataclass(frozen=True, eq=False)
class Cameras:
    """What images are measured with."""

    rgb: Intrinsics
    depth: tuple[Intrinsics, Float64] | None  # see stored.StoredLog
    units_per_meter: float
    notes: tuple[str, ...]
    infos: tuple[tuple[str, str, Intrinsics], ...] = ()  # topic, of which images, what its first message says


def cameras(container: Container, choice: Choice, tree: Callable[[], Tree], s: ReadSettings) -> Cameras:
    """The cameras of the chosen topics. Raises InputError where one is missing."""
    notes: list[str] = []
    of_rgb, of_depth = choice.rgb.topic.name, choice.depth.topic.name
    own = _info(container, choice.info, of_rgb)
    if isinstance(own, InputError) and not s.intrinsics:
        raise own
    if own is None and not s.intrinsics:
        raise InputError(
            f"{container.path}: no camera_info for {of_rgb}; give --topics info=NAME or --intrinsics fx,fy,cx,cy"
        )
    known = own if isinstance(own, Intrinsics) else None
    rgb = _with_lens(intrinsics.asked(s, known, container.path))
    units = s.depth_units_per_meter or _logged_units(container, choice, notes) or _standard_units(choice)
    depth = _depth_camera(container, choice, known, rgb, tree, s, notes)
    infos = [(choice.info, of_rgb, known)] if known is not None and not s.intrinsics else []
    listed = _info(container, choice.depth_info, of_depth) if depth is not None else None
    infos += [(choice.depth_info, of_depth, listed)] if isinstance(listed, Intrinsics) else []
    return Cameras(rgb, depth, units, tuple(notes), tuple(infos))


def changed(infos: Iterable[tuple[str, str, Intrinsics]], message: Message) -> Iterator[Skipped]:
    """What a later camera_info says otherwise than the first, by which all images are measured."""
    for topic, image_topic, first in infos:
        if topic != message.topic.name:
            continue
        reason = "camera_info differs from the first one, which is used"
        try:
            if camera_of(message.decode(), topic, image_topic) == first:
                continue
        except (MessageError, InputError, *UNREADABLE):
            reason = "camera_info cannot be used"
        yield Skipped(message.log_ns, f"{topic} {message.ordinal}", reason)


def _info(container: Container, topic: str, image_topic: str) -> Intrinsics | InputError | None:
    """The camera that the first usable one of the topic's first messages describes; why none does; None of none."""
    refused: InputError | None = None
    for k, message in enumerate(container.messages([topic] if topic else [], container.start_ns, container.stop_ns)):
        if isinstance(message, Message):
            try:
                return camera_of(message.decode(), topic, image_topic)
            except (MessageError, *UNREADABLE):
                pass
            except InputError as e:
                refused = refused or e
        if k > 20:
            break
    return refused


def _with_lens(camera: Intrinsics) -> Intrinsics:
    try:
        return intrinsics.checked(camera, camera.source)
    except InputError as e:
        raise InputError(f"{e}; give --set read.distortion=k1,k2,p1,p2,k3 or read.distortion=none") from e


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
            try:
                value: Any = message.decode() if isinstance(message, Message) else None
                number = float(getattr(value, "data", 0.0))
            except (MessageError, *UNREADABLE) as e:
                notes.append(f"{topic.name} cannot be used: {e}")
                continue
            if number > 0 and np.isfinite(number):
                notes.append(f"depth scale from {topic.name}")
                return number if ours else float(f"{1.0 / number:.6g}")  # 0.001 as float32
    return 0.0


def _depth_camera(
    container: Container,
    choice: Choice,
    of_rgb: Intrinsics | None,
    rgb: Intrinsics,
    tree: Callable[[], Tree],
    s: ReadSettings,
    notes: list[str],
) -> tuple[Intrinsics, Float64] | None:
    """See stored.StoredLog. ``of_rgb`` is the log's own colour camera, ``rgb`` what the settings made of it."""
    depth_topic = choice.depth.topic.name
    claimed = any(word in depth_topic.lower() for word in ("aligned", "registered", "depth_to_rgb", "depth_to_color"))
    if s.depth_to_rgb == "registered":
        return None
    T = _extrinsic(s.depth_to_rgb) if s.depth_to_rgb else None
    own = _info(container, choice.depth_info, depth_topic)
    if isinstance(own, Intrinsics) and s.distortion == "none":
        own = replace(own, distortion=())
    same_frame = choice.rgb.frame == choice.depth.frame
    if T is None and (claimed or same_frame):
        # Whoever corrects the colour camera does not move the pixels: the log's own cameras are compared.
        if not isinstance(own, Intrinsics) or _same_grid(own, of_rgb or rgb) or (claimed and of_rgb is None):
            if not same_frame:
                notes.append(f"{depth_topic} is taken as registered to colour, by its name; its frame says otherwise")
            return None
        T = np.eye(4) if claimed or choice.depth.frame not in NO_FRAMES else None
    elif T is None:
        T = tree().still_transform(choice.rgb.frame, choice.depth.frame)
    if T is None:
        raise InputError(
            f"{container.path}: depth ({choice.depth.frame!r}) is not registered to colour ({choice.rgb.frame!r}) "
            "and no still transform joins the two; give --set read.depth_to_rgb='tx,ty,tz,qx,qy,qz,qw' "
            "(registered: the pixels coincide) or a registered topic by --topics depth=NAME"
        )
    if isinstance(own, InputError):
        raise own
    if own is None:
        raise InputError(
            f"{container.path}: no camera_info for {depth_topic}, which is not registered to colour; "
            "give --topics depth_info=NAME"
        )
    return _with_lens(own), T


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
