"""Instances by a YOLO segmentation network, from an ONNX file: YOLOv8-seg, YOLO11-seg, YOLO26-seg exports.

onnxruntime runs it: half the time of OpenCV's own engine on a YOLOv8n-seg, the same bits with one thread or two, and
it alone gives the file's metadata, where the class names are. What comes out of the network is decoded here as
Ultralytics does it (Jocher et al., YOLOv8, 2023; prototype masks: Bolya et al., YOLACT, ICCV 2019).
"""

from __future__ import annotations

import ast
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from vlmm_log.settings import ObjectSettings
from vlmm_log.types import Float32, Float64, Frame, InputError, Int64, Segments, UInt8

DYNAMIC_SIDE = 640  # px, longer side where the network takes any size: what these networks are trained at
LARGEST_SIDE = 4096  # px of an input: what a file states is reserved
DYNAMIC_STEP = 32  # px, their coarsest stride
PADDING = 114  # grey of the letterbox, as in training
MOST = 300  # detections kept of a frame, as Ultralytics keeps
THREADS = 4  # more gain little on so small a network
KINDS = {"tensor(float)": np.float32, "tensor(float16)": np.float16}
OWN_SHARE = 0.5  # a detection that better ones cover by more is a second look at one of them, or has no pixel
HIDDEN = "yolo: detection that better ones cover left out"


@dataclass(frozen=True)
class Letterbox:
    """How an image lies in the network's input, px of the input."""

    scale: tuple[float, float]  # along x and y: input px of one image px
    offset: tuple[int, int]  # of the image's left and upper edge
    size: tuple[int, int]  # of the input, width and height


@dataclass(frozen=True, eq=False)
class Detections:
    """Boxes of the network's input, the best first."""

    boxes: Float32  # (m, 4) left, top, right, bottom, px of the input
    scores: Float32  # (m,)
    classes: Int64  # (m,)
    coefficients: Float32  # (m, P) of the mask prototypes


class Yolo:
    """A segmenter that holds the network."""

    def __init__(self, path: Path, s: ObjectSettings) -> None:
        """Opens the file and runs it once. Raises InputError where it is no segmenter or its classes have no names."""
        self._path, self._s = path, s
        self._session = open_session(path)
        self._input, metadata = _stated(self._session, path)
        if self._input.type not in KINDS or len(self._input.shape) != 4:
            raise _no_segmenter(path, f"its input is {self._input.type} {self._input.shape}")
        if not all(0 < n <= LARGEST_SIDE for n in self._input.shape[2:] if isinstance(n, int)):
            raise _no_segmenter(path, f"its input is of {self._input.shape} px")
        self.names = class_names(metadata, path, s)
        self._detect(np.zeros((480, 640, 3), np.uint8))

    def __call__(self, frame: Frame) -> Segments:
        """Masks at the image's size; of two on one pixel the better score has it. A mask left empty is left out."""
        found, prototypes, box = self._detect(frame.rgb)
        return segments(found, prototypes, box, self.names, frame.rgb.shape[:2])

    def _detect(self, rgb: UInt8) -> tuple[Detections, Float32, Letterbox]:
        image, box = letterboxed(rgb, self._input.shape[2:])
        blob = cv2.dnn.blobFromImage(image, 1 / 255).astype(KINDS[self._input.type], copy=False)
        try:
            outputs = self._session.run(None, {self._input.name: blob})
        except Exception as e:
            raise _no_segmenter(self._path, f"it does not run: {_first_line(e)}") from e
        try:
            found, prototypes = decoded(outputs, len(self.names), self._s)
        except ValueError as e:
            raise _no_segmenter(self._path, str(e)) from e
        return found, prototypes, box


def open_session(path: Path) -> Any:
    """The network on the CPU. Raises InputError where onnxruntime is missing or the file is no ONNX network."""
    try:
        import onnxruntime
    except ImportError as e:
        raise InputError("--segmenter yolo needs onnxruntime: pip install 'vlmm-log[yolo]'") from e
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = int(os.environ.get("OMP_NUM_THREADS") or min(THREADS, os.cpu_count() or 1))
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")  # waiting threads leave the core to us
    options.log_severity_level = 4  # what is wrong comes as an exception
    try:
        return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    except Exception as e:
        raise InputError(f"{path}: not an ONNX network ({_first_line(e)}); export the weights again") from e


