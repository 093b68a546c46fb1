"""Files that are broken, lie or attack: refused in one line or read with the loss told, in little time and memory.

``python -m benchmarks.fuzz`` tries the same for as long as one likes.
"""

import bz2
import io
import json
import shutil
import sqlite3
import struct
import zlib
from functools import cache
from itertools import cycle
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace

import cv2
import lz4.frame
import numpy as np
import pyarrow as pa
import pytest
import zstandard
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from test_segmenters import needs_onnx, onnx_file

import vlmm_log
from bags import Messages, write
from fuzzed import FORMATS, apply, contents, limited, watched
from tum_folder import write_tum_folder
from vlmm_log.conversion import convert
from vlmm_log.image_files import decoded
from vlmm_log.models.yolo import Yolo
from vlmm_log.readers import open_log
from vlmm_log.readers.bag import decompression
from vlmm_log.readers.bag.containers import MessageError, open_container
from vlmm_log.readers.bag.rosbag2 import _files, open_rosbag2
from vlmm_log.readers.bag.schemas import Schema, decoder
from vlmm_log.readers.bag.sqlite import open_sqlite
from vlmm_log.readers.bag.sqlite_rows import rows_of
from vlmm_log.readers.bag.synchronise import MOST_WAITING, synchronised
from vlmm_log.readers.intrinsics import from_file
from vlmm_log.readers.stamps import associate
from vlmm_log.readers.stored import Shot
from vlmm_log.recording import open_recording
from vlmm_log.recording.properties import end_of, run_of
from vlmm_log.recording.rrd_damage import first_damage, places
from vlmm_log.settings import ObjectSettings, Settings
from vlmm_log.types import InputError, Skipped

SPARE = 3 << 30  # bytes of addresses beside those in use: threads and compilers take some without touching them


@cache
def whole(form):
    """The files of a valid input. It is read once: what is compiled and imported at first counts for nothing."""
    with TemporaryDirectory() as folder:
        form.files(Path(folder))
        files = contents(Path(folder))
        form.read(Path(folder))
        return files


@pytest.mark.parametrize("form", FORMATS, ids=lambda form: form.name)
def test_a_broken_file_is_told_and_never_worse(form, tmp_path):
    files = whole(form)

    @settings(max_examples=form.examples, derandomize=True, database=None, suppress_health_check=list(HealthCheck))
    @given(st.integers(0, 2**32 - 1))
    def read(seed):
        folder = tmp_path / "input"
        apply(form, files, folder, np.random.default_rng(seed))
        try:
            with watched(folder), limited(SPARE):
                form.read(folder)
        except InputError as e:
            assert str(e)
            assert "\n" not in str(e)
        finally:
            shutil.rmtree(folder)
        assert [p.name for p in tmp_path.iterdir()] == []

    read()


# ---- small files that claim, or become, much


def chunk(kind, body):
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def claimed_png(width, height, data=b"", length=None):
    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    body = chunk(b"IDAT", data)
    body = body if length is None else struct.pack(">I", length) + body[4:]
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + body + chunk(b"IEND", b"")


def claimed(kind, width, height):
    """A file of 64x48 px that says another size."""
    data = bytearray(cv2.imencode(f".{kind}", np.zeros((48, 64, 3), np.uint8))[1].tobytes())
    match kind:
        case "jpg":
            at = data.index(b"\xff\xc0") + 5
            data[at : at + 4] = struct.pack(">HH", height, width)
        case "ppm":
            data[:] = data.replace(b"64 48", b"%d %d" % (width, height))
        case "tiff":
            data[:] = data.replace(struct.pack("<HHII", 257, 3, 1, 48), struct.pack("<HHII", 257, 4, 1, height))
            data[:] = data.replace(struct.pack("<HHII", 256, 3, 1, 64), struct.pack("<HHII", 256, 4, 1, width))
        case "webp":
            at = data.index(b"VP8") + 4
            data[at : at + 14] = b"" if data[at - 1 : at] == b" " else data[at : at + 14]
    return bytes(data)


@pytest.mark.parametrize(
    "image",
    [
        claimed_png(30_000, 30_000),
        claimed_png(2**31 - 1, 2**31 - 1),
        claimed_png(64, 48, length=0xFFFFFF00),  # of a chunk
        claimed_png(20_000, 20_000, zlib.compress(bytes(60_001 * 20_000), 1)),  # true, and still too much
        claimed("jpg", 65_000, 65_000),
        claimed("ppm", 30_000, 30_000),
        claimed("tiff", 30_000, 30_000),
    ],
    ids=["png", "png, most", "png, chunk", "png, zeros", "jpg", "ppm", "tiff"],
)
def test_an_image_s_stated_size_is_checked_before_memory_is_reserved(image):
    with limited(256 << 20):
        assert decoded(image, cv2.IMREAD_COLOR) is None


