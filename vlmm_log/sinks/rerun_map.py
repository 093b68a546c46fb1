"""What a Rerun recording shows of objects: masks, boxes, observations, the map and its history, query hits."""

from __future__ import annotations

import colorsys
import hashlib
import re
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr

from vlmm_log.elements import CLASS_COLORS, OBSERVATION, Element, Elements, MotionClass, Observations, Tracked, WorldMap
from vlmm_log.protocols import Moment
from vlmm_log.queries import Answer
from vlmm_log.sinks.blueprint import IMAGE
from vlmm_log.sinks.scalars import ScalarColumns
from vlmm_log.types import Float32, Float64, Int64, UInt8

HIT_COLOR = (240, 228, 66)
CLEAR = (0, 0, 0, 0)  # pixels of no instance
MAP = "world/map"
SIGMAS = 2.0  # half axis of an ellipsoid in standard deviations of the element's points
HISTORY = 3  # observations from which on an element has a history: what is seen in passing would crowd the recording
MORE = 1000  # voxels
GROWTH = 1.25  # the background cloud is logged again once it has grown by this factor: its whole cost stays linear
LARGEST_ID = 65535  # that a mask image holds; element ids beyond it come round again


STATE_COLORS = {  # fused class, and what an element does at present
    **{kind.name.lower(): color for kind, color in CLASS_COLORS.items()},
    "still": (90, 90, 90),
    "moves": CLASS_COLORS[MotionClass.MOVING],
    "unseen": (40, 40, 40),
}


