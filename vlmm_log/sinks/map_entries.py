"""What a recording shows of objects: masks, boxes, observations, the map and its history, query hits."""

from __future__ import annotations

import colorsys
import hashlib
import re
from collections.abc import Iterator, Mapping

import numpy as np

from vlmm_log.elements import (
    CLASS_COLORS,
    OBSERVATION,
    Element,
    Elements,
    MotionClass,
    Tracked,
    WorldMap,
    class_posterior,
)
from vlmm_log.entries import (
    Boxes,
    Cloud,
    Column,
    Ellipsoids,
    LabelNames,
    Labels,
    LogLine,
    Scalar,
    StateNames,
    States,
    Table,
)
from vlmm_log.queries import Answer
from vlmm_log.sinks.pair_entries import IMAGE, Named
from vlmm_log.types import Float32, Float64, Int64, UInt16

CLASS_NAMES = tuple(kind.name.lower() for kind in MotionClass)  # by number: an enumeration is slow to ask
COLOR_OF = {kind.name.lower(): color for kind, color in CLASS_COLORS.items()}
HIT_COLOR = (240, 228, 66)
CLEAR = (0, 0, 0, 0)  # pixels of no instance
MAP = "world/map"
SIGMAS = 2.0  # half axis of an ellipsoid in standard deviations of the element's points
HISTORY = 3  # observations from which on an element has a history: what is seen in passing would crowd the recording
MORE = 1000  # voxels
GROWTH = 1.25  # the background cloud is logged again once it has grown by this factor: its whole cost stays linear
FEW_NAMES = 256  # of masks, up to which all are told with each new one; then as the cloud is, by growth, or
WAITING = 64  # frames after the first that has an untold one
LARGEST_ID = 65535  # that a mask image holds; element ids beyond it come round again


