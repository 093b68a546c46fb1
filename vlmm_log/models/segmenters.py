"""The segmenter that the settings name."""

from __future__ import annotations

from importlib import metadata
from pathlib import Path

import numpy as np

from vlmm_log.models.weights import fingerprint
from vlmm_log.protocols import Segmenter
from vlmm_log.settings import ObjectSettings
from vlmm_log.types import Frame, InputError, Segments


def load_segmenter(s: ObjectSettings) -> tuple[Segmenter, dict[str, str]]:
    """The segmenter, and the versions and fingerprints of what decides its masks beside OpenCV and numpy.

    Raises InputError for an unknown name, and where its files or packages are missing or unusable.
    """
    kind, _, where = s.segmenter.partition(":")
    match kind, bool(where):
        case "geometric", False:
            from vlmm_log.models.geometric import Geometric

            return Geometric(), {}
        case "yolo", True:
            return _load_yolo(Path(where), s)
        case "masks", True:
            from vlmm_log.models.masks import Masks

            masks = Masks(Path(where))
            return masks, {"masks": masks.fingerprint}
        case "none", False:
            return no_segments, {}
    raise InputError(
        f"--segmenter {s.segmenter}: no such segmenter; there are geometric, yolo:FILE.onnx, masks:FOLDER, none"
    )


def no_segments(frame: Frame) -> Segments:
    """No instance in any frame."""
    empty = np.zeros(frame.depth.shape, np.int32)
    return Segments(empty, (), np.zeros(0, np.float32), np.zeros(0, np.int64))


def _load_yolo(path: Path, s: ObjectSettings) -> tuple[Segmenter, dict[str, str]]:
    from vlmm_log.models.yolo import Yolo

    if not path.is_file():
        raise InputError(f"{path}: no such ONNX file; give --segmenter yolo:FILE.onnx")
    versions = {"segmenter weights": fingerprint(path)}
    if s.yolo_names and Path(s.yolo_names).is_file():
        versions["segmenter names"] = fingerprint(Path(s.yolo_names))
    yolo = Yolo(path, s)
    return yolo, versions | {"onnxruntime": metadata.version("onnxruntime")}