class MapLog:
    """Writes objects and the map, and remembers what the recording shows already."""

    def __init__(self, rec: rr.RecordingStream) -> None:
        self._rec, self._scalars = rec, ScalarColumns(rec)
        self._tracked: Tracked | None = None
        self._world: WorldMap | None = None
        self._names: dict[int, str] = {}  # of the masks' classes
        self._states: dict[int, tuple[str, str]] = {}
        self._labels: dict[int, str] = {}  # that the lanes bear
        self._in_view: set[int] = set()  # elements of the last pair
        self._asked: set[str] = set()  # paths of queries
        self._priors: set[str] = set()  # what was told of labels
        self._points = 0

    def tracked(self, result: Tracked) -> None:
        """Masks, boxes and observations of a frame."""
        self._tracked = result
        self._masks(result)
        self._boxes(result)
        columns = _columns(result.sightings.rows)
        columns["element_id"] = result.ids
        columns["name"] = pa.array(result.sightings.segments.names, pa.utf8())
        columns["detection_score"] = result.sightings.segments.scores
        columns["observed"] = result.sightings.observed
        columns["similarity"] = result.similarity
        if len(result.ids):
            self._rec.log(f"{MAP}/observations", rr.AnyValues(**columns))
        else:
            self._rec.log(f"{MAP}/observations", rr.Clear(recursive=False))

    def world(self, result: WorldMap, at: Moment) -> None:
        """The elements, what changed of them, and the background once it has grown."""
        self._world = result
        elements = result.columns
        if len(elements):
            shown = _ellipsoids(elements, elements.motion_class, elements.labels)
            self._rec.log(f"{MAP}/elements", shown, rr.AnyValues(**element_columns(elements)))
        self._unseen(result)
        for i in result.touched:
            if i in result.elements:
                self._history(result.elements[i], at)
                self._prior(result.elements[i])
        self._features(result, at)
        if sum(len(cloud.cells) for cloud in result.clouds) > GROWTH * self._points + MORE:
            self._cloud(result)

    def answer(self, result: Answer) -> None:
        """An answer's elements in the map, and their pixels in the frame."""
        path = f"query/{slug(result.text)}"
        if self._world is None:
            return
        if path not in self._asked:
            self._asked.add(path)
            self._rec.log(
                f"{IMAGE}/{path}", rr.AnnotationContext([(0, "", CLEAR), (1, result.text, HIT_COLOR)]), static=True
            )
        elements = self._world.columns
        rows = np.searchsorted(elements.ids, result.ids)
        self._rec.log(f"{MAP}/{path}", hits(elements, rows, result), answer_columns(result))
        if self._tracked is not None:
            found = np.isin(self._tracked.ids, result.ids)
            lookup = np.concatenate([[0], found]).astype(np.uint8)
            self._rec.log(f"{IMAGE}/{path}", rr.SegmentationImage(lookup[self._tracked.sightings.segments.labels]))

    def flush(self) -> None:
        """Send what waits."""
        self._scalars.flush()

    def finish(self) -> None:
        """Send what waits, and the whole background."""
        self.flush()
        if self._world is not None and len(self._world.background.cells) > self._points:
            self._cloud(self._world)

    def _masks(self, result: Tracked) -> None:
        segments = result.sightings.segments
        classes = (result.ids - 1) % LARGEST_ID + 1
        lookup = np.concatenate([[0], classes]).astype(np.uint16)
        named = zip(classes, result.ids, segments.names, strict=True)  # the nameless keep the viewer's own colours
        names = {0: ""} | {int(c): f"{i} {name}" for c, i, name in named if name}
        self._rec.log(f"{IMAGE}/instances", rr.SegmentationImage(lookup[segments.labels]))
        if names.items() <= self._names.items():
            return
        self._names |= names
        context = [(c, name, id_color(c) if c else CLEAR) for c, name in sorted(self._names.items())]
        self._rec.log(f"{IMAGE}/instances", rr.AnnotationContext(context), static=True)

    def _boxes(self, result: Tracked) -> None:
        boxes, names = result.sightings.boxes, result.sightings.segments.names
        present = np.flatnonzero(boxes[:, 2] >= boxes[:, 0])
        corners = boxes[present] + np.array([-0.5, -0.5, 0.5, 0.5], np.float32)  # pixel centres are at integers
        labels = [f"{result.ids[k]} {names[k]}".strip() for k in present]
        colors = [id_color(int(result.ids[k])) for k in present]
        shown = rr.Boxes2D(array=corners, array_format=rr.Box2DFormat.XYXY, labels=labels, colors=colors)
        self._rec.log(f"{IMAGE}/boxes", shown)

    def _history(self, element: Element, at: Moment) -> None:
        """Fused class and present motion as two lanes of states; the observation's score and reliability."""
        seen = element.evidence.observations
        if seen.size < HISTORY:
            return
        path, latest = f"{MAP}/elements/{element.id}", seen[-1]
        moves = element.intervals.size > 0 and bool(element.intervals[-1, 1] >= latest["second_ns"])
        state = (element.motion_class.name.lower(), "moves" if moves else "still")
        if self._labels.get(element.id) != element.label:
            self._labels[element.id] = element.label
            self._rec.log(path, _state_looks(element.label), static=True)
        if self._states.get(element.id) != state:
            self._states[element.id] = state
            self._rec.log(path, rr.StateChange(state=list(state)))
        self._scalars.add(f"{path}/o", at, float(latest["o"]))
        self._scalars.add(f"{path}/kappa", at, float(latest["kappa"]))

    def _unseen(self, result: WorldMap) -> None:
        """A state of their own for elements that left the view."""
        for i in (self._in_view - set(result.touched)) & self._states.keys():
            self._states[i] = (self._states[i][0], "unseen")
            self._rec.log(f"{MAP}/elements/{i}", rr.StateChange(state=list(self._states[i])))
        self._in_view = {i for i in result.touched if i in result.elements}

    def _prior(self, element: Element) -> None:
        """Once a label: its movability and where that comes from, a fallback too."""
        told = f"movability of {element.label!r}: {element.rho:.2f}, {element.rho_source}"
        if told not in self._priors:
            self._priors.add(told)
            self._rec.log("log", rr.TextLog(told, level="INFO"))

    def _features(self, result: WorldMap, at: Moment) -> None:
        """Semantic features that this frame gave, so that the recording holds the whole map."""
        best = [result.evidence[i] for i in result.touched if result.evidence[i].feature_index == at.index]
        if best:
            vectors = np.stack([e.feature for e in best])
            ids = np.array([e.id for e in best], np.int64)
            self._rec.log(f"{MAP}/features", rr.AnyValues(element_id=ids, feature=_lists(vectors)))

    def _cloud(self, result: WorldMap) -> None:
        cloud = result.background
        self._points = len(cloud.cells)
        self._rec.log(f"{MAP}/points", rr.Points3D(cloud.points, colors=cloud.colors, radii=cloud.voxel_m / 2))