class MapEntries:
    """Objects and the map as entries; remembers what the recording shows already."""

    def __init__(self) -> None:
        self._tracked: Tracked | None = None
        self._world: WorldMap | None = None
        self._names: dict[int, str] = {}  # of the masks' classes
        self._untold = 0  # of them: new or changed
        self._waiting = 0  # frames since then
        self._states: dict[int, tuple[str, str]] = {}
        self._labels: dict[int, str] = {}  # that the lanes bear
        self._in_view: set[int] = set()  # elements of the last pair
        self._asked: set[str] = set()  # paths of queries
        self._priors: set[str] = set()  # what was told of labels
        self._points = 0  # that are shown
        self._held = 0  # in all levels when it was last counted: levels overlap

    def of_tracked(self, result: Tracked) -> Iterator[Named]:
        """Masks, boxes and observations of a frame."""
        self._tracked = result
        yield from self._masks(result)
        yield f"{IMAGE}/boxes", _boxes(result)
        rows, segments = result.sightings.rows, result.sightings.segments
        columns: dict[str, Column] = {name: np.ascontiguousarray(rows[name]) for name in OBSERVATION.names or ()}
        columns = {"element_id": result.ids, **columns, "name": segments.names, "detection_score": segments.scores}
        columns |= {"observed": result.sightings.observed, "similarity": result.similarity}
        yield f"{MAP}/observations", Table(columns)

    def of_world(self, result: WorldMap, index: int | None) -> Iterator[Named]:
        """The elements, what changed of them, and the background once it has grown."""
        self._world = result
        elements = result.columns
        if len(elements):
            columns = element_columns(elements)
            yield f"{MAP}/elements", Table(columns, element_ellipsoids(columns))
        yield from self._unseen(result)
        for i in result.touched:
            if i in result.elements:
                yield from self._history(result.elements[i])
                yield from self._prior(result.elements[i])
        yield from _features(result, index)
        held = sum(len(cloud.cells) for cloud in result.clouds)
        self._held = min(self._held, held)  # fewer where levels were merged
        if held > GROWTH * max(self._points, self._held) + MORE:  # to merge them costs: not at each pair
            self._held = held
            if len(result.background.cells) > GROWTH * self._points + MORE:
                yield self._cloud(result)

    def of_answer(self, result: Answer) -> Iterator[Named]:
        """An answer's elements in the map, and their pixels in the frame."""
        path = f"query/{slug(result.text)}"
        if self._world is None:
            return
        if path not in self._asked:
            self._asked.add(path)
            yield f"{IMAGE}/{path}", hit_names(result)
        yield f"{MAP}/{path}", hits(self._world.columns, result)
        if self._tracked is not None:
            found = np.isin(self._tracked.ids, result.ids)
            lookup = np.concatenate([[0], found]).astype(np.uint8)
            yield f"{IMAGE}/{path}", Labels(lookup[self._tracked.sightings.segments.labels])

    def rest(self) -> Iterator[Named]:
        """The whole background and all names, if more of them is known than was shown."""
        if self._untold:
            yield self._label_names()
        if self._world is not None and len(self._world.background.cells) > self._points:
            yield self._cloud(self._world)

    def _masks(self, result: Tracked) -> Iterator[Named]:
        segments = result.sightings.segments
        classes = mask_classes(result.ids)
        lookup = np.concatenate([[0], classes]).astype(np.uint16)
        named = zip(classes, result.ids, segments.names, strict=True)  # the nameless keep the viewer's own colours
        names = {0: ""} | {int(c): f"{i} {name}" for c, i, name in named if name}
        yield f"{IMAGE}/instances", Labels(np.take(lookup, segments.labels))
        self._untold += len(names.items() - self._names.items())
        self._names |= names
        self._waiting += self._untold > 0
        grown = len(self._names) > GROWTH * (len(self._names) - self._untold)
        if self._untold and (len(self._names) <= FEW_NAMES or grown or self._waiting > WAITING):
            yield self._label_names()

    def _label_names(self) -> Named:
        """All that are known: the last ones told are those of the whole recording."""
        self._untold = self._waiting = 0
        told = tuple((c, name, id_color(c) if c else CLEAR) for c, name in sorted(self._names.items()))
        return f"{IMAGE}/instances", LabelNames(told)

    def _history(self, element: Element) -> Iterator[Named]:
        """Fused class and present motion as two lanes of states; the observation's score and reliability."""
        seen = element.evidence.observations
        if seen.size < HISTORY:
            return
        path, latest = f"{MAP}/elements/{element.id}", seen[-1]
        moves = element.intervals.size > 0 and bool(element.intervals[-1, 1] >= latest["second_ns"])
        state = (element.motion_class.name.lower(), "moves" if moves else "still")
        if self._labels.get(element.id) != element.label:
            self._labels[element.id] = element.label
            yield path, StateNames(element.label)
        if self._states.get(element.id) != state:
            self._states[element.id] = state
            yield path, States(state)
        yield f"{path}/o", Scalar(float(latest["o"]))
        yield f"{path}/kappa", Scalar(float(latest["kappa"]))

    def _unseen(self, result: WorldMap) -> Iterator[Named]:
        """A state of their own for elements that left the view."""
        for i in sorted((self._in_view - set(result.touched)) & self._states.keys()):
            self._states[i] = (self._states[i][0], "unseen")
            yield f"{MAP}/elements/{i}", States(self._states[i])
        self._in_view = {i for i in result.touched if i in result.elements}

    def _prior(self, element: Element) -> Iterator[Named]:
        """Once a label: its movability and where that comes from, a fallback too."""
        told = f"movability of {element.label!r}: {element.rho:.2f}, {element.rho_source}"
        if told not in self._priors:
            self._priors.add(told)
            yield "log", LogLine(told, "INFO")

    def _cloud(self, result: WorldMap) -> Named:
        cloud = result.background
        self._points = len(cloud.cells)
        return f"{MAP}/points", Cloud(cloud.points, cloud.colors, cloud.voxel_m / 2)


def mask_classes(ids: Int64) -> UInt16:
    """What stands for element ids in a mask image: 1 and up."""
    return np.asarray((ids - 1) % LARGEST_ID + 1, np.uint16)


def hits(elements: Elements, answer: Answer) -> Table:
    """An answer's elements, labelled by rank, with the reasons."""
    rows = np.searchsorted(elements.ids, answer.ids)
    labels = tuple(f"{rank + 1}. {elements.labels[r]} {answer.scores[rank]:.2f}" for rank, r in enumerate(rows))
    centers, half_sizes, quaternions = _shapes(elements.positions[rows], elements.extents[rows])
    shown = Ellipsoids(centers, 1.05 * half_sizes, quaternions, (HIT_COLOR,) * len(labels), labels)
    return Table({"element_id": answer.ids, "rank_score": answer.scores, "reason": tuple(answer.reasons)}, shown)


