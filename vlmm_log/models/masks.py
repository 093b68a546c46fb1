"""Instance masks that somebody made: one PNG a frame, identities kept.

A folder holds

- PNG files of one channel, 8 or 16 bit, of the colour image's size: a pixel is the identity of its instance, 0 none.
  They are named by the frame's index (``000012.png``: the row of rgb.txt, from 0) or all by its time in seconds
  (``1305031237.029714.png``, as TUM folders name images). A frame's time is its depth image's, and the nearest mask
  within 20 ms is taken; names by index leave no doubt.
- ``labels.txt`` with rows ``id name``, or ``labels.csv`` with rows ``id,name``; ``#`` starts a comment.
"""

from __future__ import annotations

import csv
import hashlib
from decimal import Decimal
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from vlmm_log.image_files import decoded
from vlmm_log.types import Frame, InputError, Int32, Int64, Segments

MaskImage = NDArray[np.uint8] | NDArray[np.uint16]
IDS = 65536  # that 16 bits hold
TOLERANCE_NS = 20_000_000  # between a mask's time and its frame's: as far as colour and depth may lie apart
LATEST_NS = 2**62
NAMING = "name masks by frame index (000012.png) or all by seconds (1305031237.029714.png)"


class Masks:
    """The segmenter."""

    def __init__(self, folder: Path) -> None:
        """Reads the lists. Raises InputError where there is no folder, no mask in it, or a name or row is unusable."""
        files = sorted(folder.glob("*.png"))
        if not files:
            raise InputError(f"{folder}: {'no mask (*.png) in it' if folder.is_dir() else 'no such folder'}; {NAMING}")
        self._folder = folder
        self._by_index, self._stamps, self._files = _matched_by(files)
        self.names = read_labels(folder)

    @property
    def fingerprint(self) -> str:
        """Name of the folder and SHA-256 over names and contents of what is read of it."""
        digest = hashlib.sha256()
        for path in sorted([*self._folder.glob("*.png"), *_label_files(self._folder)]):
            digest.update(path.name.encode("utf-8", "backslashreplace") + b"\0")
            digest.update(hashlib.sha256(path.read_bytes()).digest())
        return f"{self._folder.name} sha256:{digest.hexdigest()}"

    def __call__(self, frame: Frame) -> Segments:
        """The frame's masks, by ascending identity. Without a readable file there is none, and a note says so.

        Raises InputError for a mask of another size, or of several channels.
        """
        path = self._path(frame)
        if path is None:
            return _nothing(frame, "masks: no file for this frame")
        image = _decoded(path)
        if image is None:
            return _nothing(frame, "masks: file cannot be decoded")
        _check(image, frame.depth.shape, path)
        labels, ids = numbered(image)
        names = tuple(self.names.get(int(k), "") for k in ids)
        notes = ("masks: identity without a row in the label table",) if "" in names else ()
        return Segments(labels, names, np.ones(ids.size, np.float32), ids, notes)

    def _path(self, frame: Frame) -> Path | None:
        if self._by_index:
            return self._by_index.get(frame.index)
        k = int(np.searchsorted(self._stamps, frame.stamp_ns))
        near = [i for i in (k - 1, k) if 0 <= i < len(self._files)]
        best = min(near, key=lambda i: abs(int(self._stamps[i]) - frame.stamp_ns))
        return self._files[best] if abs(int(self._stamps[best]) - frame.stamp_ns) <= TOLERANCE_NS else None


def numbered(image: MaskImage) -> tuple[Int32, Int64]:
    """Labels 1 to n (H, W) instead of identities, and the n identities ascending: two look-ups a pixel."""
    present = np.zeros(IDS, bool)
    present[image] = True
    present[0] = False
    table = np.where(present, np.cumsum(present), 0).astype(np.int32)
    return table[image], np.flatnonzero(present).astype(np.int64)


def read_labels(folder: Path) -> dict[int, str]:
    """Names by identity; empty where there is no table.

    Raises InputError for two tables, a row that is no identity and name, and an identity named twice.
    """
    tables = _label_files(folder)
    if len(tables) > 1:
        raise InputError(f"{folder}: both labels.csv and labels.txt; keep one")
    names: dict[int, str] = {}
    for path in tables:
        for number, cells in _rows(path):
            if len(cells) != 2 or not _is_number(cells[0]) or int(cells[0]) >= IDS:
                raise InputError(f"{path}:{number}: write an identity from 0 to {IDS - 1} and its name")
            if names.setdefault(int(cells[0]), cells[1]) != cells[1]:
                raise InputError(f"{path}:{number}: identity {cells[0]} has another name further up; keep one")
    return names


def _label_files(folder: Path) -> list[Path]:
    return [p for p in (folder / "labels.csv", folder / "labels.txt") if p.is_file()]


def _rows(path: Path) -> list[tuple[int, list[str]]]:
    """Line numbers and the cells of what is not empty, not a comment, not the heading ``id,name``."""
    try:
        lines = path.read_text("utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as e:
        raise InputError(f"{path}: cannot read the label table: {e}") from e
    split = csv.reader(lines, skipinitialspace=True) if path.suffix == ".csv" else (x.split(maxsplit=1) for x in lines)
    rows = [(number, [cell.strip() for cell in cells]) for number, cells in enumerate(split, 1)]
    return [(n, cells) for n, cells in rows if any(cells) and not cells[0].startswith("#") and cells[0] != "id"]


def _matched_by(files: list[Path]) -> tuple[dict[int, Path], Int64, list[Path]]:
    """Masks by index, or the stamps (ns, ascending) and masks by them; the other is empty."""
    if all(_is_number(p.stem) for p in files):
        by_index = {int(p.stem): p for p in files}
        if len(by_index) < len(files):
            raise InputError(f"{files[0].parent}: two masks of one index; keep one")
        return by_index, np.zeros(0, np.int64), []
    by_stamp = sorted((_stamp_ns(p), p) for p in files)
    return {}, np.array([t for t, _ in by_stamp], np.int64), [p for _, p in by_stamp]


def _is_number(text: str) -> bool:
    return text.isascii() and text.isdigit() and len(text) < 19


def _stamp_ns(path: Path) -> int:
    try:
        stamp = int((Decimal(path.stem) * 10**9).to_integral_value())
    except (ArithmeticError, ValueError) as e:
        raise InputError(f"{path}: neither an index nor a time; {NAMING}") from e
    if _is_number(path.stem) or abs(stamp) > LATEST_NS:
        raise InputError(f"{path}: an index among names that are none, or too late a time; {NAMING}")
    return stamp


def _decoded(path: Path) -> MaskImage | None:
    try:
        return decoded(path.read_bytes(), cv2.IMREAD_UNCHANGED)  # type: ignore[return-value]
    except OSError:
        return None


def _check(image: MaskImage, shape: tuple[int, ...], path: Path) -> None:
    if image.ndim != 2:
        raise InputError(
            f"{path}: a colour or palette image with {image.shape[2]} channels; write one channel, pixel = identity"
        )
    if image.dtype not in (np.uint8, np.uint16):
        raise InputError(f"{path}: pixels are {image.dtype}; write 8 or 16 bit")
    if image.shape != shape:
        raise InputError(
            f"{path}: mask is {image.shape[1]}x{image.shape[0]}, the log's images are {shape[1]}x{shape[0]}; "
            "scale the masks with nearest neighbour"
        )


def _nothing(frame: Frame, note: str) -> Segments:
    labels = np.zeros(frame.depth.shape, np.int32)
    return Segments(labels, (), np.zeros(0, np.float32), np.zeros(0, np.int64), (note,))
