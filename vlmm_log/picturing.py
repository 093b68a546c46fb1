"""``render``: frames of a recording as a picture or a video, without a viewer."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from difflib import get_close_matches
from math import isfinite, isnan
from pathlib import Path

import cv2
import numpy as np

from vlmm_log.drawing.panels import DEFAULT, PANELS
from vlmm_log.drawing.pictures import picture
from vlmm_log.drawing.sheet import Sheet, drawn, laid_out
from vlmm_log.drawing.video import Video
from vlmm_log.entries import Value
from vlmm_log.outputs import claim, replacing
from vlmm_log.protocols import Progress
from vlmm_log.recording import Recording, is_recording, open_recording
from vlmm_log.recording.frames import PairFigures, by_frame, pairs
from vlmm_log.types import InputError, UInt8

STILLS, VIDEO = (".png", ".jpg"), ".mp4"
FASTEST = 240.0  # frames a second


@dataclass(frozen=True)
class Rendered:
    """What ``render`` leaves."""

    out: Path
    panels: tuple[str, ...]
    frames: int
    first: int  # index of the first frame
    last: int
    size: tuple[int, int]  # width and height px
    fps: float | None  # of a video
    told: tuple[str, ...]  # what is missing

    def report(self) -> dict[str, object]:
        """As plain values, for JSON."""
        return {
            "out": str(self.out),
            "panels": list(self.panels),
            "frames": self.frames,
            "first": self.first,
            "last": self.last,
            "width": self.size[0],
            "height": self.size[1],
            "fps": self.fps,
            "told": list(self.told),
        }


def render(
    recording: str | Path,
    out: str | Path,
    *,
    frame: int | None = None,
    panels: Sequence[str] = (),
    fps: float | None = None,
    start: float | None = None,
    stop: float | None = None,
    force: bool = False,
    progress: Progress | None = None,
) -> Rendered:
    """A frame of a recording (.rrd, .mcap) as a picture (.png, .jpg), or all of its pairs as a video (.mp4).

    ``panels`` are names of ``vlmm_log.drawing.panels.PANELS``; if none is given, colour, depth, flow, d_M, validity
    and elements. Those that the recording does not hold are left out and told. A video takes the pairs with
    ``start <= seconds since the first one < stop``, at ``fps`` or as fast as they were taken. Raises InputError where
    the recording cannot be read, does not hold the frame or any of the panels, or ``out`` cannot be written.
    """
    path, out = Path(recording), Path(out)
    claim([out], force=force, inputs=[path])
    _check(path, out, frame, panels, fps, start, stop)
    opened = open_recording(path)
    known = pairs(opened)
    if not known:
        raise InputError(f"{path}: the recording holds no pair")
    names, told = _held(opened, dict.fromkeys(panels or DEFAULT))
    frames = [_found(path, known, frame)] if frame is not None else _window(path, known, start, stop)
    sheets = _Sheets(opened, names, known)
    with replacing(out, force=force) as (partial,):
        if out.suffix == VIDEO:
            fps = _rate(known) if fps is None else fps
            size = _film(partial, sheets, frames, fps, progress)
        else:
            (pixels,) = sheets.of(frames)
            _, data = cv2.imencode(out.suffix, pixels)
            partial.write_bytes(data.tobytes())
            size, fps = (pixels.shape[1], pixels.shape[0]), None
    told = (*told, *sheets.told(), *_incomplete(opened))
    return Rendered(out, names, len(frames), frames[0], frames[-1], size, fps, told)


class _Sheets:
    """Frames as sheets, one after the other; counts what they lack."""

    def __init__(self, recording: Recording, names: Sequence[str], known: Mapping[int, PairFigures]) -> None:
        self._recording, self._known = recording, known
        self._panels = {name: PANELS[name] for name in names}
        self._empty = dict.fromkeys(names, 0)

    def of(self, frames: Sequence[int]) -> Iterator[UInt8]:
        """(H, W, 3) BGR of each."""
        entities = {entity for panel in self._panels.values() for entity in panel.entities}
        held = entities & self._recording.entities
        start_ns = next(iter(self._known.values())).stamp_ns
        sheet: Sheet | None = None
        for index, values in by_frame(self._recording, held, frames):
            sheet = sheet or laid_out(list(self._panels.values()), _aspect(values))
            caption = _caption(self._recording.run.source, index, self._known[index], start_ns)
            pixels, empty = drawn(sheet, values, caption)
            for name, panel in self._panels.items():
                self._empty[name] += panel in empty
            yield pixels

    def told(self) -> Iterator[str]:
        """Frames that a panel had nothing for."""
        for name, n in self._empty.items():
            if n:
                yield f"{name}: nothing at {n} of the frames"


def _film(
    partial: Path, sheets: _Sheets, frames: Sequence[int], fps: float, progress: Progress | None
) -> tuple[int, int]:
    """Write the video; its width and height."""
    named = partial.with_name(partial.name + VIDEO)  # OpenCV goes by the name
    stream = sheets.of(frames)
    first = next(stream)
    size = first.shape[1], first.shape[0]
    try:
        with closing(Video(named, size, fps)) as video:
            video.add(first)
            for done, pixels in enumerate(stream, 2):
                video.add(pixels)
                if progress is not None:
                    progress(done, len(frames))
            video.finish()
        named.replace(partial)
    finally:
        named.unlink(missing_ok=True)
    return size


def _caption(source: str, index: int, pair: PairFigures, start_ns: int) -> str:
    since = (pair.stamp_ns - start_ns) / 1e9
    scored = f"median d_M {pair.median_d_m:.2f}, {pair.flagged_share:.1%} flagged"
    figures = "no pixel scored" if isnan(pair.median_d_m) else scored
    inliers = "not refined" if isnan(pair.inlier_share) else f"refined on {pair.inlier_share:.0%} of the matches"
    ego = f"ego-motion {inliers}" + ("" if pair.ego_reliable else ", UNRELIABLE")
    return f"{source}   frame {index}   {since:.3f} s ({pair.stamp_ns / 1e9:.3f})   {figures}   {ego}"


def _aspect(values: Mapping[str, Value]) -> float:
    """Width over height of what is shown."""
    shown = (pixels for entity, value in values.items() if (pixels := picture(entity, value)) is not None)
    height, width = next((p.shape[:2] for p in shown), (3, 4))
    return float(width / height)


def _held(recording: Recording, names: Mapping[str, None]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The panels that the recording can show, and what is told of the others. Raises InputError if there is none."""
    there = [name for name, panel in PANELS.items() if panel.needs in recording.entities]
    lacking = [name for name in names if name not in there]
    told = f"{', '.join(lacking)}: not in this recording; it can show {', '.join(there) or 'nothing'}"
    if len(lacking) == len(names):
        raise InputError(f"{recording.path}: {told}")
    return tuple(name for name in names if name in there), (told,) if lacking else ()


