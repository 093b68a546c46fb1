"""The panels that a sheet can have: what each needs of a recording, how it is drawn, what its colours mean."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np

from vlmm_log.drawing.pictures import NAMED, painted, picture
from vlmm_log.entries import Boxes, Labels, Picture, Table, Value
from vlmm_log.image_files import stated_size
from vlmm_log.sinks.legend import CLASSES, PAPER, UNKNOWN, bar, directions, swatches, text_width, write
from vlmm_log.sinks.map_entries import COLOR_OF, MAP, id_color, mask_classes
from vlmm_log.sinks.pair_entries import IMAGE, LOOKS, OUTCOME, TRUTH
from vlmm_log.types import UInt8

Values = Mapping[str, Value]
"""Entity -> what a recording holds of it at a frame."""
Size = tuple[int, int]
"""Width and height px."""

FLOW, RGB, BOXES, INSTANCES = (f"{IMAGE}/{name}" for name in ("flow/color", "rgb", "boxes", "instances"))
ELEMENTS = f"{MAP}/elements"
YOUNG = (UNKNOWN,) * 3  # an instance that is no element of the map yet


@dataclass(frozen=True)
class Panel:
    """One of them. ``needs`` come first among the entities that it shows."""

    title: str
    needs: str
    draw: Callable[[Values, Size], UInt8 | None]  # None: there is nothing at this frame
    others: tuple[str, ...] = ()
    legend: Callable[[int], UInt8] | None = None  # of a width

    @property
    def entities(self) -> tuple[str, ...]:
        """All that it shows."""
        return self.needs, *self.others


def _scaled(pixels: UInt8, size: Size) -> UInt8:
    how = cv2.INTER_AREA if pixels.shape[1] > size[0] else cv2.INTER_NEAREST
    return np.asarray(cv2.resize(pixels, size, interpolation=how), np.uint8)


def _plain(entity: str, values: Values, size: Size) -> UInt8 | None:
    """One entity as it is."""
    pixels = picture(entity, values[entity]) if entity in values else None
    return None if pixels is None else _scaled(pixels, size)


def _colour(values: Values, size: Size) -> UInt8 | None:
    """The image, and boxes around its instances."""
    pixels = _plain(RGB, values, size)
    if pixels is not None:
        _boxes(pixels, values, id_color)
    return pixels


def _elements(values: Values, size: Size) -> UInt8 | None:
    """Instances in the colour of the motion class that the map gives them at this frame, over the darkened image."""
    masks, table = values.get(INSTANCES), values.get(ELEMENTS)
    if not isinstance(masks, Labels):
        return None
    colors: dict[int, tuple[int, ...]] = {int(i): YOUNG for i in np.unique(masks.values) if i}
    known: dict[int, tuple[int, int, int]] = {}
    if isinstance(table, Table) and len(table):
        ids, classes = np.asarray(table.columns["element_id"]), table.columns["motion_class"]
        known = {int(i): COLOR_OF[str(c)] for i, c in zip(mask_classes(ids), classes, strict=True)}
    paint = _scaled(painted(masks.values, {i: known.get(i, color) for i, color in colors.items()}), size)
    inside = _scaled(np.where(masks.values[..., None] > 0, np.uint8(255), np.uint8(0)).repeat(3, axis=2), size)
    below = _plain(RGB, values, size)
    below = np.zeros_like(paint) if below is None else below
    grey = cv2.cvtColor(cv2.cvtColor(below, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
    pixels = np.where(inside > 127, cv2.addWeighted(grey, 0.35, paint, 0.65, 0), (0.5 * grey).astype(np.uint8))
    pixels = np.ascontiguousarray(pixels, np.uint8)
    _boxes(pixels, values, lambda i: known.get(int(mask_classes(np.array([i]))[0]), YOUNG))
    return pixels


def _boxes(on: UInt8, values: Values, color: Callable[[int], tuple[int, ...]]) -> None:
    """Boxes and their names, which stay in sight."""
    boxes, image = values.get(BOXES), values.get(RGB)
    size = stated_size(image.data) if isinstance(image, Picture) else None
    if not isinstance(boxes, Boxes) or size is None:
        return
    scale = np.array([on.shape[1] / size[0], on.shape[0] / size[1]] * 2)
    for corners, i, name in zip(boxes.corners * scale, boxes.ids.tolist(), boxes.names, strict=True):
        left, top, right, bottom = (round(float(c)) for c in corners)
        cv2.rectangle(on, (left, top), (right, bottom), color(i)[::-1], 1)
        told = f"{i} {name}".strip()
        x = max(min(left, on.shape[1] - text_width(told) - 4), 0)
        y = max(min(top, on.shape[0] - 18), 0)
        on[y : y + 18, x : x + text_width(told) + 4] = PAPER
        write(on, told, x + 2, y - 1)


def _field(title: str, path: str, unit: str = "", absent: str = "not scored") -> Panel:
    """A field of numbers in the range that the viewer shows, too."""
    entity = f"{IMAGE}/{path}"
    return Panel(title, entity, partial(_plain, entity), legend=partial(bar, LOOKS[entity], unit, absent=absent))


def _classes(title: str, entity: str) -> Panel:
    """Pixels of named classes."""
    named = [(name.replace("_", " "), color) for _, name, color in NAMED[entity].classes]
    return Panel(title, entity, partial(_plain, entity), legend=partial(swatches, named))


PANELS: Mapping[str, Panel] = {
    "rgb": Panel("colour, instances", RGB, _colour, (BOXES,)),
    "depth": _field("depth", "depth", " m", "unseen"),
    "flow": Panel("optical flow: where to, as hue", FLOW, partial(_plain, FLOW), legend=directions),
    "d_m": _field("d_M: how many sigmas off the static world", "residual/d_m", " sigmas"),
    "validity": _classes("validity: why a pixel is not scored", f"{IMAGE}/validity"),
    "elements": Panel(
        "elements by motion class",
        INSTANCES,
        _elements,
        (RGB, ELEMENTS, BOXES),
        partial(swatches, [*CLASSES, ("not in the map yet", YOUNG)]),
    ),
    "instances": Panel("instances", INSTANCES, partial(_plain, INSTANCES)),
    "norm": _field("|m|: length of the residual", "residual/norm", " m"),
    "sigma_z": _field("sigma_z", "residual/sigma_z", " m"),
    "p_stat": _field("p_stat: probability if static", "residual/p_stat"),
    "fb_error": _field("forward-backward error", "flow/fb_error", " px", "no flow"),
    "p_moving": _field("probability of motion", "residual/p_moving"),
    "score": _field("score that is judged", "score"),
    "truth": _classes("truth", TRUTH),
    "outcome": _classes("against the truth", OUTCOME),
}
DEFAULT = ("rgb", "depth", "flow", "d_m", "validity", "elements")
