"""The images of a bag as they stream by."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from vlmm_log.readers.bag.cameras import Cameras, changed
from vlmm_log.readers.bag.containers import Container, MessageError
from vlmm_log.readers.bag.messages import UNREADABLE, image_of, stamp_of
from vlmm_log.readers.bag.topics import Choice
from vlmm_log.readers.images import ImageError
from vlmm_log.readers.stored import Kind, Shot, StoredImage
from vlmm_log.types import Skipped

FLOATS = ("32FC1", "64FC1")


def shots(
    container: Container, choice: Choice, of: Cameras, depth_offset_ns: int, window: tuple[int, int]
) -> Iterator[Shot | Skipped]:
    """Images of a window of log time in log order; what is damaged, and cameras that change, are told."""
    kinds: dict[str, Kind] = {choice.rgb.topic.name: "rgb", choice.depth.topic.name: "depth"}
    late_ns = {"rgb": 0, "depth": depth_offset_ns}
    infos = of.infos
    for message in container.messages([*kinds, *(name for name, _, _ in infos)], *window):
        if isinstance(message, Skipped):
            yield message
            continue
        if message.topic.name not in kinds:
            yield from changed(infos, message)
            continue
        kind = kinds[message.topic.name]
        what = f"{message.topic.name} {message.ordinal}"
        index = message.ordinal if kind == "rgb" else None
        try:
            content = message.decode()
            stamp_ns = stamp_of(content)
        except MessageError as e:
            yield Skipped(message.log_ns, what, str(e), index)
            continue
        load = partial(_image, content, message.topic.type)
        if kind == "depth":
            load = partial(_depth, load, choice.depth.encoding)
        yield Shot(kind, stamp_ns + late_ns[kind], message.ordinal, what, load)


def _image(content: Any, type_name: str) -> StoredImage:
    try:
        return image_of(content, type_name)
    except MessageError as e:
        raise ImageError(str(e)) from e
    except UNREADABLE as e:
        raise ImageError("message lacks a field") from e


def _depth(load: Callable[[], StoredImage], first: str) -> StoredImage:
    """A depth image of the first one's kind, by whose unit all are scaled. Raises ImageError."""
    image = load()
    if image.encoding.startswith(FLOATS) != first.startswith(FLOATS):
        raise ImageError(f"depth image's encoding {image.encoding[:40]!r} goes not with the first one's")
    return image