@pytest.mark.parametrize("kind", ["png", "jpg", "ppm", "tiff", "webp"])
@pytest.mark.parametrize("size", [(48, 64), (1, 1), (700, 33)])
def test_images_of_every_kind_are_read_as_before(kind, size):
    pixels = np.random.default_rng(0).integers(0, 256, (*size, 3), np.uint8)
    file = cv2.imencode(f".{kind}", pixels)[1]
    assert np.array_equal(decoded(file.tobytes(), cv2.IMREAD_COLOR), cv2.imdecode(file, cv2.IMREAD_COLOR))


def test_how_a_camera_was_held_turns_no_colour_away_from_its_depth():
    pixels = np.zeros((48, 64, 3), np.uint8)
    pixels[:24] = 200
    jpeg = cv2.imencode(".jpg", pixels)[1].tobytes()
    turned = b"MM\0*" + struct.pack(">IHHHIHHI", 8, 1, 0x0112, 3, 1, 6, 0, 0)  # orientation 6: a quarter to the right
    exif = b"\xff\xe1" + struct.pack(">H", 8 + len(turned)) + b"Exif\0\0" + turned
    assert cv2.imdecode(np.frombuffer(jpeg[:2] + exif + jpeg[2:], np.uint8), cv2.IMREAD_COLOR).shape == (64, 48, 3)
    read = decoded(jpeg[:2] + exif + jpeg[2:], cv2.IMREAD_COLOR)
    assert np.array_equal(read, decoded(jpeg, cv2.IMREAD_COLOR))


GIB_OF_ZEROS = {
    "zstd": lambda n: zstandard.ZstdCompressor().compress(bytes(n)),
    "lz4": lambda n: lz4.frame.compress(bytes(n)),
    "bz2": lambda n: bz2.compress(bytes(n), 1),
}


@pytest.mark.parametrize("how", GIB_OF_ZEROS)
def test_a_chunk_becomes_no_larger_than_it_says(how):
    data = GIB_OF_ZEROS[how](200 << 20)
    with limited(64 << 20):
        for said in (1000, (200 << 20) - 1, 2**40, 2**63):
            with pytest.raises(ValueError, match=r"stated|damaged|larger"):
                decompression.decompressed(data, how, said)
        assert len(decompression.decompressed(GIB_OF_ZEROS[how](5000), how, 5000)) == 5000


def test_a_message_becomes_no_larger_than_it_says(monkeypatch):
    small = zstandard.ZstdCompressor(write_content_size=False).compress(b"abc" * 99)
    assert decompression.decompressed_message(small) == b"abc" * 99
    monkeypatch.setattr(decompression, "LARGEST", 1000)
    for data in (GIB_OF_ZEROS["zstd"](5000), zstandard.ZstdCompressor(write_content_size=False).compress(bytes(5000))):
        with pytest.raises(ValueError, match=r"stated|damaged"):
            decompression.decompressed_message(data)


def test_a_compressed_bag_does_not_fill_the_disk(tmp_path):
    path = write(tmp_path / "log.mcap", "mcap", [("/a", 1, Messages("mcap").header(1, "x"))])
    bomb = tmp_path / "log.mcap.zstd"
    bomb.write_bytes(zstandard.ZstdCompressor().compress(path.read_bytes() + bytes(200 << 20)))
    assert bomb.stat().st_size < (200 << 20) / 1000
    assert "file is compressed too much" in {loss.reason for loss in open_container(bomb).losses}


def test_names_in_metadata_are_texts_and_stay_in_the_folder(tmp_path):
    folder = write(tmp_path / "log", "ros2", [("/a", 1, Messages("ros2").header(1, "x"))])
    (inside,) = folder.glob("*.db3")
    inside.rename(tmp_path / "elsewhere.db3")
    bomb = "a: &a [x]\n" + "".join(
        f"{b}: &{b} [{', '.join([f'*{a}'] * 9)}]\n" for a, b in zip("abcdefgh", "bcdefghi", strict=True)
    )
    for text in (
        "rosbag2_bagfile_information:\n  relative_file_paths: [../elsewhere.db3]\n",
        f"rosbag2_bagfile_information:\n  relative_file_paths: [{tmp_path}/elsewhere.db3]\n",
        f"{bomb}rosbag2_bagfile_information:\n  relative_file_paths: [*i]\n",
        "rosbag2_bagfile_information: " + "[" * 100_000,
        "!!python/object/apply:os.system [exit 1]\n",
    ):
        (folder / "metadata.yaml").write_text(text)
        with watched(folder), limited(1 << 30), pytest.raises(InputError, match="no part of the bag"):
            open_rosbag2(folder)


