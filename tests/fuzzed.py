"""What is fuzzed: small valid inputs of every format, how each is broken, and what reads it.

A reader gives how many losses were told; it may refuse with InputError (or ImageError: that is counted where it is
raised), and do nothing else: not crash, not write outside of its folder, not connect, not start a program.
"""

import io
import json
import sys
import tempfile
import warnings
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from itertools import islice
from pathlib import Path

import cv2
import numpy as np

from bags import ORIGIN_NS, STEP_NS, Messages, store, write
from mutations import broken_bytes, broken_json, broken_png, broken_text
from tum_folder import png, rows, write_tum_folder
from vlmm_log import rvl
from vlmm_log.calibration import FORMAT, VERSION, deciding, load_calibration
from vlmm_log.readers import compressed_depth, open_log
from vlmm_log.readers.images import ImageError, decode_depth, decode_rgb
from vlmm_log.readers.stored import StoredImage
from vlmm_log.recording.rrd_damage import ARROW, places
from vlmm_log.settings import ReadSettings, Settings
from vlmm_log.types import Frame, InputError, Skipped

Broken = Callable[[bytes, np.random.Generator], bytes]
MOST_SKIPPED = 10_000


@dataclass(frozen=True)
class Format:
    """Files of a valid input, which of them are broken and how, and what reads the whole."""

    name: str
    files: Callable[[Path], None]  # writes them into an empty folder
    broken: tuple[tuple[str, Broken], ...]  # pattern of names, and how
    read: Callable[[Path], int]  # of the folder; how many losses it told
    renamed: bool = False  # whether names of files are broken too
    examples: int = 120  # that the test takes: those that read slowly fewer


def apply(form, whole, folder, rng):
    """The files of ``whole`` (name -> bytes) in a folder, one of them broken; says which."""
    choices = [(name, how) for pattern, how in form.broken for name in sorted(whole) if Path(name).match(pattern)]
    name, how = choices[int(rng.integers(0, len(choices)))]
    files = {**whole, name: how(whole[name], rng)}
    if form.renamed and rng.random() < 0.3:
        old = sorted(whole)[int(rng.integers(0, len(whole)))]
        new = str(Path(old).with_name(_name(Path(old), rng)))
        files[new] = files.pop(old)
    for path, data in files.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_bytes(data)
    return name


def _name(path, rng):
    stem = str(rng.choice(["0" + "9" * 28, "9" * 28, "1" * 14, "-1", "1.5", "nan", "x", "a_7", "0" * 40, "٣", " 3"]))
    return stem + path.suffix


def contents(folder):
    """Name -> bytes of all files below a folder."""
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


# ---- what may not happen beside an exception

FORBIDDEN = ("socket.connect", "socket.getaddrinfo", "subprocess.Popen", "os.system", "os.exec", "pickle.find_class")


class _Watch:
    """The audit hook of this process: hooks stay for ever, so there is one, and it sleeps."""

    inside: Path | None = None
    seen: list[str]

    def __call__(self, event, args):
        if self.inside is None:
            return
        if event in FORBIDDEN:
            self.seen.append(f"{event} {args!r:.200}")
        elif event == "open" and isinstance(args[0], str | Path) and _writes(args[1], args[2]):
            path = Path(args[0]).absolute()
            if not any(path.is_relative_to(room) for room in (self.inside, "/dev")) and not _scratch(path):
                self.seen.append(f"open to write {path}")


def _scratch(path):
    """Whether it is a temporary file, of no name or of one that we gave it."""
    return path == Path(tempfile.gettempdir()) or any(part.startswith("vlmm-log-") for part in path.parts)


def _writes(mode, flags):
    return any(c in mode for c in "wax+") if mode else bool((flags or 0) & 3)


WATCH = _Watch()