@dataclass(frozen=True)
class _Input:
    """What a network takes."""

    name: str
    type: str  # a key of KINDS
    shape: tuple[object, ...]  # 1, 3, height, width; a text or None where any will do


def _stated(session: Any, path: Path) -> tuple[_Input, str]:
    """The first input, and the class names in the metadata: a file's texts need be none."""
    try:
        first = session.get_inputs()[0]
        names = str(session.get_modelmeta().custom_metadata_map.get("names", ""))
        return _Input(first.name, first.type, tuple(first.shape)), names
    except (UnicodeDecodeError, IndexError) as e:
        raise _no_segmenter(path, f"its input is not described: {_first_line(e)}") from e


def class_names(metadata: str, path: Path, s: ObjectSettings) -> tuple[str, ...]:
    """Names by class number: of the file that the settings name, else of the network's metadata.

    They are never guessed from the number of classes. Raises InputError where there are none.
    """
    if s.yolo_names:
        try:
            return tuple(line.strip() for line in Path(s.yolo_names).read_text("utf-8").splitlines() if line.strip())
        except (OSError, UnicodeDecodeError) as e:
            raise InputError(f"{s.yolo_names}: cannot read the class names: {e}") from e
    try:
        table = ast.literal_eval(metadata)
        numbered = table if isinstance(table, dict) else dict(enumerate(table))
        return tuple(str(numbered[k]) for k in range(len(numbered)))
    except (ValueError, SyntaxError, TypeError, KeyError, RecursionError, MemoryError) as e:
        raise InputError(
            f"{path}: no class names in its metadata; give a text file, one a line, as --set objects.yolo_names=FILE"
        ) from e


def letterboxed(rgb: UInt8, shape: Sequence[object]) -> tuple[UInt8, Letterbox]:
    """The image scaled into the network's (height, width) and padded evenly; a side that is no int is free."""
    H, W = rgb.shape[:2]
    longer = DYNAMIC_SIDE / max(H, W)
    chosen = (DYNAMIC_STEP * int(np.ceil(n * longer / DYNAMIC_STEP)) for n in (H, W))
    h, w = (given if isinstance(given, int) else own for given, own in zip(shape, chosen, strict=True))
    scale = min(h / H, w / W)
    inner_w, inner_h = max(1, round(W * scale)), max(1, round(H * scale))
    left, top = (w - inner_w) // 2, (h - inner_h) // 2
    padded = np.full((h, w, 3), PADDING, np.uint8)
    padded[top : top + inner_h, left : left + inner_w] = cv2.resize(rgb, (inner_w, inner_h))
    return padded, Letterbox((inner_w / W, inner_h / H), (left, top), (w, h))


def decoded(outputs: Sequence[Float32], classes: int, s: ObjectSettings) -> tuple[Detections, Float32]:
    """Detections and mask prototypes (P, h, w) from the network's two outputs.

    Dense layout (v8, 11): (1, 4 + classes + P, N), centre, size, a score for each class, coefficients; suppressed
    here. End-to-end layout (26): (1, N, 6 + P), corners, score, class, coefficients; suppressed by the network.
    Raises ValueError where the shapes are neither.
    """
    by_rank = {o.ndim: np.asarray(o[0], np.float32) for o in outputs if o.ndim in (3, 4) and o.shape[0] == 1}
    if len(outputs) != 2 or len(by_rank) != 2:
        raise ValueError(f"its outputs are {_shapes(outputs)}")
    rows, prototypes = by_rank[3], by_rank[4]
    P = prototypes.shape[0]
    if rows.shape[1] == 6 + P:
        found = _end_to_end(rows, s)
    elif rows.shape[0] == 4 + classes + P:
        found = _dense(rows.T, classes, s)
    else:
        raise ValueError(f"its outputs {_shapes(outputs)} do not fit {classes} class names")
    if not (np.isfinite(found.boxes).all() and np.isfinite(found.scores).all()):
        raise ValueError("it finds boxes that are no numbers")
    if found.classes.size and not 0 <= found.classes.min() <= found.classes.max() < classes:
        raise ValueError(f"it finds class {found.classes.max()}, and there are {classes} class names")
    return found, prototypes