def test_stamps_that_lie_near_to_each_other_take_no_memory():
    stamps = list(range(30_000))
    with limited(512 << 20):
        assert associate(stamps, stamps, 20_000_000) == [(k, k) for k in stamps]


def test_images_that_lie_near_to_each_other_take_no_time():
    def stream(count):
        return [Shot(kind, k, k, f"{kind} {k}", lambda: None) for k in range(count) for kind in ("rgb", "depth")]

    assert [pair[0].index for pair in synchronised(stream(1500), 20_000_000)] == list(range(1500))
    items = list(synchronised(stream(20_000), 20_000_000))
    reasons = {x.reason for x in items if isinstance(x, Skipped)}
    assert reasons == {f"{MOST_WAITING} images wait for others at its time"}
    assert len(items) == MOST_WAITING + 2 * (20_000 - MOST_WAITING)


class Circle:
    """A table whose damaged tree leads back to where it came from, as `benchmarks.fuzz` found one."""

    def execute(self, query, _after):
        rows = cycle([(1, 1, 10), (2, 1, 20), (3, 1, 30)])
        return SimpleNamespace(fetchone=lambda: next(rows)) if "LIMIT" in query else rows


def test_rows_that_lead_back_are_read_once():
    rows = rows_of(Circle())
    assert rows.ids.tolist() == [1, 2, 3]
    assert [(x.what, x.reason) for x in rows.losses] == [("rows after 3", "rows cannot be read")]


def test_a_part_whose_name_no_file_can_have_is_missing(tmp_path):
    names = ["a_0.db3", "b" * 300 + ".db3"]
    told = {"relative_file_paths": names}
    (tmp_path / "a_0.db3").write_bytes(b"")
    losses = []
    assert _files(tmp_path, told, losses) == [tmp_path / "a_0.db3"]
    assert [(x.what, x.reason) for x in losses] == [(names[1], "part named in metadata.yaml is missing")]