@contextmanager
def limited(extra_bytes):
    """MemoryError for who asks for more than so much beyond what this process has; Linux only."""
    about = Path("/proc/self/statm")
    if not about.exists():
        yield
        return
    import resource

    used = int(about.read_text().split()[0]) * resource.getpagesize()
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (used + extra_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


@contextmanager
def watched(folder):
    """Raises AssertionError where something is written outside of a folder, asked of a network or started."""
    if not hasattr(WATCH, "seen"):
        sys.addaudithook(WATCH)
    WATCH.inside, WATCH.seen = folder.absolute(), []
    try:
        with warnings.catch_warnings(action="ignore"):  # of arithmetic with what no camera has
            yield
    finally:
        WATCH.inside = None
    assert not WATCH.seen, WATCH.seen


# ---- logs


def read_log(folder, name="", **options):
    """All frames, and the log as other commands look at it."""
    log = open_log(folder / name, ReadSettings(**options))
    skipped = 0
    for item in islice(log.frames(0, 10**18), MOST_SKIPPED):
        skipped += isinstance(item, Skipped)
    assert log.notes, log.name
    assert [s.rate_hz for s in log.streams], log.posed
    return skipped


read_folder = partial(read_log, name="log")


def converted(folder, name, to):
    """A log written anew: what the lists and topics of the source are called decides nothing about where."""
    from vlmm_log.conversion import convert

    return sum(convert(folder / name, folder / f"out{to}", to="" if to else "tum", force=True).skipped.values())


def _tum(folder):
    poses = rows(
        [1_305_031_237_000_000_000 + k * 50_000_000 for k in range(8)], [f"0.{k} 0 1 0 0 0 1" for k in range(8)]
    )
    write_tum_folder(folder / "log", groundtruth=poses, camera="fx 60\nfy 60\ncx 31.5\ncy 23.5\nk1 0.01\nwidth 64\n")


def _images(folder, names, colour="rgb", depth="depth"):
    image = cv2.GaussianBlur(np.random.default_rng(1).integers(0, 256, (36, 40, 3), np.uint8), (0, 0), 1)
    for name in names:
        for kind, pixels in ((colour, image), (depth, np.full((36, 40), 2000, np.uint16))):
            path = folder / name.format(kind=kind)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(png(pixels))


CAMERA = "fx 60\nfy 60\ncx 20\ncy 18\n"


def _plain(folder, lists):
    log = folder / "log"
    _images(log, [f"{{kind}}/{k:06d}.png" for k in range(3)])
    for name, text in {"camera.txt": CAMERA, **lists}.items():
        (log / name).parent.mkdir(exist_ok=True)
        (log / name).write_text(text)


KITTI = "".join(f"1 0 0 {k} 0 1 0 0 0 0 1 0\n" for k in range(3))
TIMES = "0.1\n0.2\n0.3\n"
SQUARE = "1 0 0 0\n0 1 0 0\n0 0 1 0.5\n0 0 0 1\n"
LISTED = "".join(f"0.{k + 1} rgb/{k:06d}.png 0.{k + 1} depth/{k:06d}.png\n" for k in range(3))
TRUTH = {"frame": 0, "identity": 1, "id": "Apple|1", "type": "Apple", "position": [0, 1, 2], "rotation": [0, 0, 0, 1]}
TRUTH |= {"moveable": True, "pickupable": True, "openable": False, "openness": 0.0, "visible": True}
INFO_TXT = "m_colorWidth = 40\nm_colorHeight = 36\nm_depthShift = 1000\n"
INFO_TXT += "m_calibrationColorIntrinsic = 60 0 20 0 0 60 18 0 0 0 1 0 0 0 0 1\n"


def _seven_scenes(folder):
    log = folder / "log"
    _images(log, [f"frame-{k:06d}.{{kind}}.png" for k in range(3)], "color")
    for k in range(3):
        (log / f"frame-{k:06d}.pose.txt").write_text(SQUARE)
    (log / "_info.txt").write_text(INFO_TXT)


TEXTS = (("*.txt", broken_text),)
PNGS = (("*.png", broken_png), ("*.png", broken_bytes))
FOLDERS = (
    Format("TUM folder", _tum, TEXTS, read_folder),
    Format("TUM folder, images", _tum, PNGS, read_folder),
    Format("TUM folder to bag", _tum, TEXTS, partial(converted, name="log", to=".bag"), examples=60),
    Format(
        "KITTI poses",
        partial(_plain, lists={"poses.txt": KITTI, "times.txt": TIMES}),
        TEXTS,
        read_folder,
        True,
    ),
    Format("4x4 poses", partial(_plain, lists={"traj.txt": SQUARE * 3}), TEXTS, read_folder, True),
    Format(
        "pose a file",
        partial(_plain, lists={f"pose/{k:06d}.txt": SQUARE for k in range(3)}),
        TEXTS,
        read_folder,
        True,
    ),
    Format("associations", partial(_plain, lists={"associations.txt": LISTED}), TEXTS, read_folder, True),
    Format("7-Scenes", _seven_scenes, TEXTS, read_folder, True),
    Format(
        "AI2-THOR truth",
        partial(_plain, lists={"truth/objects.jsonl": f"{json.dumps(TRUTH)}\n" * 3}),
        (("*.jsonl", broken_json),),
        read_folder,
    ),
)


# ---- bags


def _records(kind, count=3):
    """Colour, depth, camera and transforms."""
    m, frame = Messages(kind), "optical"
    colour = np.random.default_rng(1).integers(0, 256, (32, 34, 3), np.uint8)
    depth = np.full((32, 34), 1500, np.uint16)
    depth[5:9] = 0
    for k in range(count):
        t = ORIGIN_NS + k * STEP_NS
        yield "/tf", t, m.tf(t, ("world", frame, [0.1 * k, 0, 0, 0, 0, 0, 1]))
        yield "/camera/rgb/camera_info", t, m.camera_info(t, frame, size=(34, 32))
        yield "/camera/rgb/image_raw", t, m.image(t, frame, colour, "rgb8")
        data = compressed_depth.encode(depth, "rvl" if k else "png")
        form = f"16UC1; compressedDepth {'rvl' if k else 'png'}"
        yield "/camera/depth_registered/image_raw/compressedDepth", t, m.compressed(t, frame, data, form)


def _bag(folder, kind, suffix):
    write(folder / f"log{suffix}", kind, _records(kind))


def _open_mcap(folder, compression):
    """Without checksums, so that what is broken is read."""
    from mcap.writer import CompressionType, Writer

    types = store("mcap")
    with (folder / "log.mcap").open("wb") as f:
        writer = Writer(f, chunk_size=9000, compression=CompressionType[compression], enable_crcs=False)
        writer.start(profile="ros2", library="test")
        known = {}
        for topic, t, message in _records("mcap"):
            if topic not in known:
                name = message.__msgtype__
                schema = writer.register_schema(name, "ros2msg", types.generate_msgdef(name, ros_version=2)[0].encode())
                known[topic] = writer.register_channel(topic, "cdr", schema)
            writer.add_message(known[topic], t, bytes(types.serialize_cdr(message, message.__msgtype__)), t)
        writer.finish()


def _json_mcap(folder):
    """Foxglove's schemas in JSON."""
    import base64

    from mcap.writer import CompressionType, Writer

    def text(data):
        return base64.b64encode(data).decode()

    pixels = np.random.default_rng(1).integers(0, 256, (32, 34, 3), np.uint8)
    depth = np.full((32, 34), 1500, np.uint16)
    shape = {"type": "object", "properties": {"data": {"type": "string", "contentEncoding": "base64"}}}
    with (folder / "log.mcap").open("wb") as f:
        writer = Writer(f, compression=CompressionType.NONE, enable_crcs=False)
        writer.start(profile="", library="test")
        known = {}
        for k in range(3):
            t = ORIGIN_NS + k * STEP_NS
            head = {"timestamp": {"sec": t // 10**9, "nsec": t % 10**9}, "frame_id": "optical"}
            raw = {"height": 32, "width": 34}
            K = [60, 0, 17, 0, 60, 16, 0, 0, 1]
            yielded = {
                "/rgb": (
                    "foxglove.RawImage",
                    {**head, **raw, "encoding": "rgb8", "step": 102, "data": text(pixels.tobytes())},
                ),
                "/depth": (
                    "foxglove.RawImage",
                    {**head, **raw, "encoding": "16UC1", "step": 68, "data": text(depth.tobytes())},
                ),
                "/info": (
                    "foxglove.CameraCalibration",
                    {**head, **raw, "distortion_model": "", "D": [], "K": K, "R": [], "P": []},
                ),
            }
            for topic, (name, message) in yielded.items():
                if topic not in known:
                    schema = writer.register_schema(name, "jsonschema", json.dumps(shape).encode())
                    known[topic] = writer.register_channel(topic, "json", schema)
                writer.add_message(known[topic], t, json.dumps(message).encode(), t)
        writer.finish()


def read_bag(folder):
    """The log of the one bag in a folder."""
    (path,) = [p for p in folder.iterdir() if p.name.startswith("log")]
    return read_log(folder, path.name)


BYTES = (("*", broken_bytes),)
BAGS = (
    Format("ROS 1 bag", partial(_bag, kind="bag", suffix=".bag"), BYTES, read_bag),
    Format(
        "ROS 2 folder",
        partial(_bag, kind="ros2", suffix="_ros2"),
        (("*.db3", broken_bytes), ("*.yaml", broken_text)),
        read_bag,
    ),
    Format("MCAP", partial(_bag, kind="mcap", suffix=".mcap"), BYTES, read_bag),
    Format("MCAP, no checksums", partial(_open_mcap, compression="NONE"), BYTES, read_bag),
    Format("MCAP, zstd", partial(_open_mcap, compression="ZSTD"), BYTES, read_bag),
    Format("MCAP, lz4", partial(_open_mcap, compression="LZ4"), BYTES, read_bag),
    Format("MCAP, JSON", _json_mcap, BYTES, read_bag),
    Format(
        "bag to TUM folder", partial(_bag, kind="bag", suffix=".bag"), BYTES, partial(converted, name="log.bag", to="")
    ),
)


# ---- images


def _payloads(folder):
    rng = np.random.default_rng(5)
    depth = rng.integers(0, 9000, (34, 46)).astype(np.uint16)
    colour = rng.integers(0, 256, (34, 46, 3)).astype(np.uint8)
    for name, image in (
        ("a.png", depth),
        ("b.png", colour),
        ("c.jpg", colour),
        ("d.webp", colour),
        ("e.tiff", depth),
        ("f.pgm", depth),
    ):
        (folder / name).write_bytes(cv2.imencode(Path(name).suffix, image)[1].tobytes())
    for form in ("png", "rvl"):
        (folder / f"16UC1.{form}c").write_bytes(compressed_depth.encode(depth, form))
    (folder / "steps.rvl").write_bytes(rvl.encode_steps(depth.astype(np.float32), 0.5))


def read_payload(folder):
    """A payload as colour and as depth; those that cannot be used are the losses."""
    lost = 0
    for path in folder.iterdir():
        encodings = [f"{kind}; compressedDepth {path.suffix[1:-1]}" for kind in ("16UC1", "32FC1")]
        for encoding in encodings if path.suffix.endswith("c") else [""]:
            image = StoredImage(path.read_bytes(), encoding)
            for decode in (decode_rgb, lambda i: decode_depth(i, 1000, 0.1, 10)):
                try:
                    decode(image)
                except ImageError:
                    lost += 1
        if path.suffix == ".rvl":
            try:
                rvl.decode_steps(path.read_bytes(), 0.5)
            except ValueError:
                lost += 1
    return lost


IMAGES = Format("image payloads", _payloads, (("*.png", broken_png), ("*", broken_bytes)), read_payload)


# ---- what settings name


def _masks(folder):
    (folder / "masks").mkdir()
    for k in range(2):
        (folder / f"masks/{k:06d}.png").write_bytes(png(np.full((36, 40), 3 + k, np.uint8)))
    (folder / "masks/labels.txt").write_text("3 cup\n4 door frame\n# done\n")


def read_masks(folder):
    """Instances of two frames."""
    from vlmm_log.models.masks import Masks

    masks = Masks(folder / "masks")
    assert masks.fingerprint
    depth = np.ones((36, 40), np.float32)
    frames = [Frame(0, k, np.zeros((36, 40, 3), np.uint8), depth, np.eye(3), None) for k in range(2)]
    return sum(bool(masks(frame).notes) for frame in frames)


def _calibration(folder):
    curve = {"x": [0.0, 1.0, 5.0], "p": [0.0, 0.2, 1.0]}
    told = {"format": FORMAT, "version": VERSION, "pixel": curve, "element": curve, "settings": deciding(Settings())}
    told |= {"fitted_on": ["a"], "static_d_m2": 2.4, "sigma_z": [0.001, 0.002]}
    (folder / "calibration.json").write_text(json.dumps(told))


def read_calibration(folder):
    """The curves as a run takes them."""
    from vlmm_log.models.curves import load_curves, origin

    assert load_calibration(folder / "calibration.json")
    s = Settings.load(sets=[f'calibration.file="{folder / "calibration.json"}"'])
    found, _ = load_curves(s)
    assert origin(found)
    found.pixel(np.array([0.0, 2, np.nan], np.float32))
    return 0


def _batch(folder):
    task = {
        "source": "/logs/a",
        "folder": "a-0123456789ab",
        "state": "done",
        "error": None,
        "seconds": 1.5,
        "pairs": 3,
        "hash": "f" * 64,
    }
    told = {
        "format": "vlmm-log batch",
        "version": 1,
        "tasks": [task, task | {"state": "failed", "error": "x", "pairs": None}],
    }
    (folder / "manifest.json").write_text(json.dumps(told))
    whole = {"format": "vlmm-log figures", "version": 1, "hash": "f" * 64, "files": {"manifest.json": 5}, "row": {}}
    (folder / "figures.json").write_text(json.dumps(whole))


def read_batch(folder):
    """The manifest and figures of a batch: no folder that it names lies elsewhere."""
    from vlmm_log.batches.folders import figures
    from vlmm_log.batches.manifest import read_manifest

    figures(folder, "f" * 64)
    for outcome in read_manifest(folder):
        assert (folder / outcome.folder).resolve().is_relative_to(folder.resolve())
    return 0


def _scene(folder):
    truth = folder / "truth"
    truth.mkdir()
    (truth / "truth.json").write_text(json.dumps({"scene": "a", "seed": 1, "depth_units_per_meter": 5000.0}))
    (truth / "objects.csv").write_text("id,name,movability,kind\n1,cup,0.9,slide\n")
    poses = "frame,part,x,y,z,qx,qy,qz,qw\n" + "".join(f"{k},1,0,0,{k},0,0,0,1\n" for k in range(2))
    (truth / "part_poses.csv").write_text(poses)
    (truth / "poses.txt").write_text("0.0 0 0 0 0 0 0 1\n0.1 0 0 0 0 0 0 1\n")
    for kind in ("depth", "parts", "instances"):
        (truth / kind).mkdir()
        for k in range(2):
            (truth / kind / f"{k:06d}.png").write_bytes(png(np.full((36, 40), 1, np.uint16)))


def read_scene(folder):
    """The truth of a pair."""
    from vlmm_log.evaluation.truth import SimulatedTruth
    from vlmm_log.types import FramePair

    truth = SimulatedTruth(folder / "truth")
    K = np.array([[60.0, 0, 20], [0, 60, 18], [0, 0, 1]])
    depth = np.ones((36, 40), np.float32)
    first, second = (Frame(k, k, np.zeros((36, 40, 3), np.uint8), depth, K, np.eye(4)) for k in range(2))
    return int(truth.of(FramePair(first, second)) is None)


def _network(folder):
    """Constants as the two outputs of a YOLO segmenter."""
    from test_segmenters import onnx_file

    rows = np.zeros((1, 4 + 2 + 3, 5), np.float32)
    rows[0, :4], rows[0, 4, 0] = 16, 0.9
    onnx_file(folder / "n.onnx", (1, 3, 32, 32), [rows, np.ones((1, 3, 8, 8))], {"names": "{0: 'cup', 1: 'door'}"})


def read_network(folder):
    """Its instances in a frame."""
    from vlmm_log.models.yolo import Yolo

    yolo = Yolo(folder / "n.onnx", Settings().objects)
    frame = Frame(0, 0, np.zeros((36, 40, 3), np.uint8), np.ones((36, 40), np.float32), np.eye(3), None)
    return len(yolo(frame).notes)


JSON = (("*.json", broken_json),)
NAMED = (
    Format(
        "masks and labels",
        _masks,
        (("*.txt", broken_text), ("*.png", broken_png), ("*.png", broken_bytes)),
        read_masks,
        True,
    ),
    Format("calibration", _calibration, JSON, read_calibration),
    Format("batch manifest", _batch, JSON, read_batch),
    Format(
        "truth of a scene",
        _scene,
        (("*.json", broken_json), ("*.csv", broken_text), ("*.txt", broken_text), ("*.png", broken_png)),
        read_scene,
    ),
)


# ---- recordings


def _recordings(folder, schema):
    """A run's recording, and a second one to compare with."""
    import vlmm_log

    write_tum_folder(folder / "log", shift_px=2)
    for name in ("a", "b"):
        options = (
            {"rrd": folder / f"{name}.rrd"}
            if schema == "rrd"
            else {"mcap": folder / f"{name}.mcap", "mcap_schema": schema}
        )
        vlmm_log.process(folder / "log", queries=("everything",), **options)
    for path in contents(folder / "log"):
        (folder / "log" / path).unlink()


def broken_message(data, rng):
    """A Rerun recording with one table's bytes broken, its length left whole: lengths tell of most other damage."""
    tables = [(at, length) for kind, at, length in places(io.BytesIO(data), len(data)) if kind == ARROW]
    at, length = tables[int(rng.integers(0, len(tables)))]
    return data[:at] + broken_bytes(data[at : at + length], rng)[:length].ljust(length, b"\0") + data[at + length :]


def read_recording(folder):
    """The recording in ``diff``, ``view`` and ``query``."""
    import vlmm_log
    from vlmm_log.viewing import prepare

    a, b = sorted(p for p in folder.iterdir() if p.stem in "ab" and p.is_file())
    lost, refused = 0, []
    (folder / "shown").mkdir(exist_ok=True)
    looks = (
        lambda: len(prepare([a], folder / "shown", web=False).told),
        lambda: len(vlmm_log.diff(a, b).missing),
        lambda: vlmm_log.query(a, "everything") is None,
    )
    for look in looks:
        try:
            lost += look()
        except InputError as e:
            refused.append(e)
    if len(refused) == len(looks):
        raise refused[0]
    return lost


RECORDINGS = tuple(
    Format(
        f"recording, {schema}",
        partial(_recordings, schema=schema),
        ((f"a.{suffix}", broken_bytes),),
        read_recording,
        examples=60,
    )
    for schema, suffix in (("rrd", "rrd"), ("ros2", "mcap"), ("foxglove", "mcap"))
)

MESSAGES = Format(
    "recording, messages", partial(_recordings, schema="rrd"), (("a.rrd", broken_message),), read_recording
)
"""For `benchmarks.fuzz` alone: what still ends the process by chance, in Rerun's decoder, ends no test's run."""

NETWORK = Format("ONNX network", _network, (("*", broken_bytes),), read_network)

FORMATS = (*FOLDERS, *BAGS, IMAGES, *NAMED, *RECORDINGS)
FORMATS += (NETWORK,) if find_spec("onnxruntime") else ()
