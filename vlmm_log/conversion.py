"""``convert``: a log in another container, the frames the same."""

from __future__ import annotations

import errno
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import metadata
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal, Protocol, cast, get_args

from vlmm_log.outputs import claim, replacing
from vlmm_log.protocols import Log, Progress
from vlmm_log.readers import opened, recognise
from vlmm_log.readers.assembly import parse_shift
from vlmm_log.readers.images import ImageError, decode_rgb
from vlmm_log.readers.stamps import limit_ns
from vlmm_log.readers.stored import Kind, Shot, StoredLog
from vlmm_log.ros.mcap import mcap_file
from vlmm_log.ros.messages import Ros
from vlmm_log.settings import Settings
from vlmm_log.types import InputError, Skipped
from vlmm_log.version import __version__
from vlmm_log.writers.chain import Chain, Pose, as_links, as_poses
from vlmm_log.writers.recorders import Recorder, ros1_bag, ros2_folder
from vlmm_log.writers.ros import Images, RosLog
from vlmm_log.writers.staging import claim_folder, replacing_folder
from vlmm_log.writers.timeline import timeline, window_of
from vlmm_log.writers.tum import TumFolder

Container = Literal["mcap", "bag", "ros2", "ros2-mcap", "tum"]
SUFFIXES: dict[str, Container] = {".mcap": "mcap", ".bag": "bag"}
LIBRARIES = ("mcap", "numpy", "opencv-python-headless", "rosbags")
CALLED: dict[Kind, str] = {"rgb": "colour", "depth": "depth"}
FIRST = 100  # colour images that are tried for their size


@dataclass(frozen=True)
class Converted:
    """What ``convert`` leaves."""

    out: Path
    to: Container
    counts: Mapping[str, int]  # messages of each topic, or rows of each list
    skipped: Counter[str]  # reason -> how many
    notes: tuple[str, ...]  # what was read, and how it is written where that is not told by its kind

    def report(self) -> dict[str, object]:
        """As plain values, for JSON."""
        return {
            "out": str(self.out),
            "to": self.to,
            "counts": dict(self.counts),
            "skipped": dict(sorted(self.skipped.items())),
            "notes": list(self.notes),
        }


class Writer(Protocol):
    """What events of a log are written by."""

    counts: Counter[str]

    @property
    def notes(self) -> list[str]:
        """What was changed."""
        ...

    def write(self, event: Shot | Pose) -> Skipped | None:
        """Write one; or why it cannot be."""
        ...


def convert(
    source: str | Path | Log,
    out: str | Path,
    *,
    settings: Settings | None = None,
    to: str = "",
    images: str = "raw",
    force: bool = False,
    progress: Progress | None = None,
) -> Converted:
    """Write a log in another container: stamps to the nanosecond, depth and poses without loss.

    ``source`` is a path, or a log that is open and can hand out its images as they are stored. ``to`` is "mcap"
    (ROS 2), "bag" (ROS 1), "ros2" (folder with .db3), "ros2-mcap" (folder with .mcap) or "tum"; "" by the suffix of
    ``out``, and for a folder "tum" from a bag, else "ros2". ``images`` of a bag are "raw" or
    "compressed" (PNG, JPEG, compressedDepth); a TUM folder keeps the files of the log, if it holds any. What the
    settings say of reading is done: window, intrinsics, conventions of poses, offsets. The output is written beside
    and renamed; an existing one is replaced only with ``force``. ``progress`` is told depth images done and expected.
    Raises InputError where source, settings or output cannot be used, and where no colour or no depth image could be
    written.
    """
    s = settings or Settings()
    out = Path(out)
    if images not in get_args(Images):
        raise InputError(f"images = {images!r}: there are {', '.join(get_args(Images))}")
    found, reader = opened(source, s.read)
    kind = _container(out, to, reader)
    inputs = [Path(source)] if isinstance(source, str | Path) else []
    _check_links(out)
    if kind in SUFFIXES.values():
        claim([out], force=force, inputs=inputs)
    else:
        claim_folder(out, inputs, force=force)
    _check_outside(out, inputs)
    if kind == "tum":
        _check_tum_name(out)
    log = _stored(found)
    chain = _chain(log, kind, s)
    about = _about(log.name, reader, s)
    skipped: Counter[str] = Counter()
    with _writer(log, chain, kind, cast(Images, images), out, s, about) as writer:
        _write_all(log, chain, writer, skipped, s, progress)
        _check_written(log.name, writer.counts, skipped)
    notes = (*log.notes, *(chain.notes if chain else ()), *writer.notes)
    return Converted(out, kind, dict(sorted(writer.counts.items())), skipped, notes)


def _container(out: Path, to: str, reader: str) -> Container:
    """What is to be written. Raises InputError where the name does not go with it."""
    suffix = out.suffix.lower()
    if to not in ("", *get_args(Container)):
        raise InputError(f"to = {to!r}: there are {', '.join(get_args(Container))}")
    by_name = SUFFIXES.get(suffix)
    if suffix == ".db3":
        inside = out.with_suffix("")
        raise InputError(f"{out}: ROS 2 keeps a .db3 in a folder; name {inside}/ and find {inside / inside.name}.db3")
    if not to:
        return by_name or ("tum" if reader == "bag" else "ros2")
    if by_name != (to if to in SUFFIXES.values() else None):
        wanted = next((s for s, kind in SUFFIXES.items() if kind == to), None)
        raise InputError(f"{out}: {to!r} is written to {f'a file NAME{wanted}' if wanted else 'a folder'}; name it so")
    return cast(Container, to)