def _state_looks(label: str) -> rr.StateConfiguration:
    """Colours of the states; the class's lane tells what the element is, too."""
    told = [f"{label}: {name}" if label and name not in ("still", "moves", "unseen") else name for name in STATE_COLORS]
    return rr.StateConfiguration(values=list(STATE_COLORS), labels=told, colors=list(STATE_COLORS.values()))


def slug(text: str) -> str:
    """A query's name in entity paths: its words, and a digest where they do not tell all."""
    plain = re.sub(r"[^a-z0-9]+", "_", text.lower()).strip("_")[:60]
    if plain.replace("_", " ") == text:
        return plain
    return f"{plain}_{hashlib.sha256(text.encode('utf-8', 'backslashreplace')).hexdigest()[:6]}".lstrip("_")


def hits(elements: Elements, rows: Int64, answer: Answer) -> rr.Ellipsoids3D:
    """An answer's elements, labelled by rank."""
    labels = [f"{rank + 1}. {elements.labels[r]} {answer.scores[rank]:.2f}" for rank, r in enumerate(rows)]
    centers, half_sizes, quaternions = _shapes(elements.positions[rows], elements.extents[rows])
    return rr.Ellipsoids3D(
        centers=centers, half_sizes=1.05 * half_sizes, quaternions=quaternions, labels=labels, colors=HIT_COLOR
    )


def answer_columns(answer: Answer) -> rr.AnyValues:
    """Ids, ranks and reasons."""
    return rr.AnyValues(element_id=answer.ids, rank_score=answer.scores, reason=pa.array(answer.reasons, pa.utf8()))


def element_columns(elements: Elements) -> dict[str, Any]:
    """Every field of the paper's tuple, as columns."""
    return {
        "element_id": elements.ids,
        "label": pa.array(elements.labels, pa.utf8()),
        "position": _lists(elements.positions),
        "extent": _lists(elements.extents),
        "o": elements.o,
        "kappa": elements.kappa,
        "rho": elements.rho,
        "rho_source": pa.array(elements.rho_sources, pa.utf8()),
        "motion_class": pa.array([MotionClass(c).name.lower() for c in elements.motion_class], pa.utf8()),
        "confidence": elements.confidence,
        "p_stat": elements.p_stat,
        "score": elements.score,
        "speed": elements.speed,
        "observations": elements.observations,
    }


def id_color(i: int) -> tuple[int, int, int]:
    """A colour of its own for each id: hues a golden angle apart."""
    red, green, blue = colorsys.hsv_to_rgb(i * 0.618034 % 1.0, 0.65, 0.95)
    return round(255 * red), round(255 * green), round(255 * blue)


def _ellipsoids(elements: Elements, classes: UInt8, labels: tuple[str, ...]) -> rr.Ellipsoids3D:
    centers, half_sizes, quaternions = _shapes(elements.positions, elements.extents)
    return rr.Ellipsoids3D(
        centers=centers,
        half_sizes=half_sizes,
        quaternions=quaternions,
        colors=[CLASS_COLORS[MotionClass(c)] for c in classes],
        labels=[f"{i} {name}".strip() for i, name in zip(elements.ids, labels, strict=True)],
        show_labels=False,
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


def _columns(rows: Observations) -> dict[str, Any]:
    """A structured array's fields as columns that Rerun keeps; a field of several numbers as fixed-size lists."""
    return {
        name: _lists(rows[name]) if rows[name].ndim == 2 else np.ascontiguousarray(rows[name])
        for name in OBSERVATION.names or ()
    }


def _lists(values: Float32) -> pa.FixedSizeListArray:
    return pa.FixedSizeListArray.from_arrays(pa.array(np.ascontiguousarray(values).ravel()), values.shape[1])