def hit_names(answer: Answer) -> LabelNames:
    """What the pixels of a query's mask are called."""
    return LabelNames(((0, "", CLEAR), (1, answer.text, HIT_COLOR)))


def slug(text: str) -> str:
    """A query's name in entity paths: its words, and a digest where they do not tell all."""
    plain = re.sub(r"[^a-z0-9]+", "_", text.lower()).strip("_")[:60]
    if plain.replace("_", " ") == text:
        return plain
    return f"{plain}_{hashlib.sha256(text.encode('utf-8', 'backslashreplace')).hexdigest()[:6]}".lstrip("_")


def element_columns(elements: Elements) -> dict[str, Column]:
    """Every field of the paper's tuple, as columns; the classes' probabilities where a calibration gave them."""
    columns: dict[str, Column] = {
        "element_id": elements.ids,
        "label": elements.labels,
        "position": elements.positions,
        "extent": elements.extents,
        "o": elements.o,
        "kappa": elements.kappa,
        "rho": elements.rho,
        "rho_source": elements.rho_sources,
        "motion_class": tuple(CLASS_NAMES[c] for c in elements.motion_class.tolist()),
        "confidence": elements.confidence,
        "p_stat": elements.p_stat,
        "score": elements.score,
        "speed": elements.speed,
        "observations": elements.observations,
    }
    if np.isnan(elements.p_moving).all():
        return columns
    static, movable_static, moving = class_posterior(elements.p_moving, elements.rho)
    return columns | {"p_moving": moving, "p_static": static, "p_movable_static": movable_static}


def id_color(i: int) -> tuple[int, int, int]:
    """A colour of its own for each id: hues a golden angle apart."""
    red, green, blue = colorsys.hsv_to_rgb(i * 0.618034 % 1.0, 0.65, 0.95)
    return round(255 * red), round(255 * green), round(255 * blue)


def _boxes(result: Tracked) -> Boxes:
    boxes, names = result.sightings.boxes, result.sightings.segments.names
    present = np.flatnonzero(boxes[:, 2] >= boxes[:, 0])
    corners = boxes[present] + np.array([-0.5, -0.5, 0.5, 0.5], np.float32)  # pixel centres are at integers
    return Boxes(corners.astype(np.float32), result.ids[present], tuple(names[k] for k in present))


def _features(result: WorldMap, index: int | None) -> Iterator[Named]:
    """Semantic features that this frame gave, so that the recording holds the whole map."""
    best = [result.evidence[i] for i in result.touched if result.evidence[i].feature_index == index]
    if best:
        vectors = np.stack([e.feature for e in best])
        yield f"{MAP}/features", Table({"element_id": np.array([e.id for e in best], np.int64), "feature": vectors})


def element_ellipsoids(columns: Mapping[str, Column]) -> Ellipsoids:
    """How a table of elements looks in space: coloured by class."""
    named = zip(columns["element_id"], columns["label"], strict=True)
    return Ellipsoids(
        *_shapes(np.asarray(columns["position"], np.float32), np.asarray(columns["extent"], np.float32)),
        colors=tuple(COLOR_OF[str(c)] for c in columns["motion_class"]),
        labels=tuple(f"{i} {name}".strip() for i, name in named),
        labelled=False,
    )


def _shapes(positions: Float32, extents: Float32) -> tuple[Float32, Float64, Float64]:
    """Centres, half axes and orientations (xyzw) of ellipsoids."""
    xx, xy, xz, yy, yz, zz = extents.astype(np.float64).T
    full = np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], axis=-1).reshape(-1, 3, 3)
    variances, axes = np.linalg.eigh(full)
    axes[np.linalg.det(axes) < 0, :, 0] *= -1
    return positions, SIGMAS * np.sqrt(np.maximum(variances, 1e-6)), _quaternions(axes)


def _quaternions(R: Float64) -> Float64:
    """(n, 4) xyzw of rotations (n, 3, 3)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(R).as_quat()) if len(R) else np.zeros((0, 4))