def _end_to_end(rows: Float32, s: ObjectSettings) -> Detections:
    rows = rows[rows[:, 4] >= s.yolo_score]
    rows = rows[np.argsort(-rows[:, 4], kind="stable")]
    return Detections(rows[:, :4], rows[:, 4], np.rint(rows[:, 5]).astype(np.int64), rows[:, 6:])


def _dense(rows: Float32, classes: int, s: ObjectSettings) -> Detections:
    of_classes = rows[:, 4 : 4 + classes]
    above = of_classes.max(1) >= s.yolo_score
    rows, of_classes = rows[above], of_classes[above]
    best, scores = of_classes.argmax(1), of_classes.max(1)
    corners, sizes = rows[:, :2] - rows[:, 2:4] / 2, rows[:, 2:4]
    kept = np.zeros(0, np.intp)
    if len(rows):
        rectangles = np.hstack([corners, sizes]).astype(np.float64)
        found = cv2.dnn.NMSBoxesBatched(rectangles, scores, best.astype(np.int32), 0.0, s.yolo_iou)  # type: ignore[arg-type]
        kept = np.asarray(found, np.intp)[:MOST]
    boxes: Float32 = np.hstack([corners, corners + sizes])
    return Detections(boxes[kept], scores[kept], best[kept].astype(np.int64), rows[kept, 4 + classes :])


def segments(
    found: Detections, prototypes: Float32, box: Letterbox, names: Sequence[str], shape: tuple[int, ...]
) -> Segments:
    """Detections as instances of an image of ``shape`` (H, W): masks from the prototypes, cropped to their boxes."""
    labels = np.zeros(shape, np.int32)
    kept: list[int] = []
    corners = _on_image(found.boxes, box, shape)
    for i, (left, top, right, bottom) in enumerate(corners):
        window = labels[top:bottom, left:right]
        if not window.size:
            continue
        logits = np.tensordot(found.coefficients[i], prototypes, 1)
        mask = _resampled(logits, box, (left, top), window.shape) > 0
        free = mask & (window == 0)
        if np.count_nonzero(free) > OWN_SHARE * np.count_nonzero(mask):
            kept.append(i)
            window[free] = len(kept)
    n = len(kept)
    notes = (HIDDEN,) if n < len(corners) else ()
    chosen = tuple(names[k] for k in found.classes[kept])
    return Segments(labels, chosen, found.scores[kept], np.full(n, -1, np.int64), notes)


def _on_image(boxes: Float32, box: Letterbox, shape: tuple[int, ...]) -> list[list[int]]:
    """Left, top, right, bottom of the pixels whose centres the boxes hold, right and bottom beyond the last."""
    edges: Float64 = (boxes.astype(np.float64) - [*box.offset, *box.offset]) / [*box.scale, *box.scale]
    limits = [shape[1], shape[0], shape[1], shape[0]]
    return [[int(x) for x in row] for row in np.clip(np.ceil(edges - 0.5), 0, limits)]


def _resampled(logits: Float32, box: Letterbox, corner: tuple[int, int], shape: tuple[int, ...]) -> Float32:
    """Prototype cells brought to image pixels from ``corner`` on, linearly; both have their centres at integers."""
    cells = (logits.shape[1] / box.size[0], logits.shape[0] / box.size[1])  # of one input px
    steps = [s * c for s, c in zip(box.scale, cells, strict=True)]
    starts = [((at + 0.5) * s + o) * c - 0.5 for at, s, o, c in zip(corner, box.scale, box.offset, cells, strict=True)]
    to_cells = np.array([[steps[0], 0, starts[0]], [0, steps[1], starts[1]]])
    how = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    size = (shape[1], shape[0])
    return np.asarray(cv2.warpAffine(logits, to_cells, size, flags=how, borderMode=cv2.BORDER_REPLICATE), np.float32)


def _no_segmenter(path: Path, why: str) -> InputError:
    return InputError(f"{path}: no YOLO segmenter ({why}); give one that was exported with its masks, as yolo*-seg")


def _shapes(outputs: Sequence[Float32]) -> str:
    return ", ".join("x".join(str(n) for n in o.shape) for o in outputs)


def _first_line(e: Exception) -> str:
    return (str(e).splitlines() or [type(e).__name__])[0][:120]