def _check_links(out: Path) -> None:
    try:
        out.stat()
    except OSError as e:
        if e.errno == errno.ELOOP:  # resolve() no longer tells from Python 3.13 on
            raise InputError(f"{out}: cannot be written: a loop of links; name another place") from e


def _check_outside(out: Path, inputs: list[Path]) -> None:
    """Refuse to change what an input folder holds: a .mcap among images makes it a bag."""
    if any(source.is_dir() and source.resolve() in out.resolve().parents for source in inputs):
        raise InputError(f"{out}: lies within the input; name a place outside of it")


def _check_tum_name(out: Path) -> None:
    """Refuse a name that makes other readers take the folder, which then read its poses in their own way."""
    full = out.resolve()
    with TemporaryDirectory(prefix="vlmm-log-") as room:
        probe = Path(room) / full.parent.name / full.name
        probe.mkdir(parents=True)
        for name in ("rgb.txt", "depth.txt"):
            (probe / name).touch()
        reader = recognise(probe).name
    if reader != "tum":
        raise InputError(f"{out}: of this name it would be read as a folder of {reader!r}; name it otherwise")


def _stored(log: Log) -> StoredLog:
    if not hasattr(log, "shots"):
        raise InputError(f"{log.name}: its reader hands out no stored images; it cannot be converted without `shots`")
    return cast(StoredLog, log)


def _chain(log: StoredLog, kind: Container, s: Settings) -> Chain | None:
    if log.poses is None:
        return None
    return (as_poses if kind == "tum" else as_links)(log.poses, limit_ns(s.read.pose_gap_s))


def _about(source: str, reader: str, s: Settings) -> dict[str, str]:
    """Where an output comes from. Nothing else decides its bytes."""
    versions = {name: metadata.version(name) for name in LIBRARIES}
    return {"source": source, "reader": reader, "vlmm-log": __version__, **versions, "settings": s.to_toml()}


@contextmanager
def _writer(
    log: StoredLog,
    chain: Chain | None,
    kind: Container,
    images: Images,
    out: Path,
    s: Settings,
    about: Mapping[str, str],
) -> Iterator[Writer]:
    """The writer of an output, which takes its place once the block is done."""
    shift = parse_shift(s.read.depth_shift_px)

    def ros(recorder: Recorder, generation: Ros) -> RosLog:
        cameras = (log.camera, log.depth_camera)
        return RosLog(generation, recorder, images, *cameras, log.units_per_meter, shift, chain)

    match kind:
        case "mcap":
            with replacing(out, force=True) as (partial,):  # claimed before
                compression: Literal["LZ4", "NONE"] = "LZ4" if images == "raw" else "NONE"
                generation = Ros(2)
                with mcap_file(partial, generation, compression, about) as mcap:
                    yield ros(mcap, generation)
        case "bag":
            with replacing(out, force=True) as (partial,), ros1_bag(partial, Ros(1)) as bag:
                yield ros(bag, bag.ros)
        case "ros2" | "ros2-mcap":
            storage: Literal["sqlite3", "mcap"] = "sqlite3" if kind == "ros2" else "mcap"
            with replacing_folder(out) as staged, ros2_folder(staged, Ros(2), storage, about) as bag:
                yield ros(bag, bag.ros)
        case "tum":
            with replacing_folder(out) as staged:
                size = None if log.depth_camera is None else _rgb_size(log)
                units = log.units_per_meter
                folder = TumFolder(staged, log.camera, log.depth_camera, size, units, shift, s.read, chain)
                yield folder
                folder.finish()


def _write_all(
    log: StoredLog,
    chain: Chain | None,
    writer: Writer,
    skipped: Counter[str],
    s: Settings,
    progress: Progress | None,
) -> None:
    expected = log.count(limit_ns(s.read.start_s), limit_ns(s.read.stop_s))
    done = 0
    for event in timeline(log, chain, window_of(s.read)):
        lost = event if isinstance(event, Skipped) else writer.write(event)
        if lost is not None:
            skipped[lost.reason] += 1
        if isinstance(event, Shot) and event.kind == "depth" and progress is not None:
            done += 1
            progress(done, max(done, expected))


def _rgb_size(log: StoredLog) -> tuple[int, int]:
    """(H, W) of the colour images: as the camera says, else of the first one that can be read."""
    if log.camera.height:
        return log.camera.height, log.camera.width
    window = window_of(Settings().read)
    shots = (x for x in log.shots(window.start_ns, window.stop_ns) if isinstance(x, Shot) and x.kind == "rgb")
    for shot in islice(shots, FIRST):
        try:
            pixels = decode_rgb(shot.load())
        except ImageError:
            continue
        return pixels.shape[0], pixels.shape[1]
    raise InputError(f"{log.name}: none of the first {FIRST} colour images can be read, so their size is not known")


def _check_written(name: str, counts: Counter[str], skipped: Counter[str]) -> None:
    """Refuse to leave an output that no frame could be read from."""
    images = [stream for stream in counts if "image" in stream or stream in ("rgb.txt", "depth.txt")]
    missing = [called for kind, called in CALLED.items() if not any(kind in stream for stream in images)]
    if missing:
        what = f"{missing[0]} image" if images else "image"
        raise InputError(f"{name}: no {what} could be written{_why(skipped)}")


def _why(skipped: Counter[str]) -> str:
    return ": " + "; ".join(f"{reason} ({n}x)" for reason, n in skipped.most_common(3)) if skipped else ""