def test_a_damaged_message_of_a_recording_is_told_where_it_lies(tmp_path):
    """Rerun's own decoder may end the process."""
    form = next(form for form in FORMATS if form.name == "recording, rrd")
    data = whole(form)["a.rrd"]
    (tmp_path / "a.rrd").write_bytes(data)
    with (tmp_path / "a.rrd").open("rb") as f:
        assert first_damage(f, len(data)) is None
        messages = [(at, length) for kind, at, length in places(f, len(data)) if kind == 2]
    unnoticed = 0
    for k, (at, length) in enumerate(messages):
        broken = bytearray(data)
        broken[at + length // 2 : at + length // 2 + 40] = bytes(40)
        (tmp_path / "a.rrd").write_bytes(broken)
        with (tmp_path / "a.rrd").open("rb") as f:
            damage = first_damage(f, len(broken))
        if damage is None:  # within a picture's or a text's own bytes, of which the format has no checksum
            unnoticed += 1
            recording = open_recording(tmp_path / "a.rrd")
            assert sum(1 for _ in recording.entries(recording.entities)) > 0
            continue
        assert damage == at
        if k % 9 == 0:
            with pytest.raises(InputError, match=f"its message at byte {at} is damaged; process the log again"):
                open_recording(tmp_path / "a.rrd")
    assert unnoticed < 0.05 * len(messages)


@pytest.mark.parametrize("kind", [0, 2, 9])
@pytest.mark.parametrize("length", [0, 1, 2**40, 2**64 - 1])
def test_a_length_or_kind_that_hides_messages_is_told(tmp_path, kind, length):
    """Rerun reads them all the same, from where its footer says; one of them damaged ended the process."""
    form = next(form for form in FORMATS if form.name == "recording, rrd")
    broken = bytearray(whole(form)["a.rrd"])
    path = tmp_path / "a.rrd"
    path.write_bytes(broken)
    with path.open("rb") as f:
        (at, _), *_, (last, size) = [(at, length) for kind, at, length in places(f, len(broken)) if kind == 2]
    broken[at - 16 : at] = struct.pack("<QQ", kind, length)
    broken[last + size // 2 : last + size // 2 + 40] = bytes(40)
    path.write_bytes(broken)
    with pytest.raises(InputError, match=r"its message at byte \d+ is damaged; process the log again"):
        open_recording(path)


@pytest.mark.parametrize(
    ("kind", "sound"),
    [
        (pa.field("ab", pa.int32()), True),
        (pa.field("a\0b", pa.int32()), False),
        (pa.field("ab", pa.list_(pa.field("c\0", pa.int32()))), False),
        (pa.field("ab", pa.timestamp("ns", "UT\0C")), False),
    ],
)
def test_names_that_end_in_their_midst_are_damage(tmp_path, kind, sound):
    """Rerun makes C's strings of them, and ends the process where it cannot."""
    table = io.BytesIO()
    with pa.ipc.new_stream(table, pa.schema([kind])) as stream:
        stream.write_table(pa.schema([kind]).empty_table())
    assert damage_of_table(table.getvalue(), tmp_path / "a.rrd") == (None if sound else 28)


@pytest.mark.parametrize("valid", [(1 << 20, 0), (384, 1 << 20), (-8, 0), (1 << 62, 1 << 62), (769, 0)])
def test_a_column_that_lies_outside_of_its_table_is_damage(tmp_path, valid):
    """Rerun ends the process at one; Arrow's own reader lets those pass that it need not look at."""
    table = io.BytesIO()
    batch = pa.record_batch({name: np.arange(48.0) for name in "ab"})
    with pa.ipc.new_stream(table, batch.schema) as stream:
        stream.write_batch(batch)
    data, second = table.getvalue(), struct.pack("<qqqq", 384, 0, 384, 384)  # which of b are valid: all; its numbers
    assert data.count(second) == 1
    assert damage_of_table(data, tmp_path / "sound.rrd") is None
    assert damage_of_table(data.replace(second, struct.pack("<qqqq", *valid, 384, 384)), tmp_path / "a.rrd") == 28


def damage_of_table(data, path):
    """Where the damage is of a Rerun recording that is one Arrow table."""
    assert 128 <= len(data) < 1 << 14
    message = bytes([5 << 3 | 2, len(data) & 127 | 128, len(data) >> 7]) + data
    path.write_bytes(b"RRF2" + bytes(8) + struct.pack("<QQ", 2, len(message)) + message)
    with path.open("rb") as f:
        return first_damage(f, path.stat().st_size)


def test_a_message_of_another_entity_than_the_footer_says_is_told(tmp_path):
    """Found by breaking messages alone: the name within one was changed to another that can be."""
    (form,) = (form for form in FORMATS if form.name == "recording, rrd")
    data, name = whole(form)["a.rrd"], b"/__properties/vlmm_end"
    path = tmp_path / "a.rrd"
    path.write_bytes(data)
    changed = bytearray(data)
    with path.open("rb") as f:
        inside = [
            at + data[at : at + length].index(name)
            for kind, at, length in places(f, len(data))
            if kind == 2 and name in data[at : at + length]
        ]
    assert inside
    for at in inside:
        changed[at + 2 : at + 4] = b"PR"
    path.write_bytes(changed)
    with pytest.raises(InputError, match="its footer and its message disagree on"):
        open_recording(path)


def test_what_a_recording_says_of_its_run_is_checked(tmp_path):
    run = {"source": "a", "reader": "tum", "settings": Settings().to_toml(), "world_up": "+z", "versions": "{}"}
    run |= {"notes": "[]", "has_poses": True}
    end = {"complete": True, "input_hash": "", "frames": 2, "pairs": 1}
    assert (run_of(tmp_path, run).notes, end_of(tmp_path, end).pairs) == ((), 1)
    for name, wrong in (
        *((name, None) for name in run if name != "has_poses"),
        *(("versions", v) for v in ("[]", "{", '{"a": 1}', "[" * 99_999)),
        *(("notes", v) for v in ("{", "3", "[1]")),
        *(("settings", v) for v in ("a =", "a = " + "[" * 99_999, "profile = []", "noise.alpha = 'x'")),
        ("world_up", "up"),
    ):
        with pytest.raises(InputError):
            run_of(tmp_path, run | {name: wrong})
    for name in end:
        with pytest.raises(InputError):
            end_of(tmp_path, end | {name: None})
        with pytest.raises(InputError):
            end_of(tmp_path, {k: v for k, v in end.items() if k != name})


@pytest.mark.parametrize(("up", "pose"), [("+x", "0 -1 0 {} 1 0 0 0 0 0 1 0"), ("-z", "1 0 0 {} 0 0 -1 0 0 1 0 0")])
def test_poses_in_any_world_make_a_map_that_is_read_back(tmp_path, up, pose):
    """Broken poses found what good ones can be too: cameras whose up is x or -z."""
    files = {"poses.txt": "".join(f"{pose.format(k)}\n" for k in range(4)), "rgb.txt": None, "depth.txt": None}
    log = write_tum_folder(tmp_path / "log", shift_px=2, files=files)
    assert open_log(log).world_up == up
    vlmm_log.process(log, rrd=tmp_path / "a.rrd", map=tmp_path / "a.json", queries=("things above the floor",))
    for path in (tmp_path / "a.rrd", tmp_path / "a.json"):
        assert vlmm_log.load_map(path).run.world_up == up
        assert vlmm_log.query(path, "everything")


@needs_onnx
@pytest.mark.parametrize(
    ("shape", "value", "told"),
    [
        ((1, 3, 60_000, 60_000), 1, "its input is of"),
        ((1, 3, 0, 32), 1, "its input is of"),
        ((1, 3, 32, 32), np.nan, "boxes that are no numbers"),
    ],
)
def test_a_network_s_sizes_and_numbers_are_checked(tmp_path, shape, value, told):
    rows = np.full((1, 4 + 1 + 2, 3), value)
    rows[0, 4] = 0.9
    path = onnx_file(tmp_path / "n.onnx", shape, [rows, np.ones((1, 2, 8, 8))], {"names": "['cup']"})
    with limited(1 << 30), pytest.raises(InputError, match=told):
        Yolo(path, ObjectSettings())


# ---- files that compute

IDL = "module a {{ module msg {{ struct B {{ {} }}; }}; }};"
DEFINITIONS = {
    "texts by the billion": ("ros2msg", "string[4000000000] x"),
    "messages by the billion": ("ros2msg", f"C[4000000000] x\n{'=' * 80}\nMSG: a/C\nint32 y\n"),
    "a type in itself": ("ros2msg", "B x"),
    "a shift": ("ros2idl", IDL.format("long x[1 << 33000000000];")),
    "brackets": ("ros2idl", IDL.format(f"long x[{'(' * 9}3{')' * 9}];")),
}


@pytest.mark.parametrize(("language", "text"), DEFINITIONS.values(), ids=DEFINITIONS)
def test_a_definition_that_computes_is_refused(language, text):
    with limited(1 << 30), pytest.raises(MessageError, match="definition"):
        decoder(Schema("a/msg/B", "cdr", language, text.encode()))(b"\0\1\0\0" + bytes(64))


@pytest.mark.parametrize("name", ["1a/msg/B", "a'''/msg/B", "a/msg/B:\n    import os\n", "a/msg/B\nint32 y", '"'])
def test_no_name_of_a_type_becomes_code(name, tmp_path):
    with watched(tmp_path), pytest.raises(MessageError, match="definition"):
        decoder(Schema(name, "cdr", "ros2msg", b"int32 x"))(b"\0\1\0\0" + bytes(64))


@pytest.mark.parametrize(
    "shape", [b'{"properties": [1]}', b'{"items": 3, "properties": {"a": 7}}', b"[]", b"[" * 99_999]
)
def test_a_schema_of_json_that_is_none_is_told_or_says_nothing(shape):
    try:
        assert decoder(Schema("x", "json", "jsonschema", shape))(b'{"a": [1]}').a == [1]
    except MessageError as e:
        assert str(e) == "message definition cannot be read"


def database(path, *statements):
    with sqlite3.connect(path) as db:
        for statement in statements:
            db.execute(statement)
    db.close()
    return path


TOPICS = "CREATE TABLE topics(id, name, type, serialization_format)"
MESSAGES = "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp, data)"
COMPUTED = "CREATE TABLE messages(id, topic_id, data, timestamp AS (length(hex(zeroblob(400000000)))))"
ENDLESS = "WITH RECURSIVE n(k) AS (SELECT 1 UNION ALL SELECT k + 1 FROM n) SELECT k, k, k, k FROM n"


@pytest.mark.parametrize(
    "statements",
    [
        (TOPICS, f"CREATE VIEW messages(id, topic_id, timestamp, data) AS {ENDLESS}"),
        (
            TOPICS,
            COMPUTED,
            "INSERT INTO messages VALUES (1, 1, x'00')",
        ),
    ],
)
def test_a_schema_that_computes_is_refused(tmp_path, statements):
    path = database(tmp_path / "log.db3", *statements)
    with limited(512 << 20), pytest.raises(InputError) as e:
        open_sqlite(path)
    assert "is no ROS 2 bag" in str(e.value)


def test_a_disguised_view_is_refused(tmp_path):
    view = f"CREATE VIEW messages(id, topic_id, timestamp, data) AS {ENDLESS}"
    disguise = f"UPDATE sqlite_master SET sql = '{view}', rootpage = 0 WHERE name = 'messages'"
    path = database(tmp_path / "log.db3", TOPICS, MESSAGES, "PRAGMA writable_schema = ON", disguise)
    with pytest.raises(InputError):
        open_sqlite(path)


def test_values_of_other_types_cost_their_rows(tmp_path):
    rows = ["(1, '/a', 'std_msgs/msg/Header', 'cdr')", "(NULL, 3, x'ff', NULL)", "('x', NULL, 2.5, x'00')"]
    odd = [
        f"INSERT INTO messages VALUES ({k + 2}, {v}, {v}, x'00')"
        for k, v in enumerate(("'9'", "NULL", "9e999", "x'00'"))
    ]
    last = f"INSERT INTO messages VALUES ({2**63 - 1}, 1, 'x', x'00')"
    first = "INSERT INTO messages VALUES (1, 1, 5, x'00')"
    path = database(
        tmp_path / "log.db3", TOPICS, MESSAGES, *(f"INSERT INTO topics VALUES {r}" for r in rows), first, *odd, last
    )
    found = open_sqlite(path)
    assert [t.name for t in found.topics] == ["/a"]
    assert found.rows.ids.tolist() == [1]
    assert [(loss.what, loss.reason) for loss in found.losses] == [("5 rows", "row holds no integers")]


# ---- names


@pytest.mark.parametrize("topic", ["/../../../../escaped", "../escaped", "/a\0b", "/" + "x" * 5000])
@pytest.mark.parametrize("to", ["out", "out.bag", "out.mcap"])
def test_a_topic_s_name_names_no_file(tmp_path, topic, to):
    from test_bag import COLOURS, DEPTH, DEPTHS, OPTICAL, STAMPS

    m = Messages("mcap")
    records = []
    for t, colour, depth in zip(STAMPS, COLOURS, DEPTHS, strict=True):
        records += [(topic, t, m.image(t, OPTICAL, colour, "rgb8")), (DEPTH, t, m.image(t, OPTICAL, depth, "16UC1"))]
    room = tmp_path / "a/b/c"
    room.mkdir(parents=True)
    path = write(room / "log.mcap", "mcap", records)
    with watched(room):
        convert(path, room / to, settings=Settings.load(sets=["read.intrinsics='60,60,31.5,23.5'"]))
    assert {p.name for p in room.iterdir()} == {"log.mcap", to}
    assert [p.name for p in tmp_path.rglob("*escaped*")] == []


@pytest.mark.parametrize("folder", ["..", "../x", "/etc", "a/b"])
def test_a_manifest_names_folders_beside_it(tmp_path, folder):
    from vlmm_log.batches.manifest import read_manifest

    task = {"source": "a", "folder": folder, "state": "done", "error": None, "hash": "", "seconds": 1, "pairs": 1}
    told = {"format": "vlmm-log batch", "version": 1, "tasks": [task]}
    (tmp_path / "manifest.json").write_text(json.dumps(told))
    with pytest.raises(InputError, match="no bare name"):
        read_manifest(tmp_path)


@pytest.mark.parametrize("rows", ["width 1e300", "height -1", "width 100000\nheight 100000"])
def test_no_camera_has_such_a_size(tmp_path, rows):
    (tmp_path / "camera.txt").write_text(f"fx 60\nfy 60\ncx 31.5\ncy 23.5\n{rows}\n")
    with pytest.raises(InputError, match="correct width and height"):
        from_file(tmp_path / "camera.txt")


def test_a_number_without_a_time_is_refused(tmp_path):
    log = write_tum_folder(tmp_path / "log", files={"rgb.txt": None, "depth.txt": None})
    for kind in ("rgb", "depth"):
        (log / kind / "0.png").rename(log / kind / f"0{'9' * 25}.png")
    with pytest.raises(InputError, match="too large a number"):
        open_log(log)
