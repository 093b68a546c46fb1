"""Speed of the segmenters, as ratios to one decoding of a frame's two images.

    python -m benchmarks.segmenters

The real slice; one thread, but two for a network where it says so; medians of one run. Networks by onnxruntime and by
OpenCV's own engine, on the same input.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy

import cv2
import numpy as np

from benchmarks.data import SLICE, WEIGHTS, frames, need
from benchmarks.rows import milliseconds
from vlmm_log.models.geometric import Geometric
from vlmm_log.models.masks import Masks
from vlmm_log.models.yolo import Yolo, decoded, letterboxed, segments
from vlmm_log.settings import ObjectSettings
from vlmm_log.types import Frame

S = ObjectSettings()


def decoding(frame: Frame) -> float:
    """Time to decode the frame's own files, ms."""
    files = [np.frombuffer(e.data, np.uint8) for e in (frame.encoded_rgb, frame.encoded_depth) if e is not None]
    return milliseconds(lambda: [cv2.imdecode(data, cv2.IMREAD_UNCHANGED) for data in files])


def of_masks(frame: Frame) -> float:
    """Time of the segmenter on a file with the geometric one's segments as identities, ms."""
    with tempfile.TemporaryDirectory() as folder:
        cv2.imwrite(f"{folder}/{frame.index}.png", (Geometric()(frame).labels * 1000).astype(np.uint16))
        masks = Masks(Path(folder))
        return milliseconds(lambda: masks(frame))


def of_networks(frame: Frame, weights: Path) -> list[tuple[str, float]]:
    """Times of the network alone by thread count and engine, and of what is done to its outputs, ms."""
    import onnxruntime

    image, box = letterboxed(frame.rgb, (480, 640))
    blob = cv2.dnn.blobFromImage(image, 1 / 255)
    rows = []
    for threads in (1, 2):
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        session = onnxruntime.InferenceSession(str(weights), options, providers=["CPUExecutionProvider"])
        outputs = session.run(None, {"images": blob})
        name = f"{threads} thread{'s' * (threads > 1)}"
        rows.append((f"  onnxruntime, {name}", milliseconds(lambda s=session: s.run(None, {"images": blob}))))
        cv2.setNumThreads(threads)
        network = cv2.dnn.readNetFromONNX(str(weights))
        last = network.getUnconnectedOutLayersNames()
        network.setInput(blob)
        rows.append((f"  OpenCV, {name}", milliseconds(lambda n=network, o=last: n.forward(o))))
    cv2.setNumThreads(1)
    names = tuple(str(k) for k in range(80))
    found, prototypes = decoded(outputs, 80, S)
    rows.append(("  decoding of its outputs", milliseconds(lambda: decoded(outputs, 80, S))))
    masks = milliseconds(lambda: segments(found, prototypes, box, names, frame.depth.shape))
    rows.append((f"  masks of {found.scores.size} detections", masks))
    return rows


def main() -> None:
    need(SLICE)
    cv2.setNumThreads(1)
    logged = frames(SLICE)
    frame = logged[15]
    geometric = Geometric()
    unit = decoding(frame)
    counts = [len(geometric(f)) for f in logged]
    rows = [
        ("decoding of both images", unit),
        (f"geometric, {len(geometric(frame))} segments", milliseconds(lambda: geometric(frame))),
        ("masks, 16-bit PNG", of_masks(frame)),
    ]
    weights = WEIGHTS / "yolov8n-seg.onnx"
    if weights.is_file():
        yolo = Yolo(weights, S)
        rows.append(("yolo, whole, default threads", milliseconds(lambda: yolo(frame))))
        rows += of_networks(frame, weights)
    else:
        print(f"yolo skipped: {weights} is not here; VLMM_LOG_WEIGHTS can name its folder", file=sys.stderr)
    print(f"real slice, row {frame.index}; geometric gives {min(counts)} to {max(counts)} segments a frame")
    for name, ms in rows:
        print(f"  {name:34s} {ms:8.2f} ms {ms / unit:7.2f} decodings")


if __name__ == "__main__":
    main()