def _found(path: Path, known: Mapping[int, PairFigures], frame: int) -> int:
    """The frame, if it is there. Raises InputError with its neighbours."""
    if frame in known:
        return frame
    indices = list(known)
    k = bisect_left(indices, frame)
    near = " and ".join(str(i) for i in indices[max(k - 1, 0) : k + 1])
    there = f"{len(indices)} pairs, of frames {indices[0]} to {indices[-1]}"
    raise InputError(f"{path}: holds no pair of frame {frame}; the nearest: {near} (it holds {there})")


def _window(path: Path, known: Mapping[int, PairFigures], start: float | None, stop: float | None) -> list[int]:
    stamps = [pair.stamp_ns for pair in known.values()]
    start_ns = -1 if start is None else round(start * 1e9)
    stop_ns = stamps[-1] - stamps[0] + 1 if stop is None else round(stop * 1e9)
    frames = [i for i, stamp in zip(known, stamps, strict=True) if start_ns <= stamp - stamps[0] < stop_ns]
    if not frames:
        last = (stamps[-1] - stamps[0]) / 1e9
        raise InputError(f"{path}: no pair lies in that window; they begin from 0 to {last:.3f} s")
    return frames


def _rate(known: Mapping[int, PairFigures]) -> float:
    """Frames a second at which the pairs were taken, as far as players go along."""
    gaps = np.diff([pair.stamp_ns for pair in known.values()])
    gaps = gaps[gaps > 0]
    return float(np.clip(1e9 / np.median(gaps), 1.0, 60.0).round(2)) if gaps.size else 1.0


def _incomplete(recording: Recording) -> Iterator[str]:
    if recording.end is None or not recording.end.complete:
        yield "incomplete: its run was interrupted or cut off"
    yield from recording.losses


def _check(
    path: Path,
    out: Path,
    frame: int | None,
    panels: Sequence[str],
    fps: float | None,
    start: float | None,
    stop: float | None,
) -> None:
    if not path.is_file() or not is_recording(path):
        raise InputError(f"{path}: not a recording; give a .rrd or .mcap")
    if frame is None and out.suffix != VIDEO:
        raise InputError(f"{out}: name a video, {out.stem}.mp4; or a frame for a picture")
    if frame is not None and out.suffix not in STILLS:
        raise InputError(f"{out}: name a picture, {out.stem}.png or {out.stem}.jpg")
    if frame is not None and not (fps is start is stop is None):
        raise InputError("fps, start and stop are of a video; a picture has its frame")
    for name in panels:
        if name not in PANELS:
            near = get_close_matches(name, PANELS, 1, 0.4)
            hint = f"did you mean {near[0]}? " if near else ""
            raise InputError(f"panel {name!r}: no such panel; {hint}there are {', '.join(PANELS)}")
    if fps is not None and not 0 < fps <= FASTEST:
        raise InputError(f"fps = {fps}: more than 0, at most {FASTEST:g}")
    if not all(x is None or isfinite(x) for x in (start, stop)):
        raise InputError("start and stop are seconds")
