"""Containers: equal messages give equal streams, whatever holds them; damage is named and never passed on."""

import base64
import json
import shutil
import sqlite3
from types import SimpleNamespace

import lz4.frame
import numpy as np
import pytest
import zstandard
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys import Stores, get_typestore

from vlmm_log.readers.bag.chunked import ChunkError
from vlmm_log.readers.bag.containers import Message, MessageError, is_container, open_container
from vlmm_log.readers.bag.rosbag1_records import chunk_content
from vlmm_log.types import InputError, Skipped

EVER = 2**62
ORIGIN_NS = 1_700_000_000_000_000_000
STORE1, STORE2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_JAZZY)
STRING, POINT = "std_msgs/msg/String", "geometry_msgs/msg/Point"
TYPES = {"/words": STRING, "/points": POINT}


def sample(count=60, seed=0):
    """Messages (topic, log time, fields) in no order of time; every seventh log time is shared."""
    rng = np.random.default_rng(seed)
    rows = []
    for k in range(count):
        t = ORIGIN_NS + (k // 7 if k % 7 < 2 else k) * 10_000_000 + int(rng.integers(-3, 4)) * 10_000_000
        filler = rng.integers(0, 256, int(rng.integers(0, 3000)), np.uint8)
        rows.append(
            ("/words", t, {"data": f"word {k} {filler.tobytes().hex()}"}) if k % 3 else ("/points", t, {"x": k})
        )
    return rows


def built(store, topic, fields):
    kind = store.types[TYPES[topic]]
    return kind(data=fields["data"]) if topic == "/words" else kind(x=float(fields["x"]), y=0.0, z=-1.0)


def write_bag(path, rows, compression=None, chunk_bytes=20_000):
    bag = Rosbag1Writer(path)
    bag.chunk_threshold = chunk_bytes
    if compression:
        bag.set_compression(compression)
    with bag:
        channels = {t: bag.add_connection(t, TYPES[t], typestore=STORE1) for t in TYPES}
        for topic, t, fields in rows:
            bag.write(channels[topic], t, STORE1.serialize_ros1(built(STORE1, topic, fields), TYPES[topic]))
    return path


def write_folder(path, rows, storage=StoragePlugin.SQLITE3, mode=None):
    bag = Rosbag2Writer(path, version=9, storage_plugin=storage)
    if mode:
        bag.set_compression(mode, CompressionFormat.ZSTD)
    with bag:
        channels = {t: bag.add_connection(t, TYPES[t], typestore=STORE2) for t in TYPES}
        for topic, t, fields in rows:
            bag.write(channels[topic], t, STORE2.serialize_cdr(built(STORE2, topic, fields), TYPES[topic]))
    return path


def write_mcap(path, rows, chunk_bytes=20_000, **options):
    with path.open("wb") as file:
        writer = McapWriter(file, chunk_size=chunk_bytes, **options)
        writer.start("ros2")
        channels = {}
        for topic, name in TYPES.items():
            text, _ = STORE2.generate_msgdef(name, ros_version=2)
            schema = writer.register_schema(name, "ros2msg", text.encode())
            channels[topic] = writer.register_channel(topic, "cdr", schema)
        for topic, t, fields in rows:
            raw = STORE2.serialize_cdr(built(STORE2, topic, fields), TYPES[topic])
            writer.add_message(channels[topic], t, bytes(raw), t)
        writer.finish()
    return path


def write_parts(path, rows, storage=StoragePlugin.SQLITE3, parts=3):
    """A bag whose messages are spread over parts in turn, so that the parts overlap in time."""
    path.mkdir()
    names = []
    for k in range(parts):
        size = -(-len(rows) // parts)
        own = write_folder(path / f"p{k}", rows[k * size : (k + 1) * size], storage)
        file = next(p for p in own.iterdir() if p.suffix in (".db3", ".mcap"))
        names.append(f"all_{k + 8}{file.suffix}")  # 8, 9, 10: the order of names is not that of letters
        file.rename(path / names[-1])
        shutil.rmtree(own)
    return path, names


def metadata_of(names, count=0):
    told = {"version": 5, "storage_identifier": "sqlite3", "relative_file_paths": names, "message_count": count}
    return json.dumps({"rosbag2_bagfile_information": told})


def joined(path, rows, storage=StoragePlugin.SQLITE3):
    path, names = write_parts(path, rows, storage)
    (path / "metadata.yaml").write_text(metadata_of(names))
    return path


def compressed(path):
    """The file as ROS 2 leaves it where it compresses whole files."""
    target = path.with_name(path.name + ".zstd")
    target.write_bytes(zstandard.compress(path.read_bytes()))
    path.unlink()
    return target


def compressed_folder(path, rows):
    write_folder(path, rows)
    file = compressed(next(path.glob("*.db3")))
    (path / "metadata.yaml").write_text(metadata_of([file.name]))
    return path


def bare(path, rows):
    """The .db3 alone, as bags before 2023 have it: without definitions."""
    file = next(write_folder(path, rows).glob("*.db3"))
    with sqlite3.connect(file) as db:
        db.execute("DROP TABLE message_definitions")
    db.close()
    return file


BAG = Rosbag1Writer.CompressionFormat
MAKERS = {
    "bag": lambda p, rows: write_bag(p / "a.bag", rows),
    "bag bz2": lambda p, rows: write_bag(p / "b.bag", rows, BAG.BZ2),
    "bag lz4": lambda p, rows: write_bag(p / "c.bag", rows, BAG.LZ4),
    "sqlite3": lambda p, rows: write_folder(p / "s", rows),
    "sqlite3 by message": lambda p, rows: write_folder(p / "m", rows, mode=CompressionMode.MESSAGE),
    "sqlite3 by file": lambda p, rows: compressed_folder(p / "f", rows),
    "sqlite3 parts": lambda p, rows: joined(p / "sp", rows),
    "db3": lambda p, rows: bare(p / "d", rows),
    "mcap folder": lambda p, rows: write_folder(p / "g", rows, StoragePlugin.MCAP),
    "mcap parts": lambda p, rows: joined(p / "mp", rows, StoragePlugin.MCAP),
    "mcap zstd": lambda p, rows: write_mcap(p / "z.mcap", rows),
    "mcap lz4": lambda p, rows: write_mcap(p / "l.mcap", rows, compression=CompressionType.LZ4),
    "mcap plain": lambda p, rows: write_mcap(p / "n.mcap", rows, compression=CompressionType.NONE),
    "mcap without chunks": lambda p, rows: write_mcap(p / "u.mcap", rows, use_chunking=False),
    "mcap without message index": lambda p, rows: write_mcap(
        p / "i.mcap", rows, index_types=IndexType.ALL & ~IndexType.MESSAGE
    ),
    "mcap without summary": lambda p, rows: write_mcap(
        p / "w.mcap", rows, index_types=IndexType.NONE, use_statistics=False, use_summary_offsets=False,
        repeat_channels=False, repeat_schemas=False,
    ),
}  # fmt: skip


@pytest.fixture(scope="module", params=MAKERS)
def container(request, tmp_path_factory):
    found = open_container(MAKERS[request.param](tmp_path_factory.mktemp("made"), sample()))
    yield found
    found.close()


def read(container, topics=tuple(TYPES), window=(0, EVER)):
    """Messages, and what was skipped."""
    items = list(container.messages(topics, *window))
    return [x for x in items if isinstance(x, Message)], [x for x in items if isinstance(x, Skipped)]


def opened(path, topics=tuple(TYPES), window=(0, EVER)):
    """Messages, and all that was lost."""
    found = open_container(path)
    try:
        messages, skipped = read(found, topics, window)
    finally:
        found.close()
    return messages, [*found.losses, *skipped]


def identity(m):
    return m.topic.name, m.log_ns, bytes(m.raw)


def fields(m):
    decoded = m.decode()
    return {"data": decoded.data} if m.topic.name == "/words" else {"x": decoded.x}


# ---- the stream


def test_every_container_gives_the_same_stream(container):
    rows = sorted(sample(), key=lambda r: r[1])
    messages, skipped = read(container)
    assert not skipped
    assert [(m.topic.name, m.log_ns, fields(m)) for m in messages] == rows
    assert {m.topic.name: m.topic.type for m in messages} == TYPES
    for name in TYPES:
        own = [m for m in messages if m.topic.name == name]
        assert [m.ordinal for m in own] == list(range(len(own)))
        assert {m.topic for m in own} == {t for t in container.topics if t.name == name}
        assert {t.count for t in container.topics if t.name == name} == {len(own)}
        assert container.log_times(name).tolist() == [m.log_ns for m in own]
    assert container.start_ns == rows[0][1]
    assert container.stop_ns == rows[-1][1] + 1
    assert not container.losses


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=25)
@given(st.data())
def test_windows_are_slices_of_the_whole_stream(container, data):
    steps = st.integers(-8, 70)
    start, stop = (ORIGIN_NS + data.draw(steps) * 10_000_000 for _ in range(2))
    topics = data.draw(st.sets(st.sampled_from([*TYPES, "/none"])))
    whole, _ = read(container)
    messages, skipped = read(container, topics, (start, stop))
    expected = [(*identity(m), m.ordinal) for m in whole if start <= m.log_ns < stop and m.topic.name in topics]
    assert [(*identity(m), m.ordinal) for m in messages] == expected
    assert not skipped


def test_log_times_are_not_known_where_only_payloads_tell_them(tmp_path):
    found = open_container(MAKERS["mcap without message index"](tmp_path, sample()))
    assert found.log_times("/words") is None
    assert found.log_times("/none") is None
    found.close()


def test_connections_of_one_topic_are_one_topic(tmp_path):
    with Rosbag1Writer(tmp_path / "two.bag") as bag:
        both = [bag.add_connection("/words", STRING, typestore=STORE1, callerid=c) for c in ("/a", "/b")]
        for k in range(6):
            raw = STORE1.serialize_ros1(built(STORE1, "/words", {"data": str(k)}), STRING)
            bag.write(both[k % 2], 100 + k, raw)
    messages, losses = opened(tmp_path / "two.bag")
    assert [(m.decode().data, m.ordinal) for m in messages] == [(str(k), k) for k in range(6)]
    assert {m.topic.count for m in messages} == {6}
    assert not losses


EMPTY = ["bag", "sqlite3", "db3", "mcap folder", "mcap zstd", "mcap without chunks", "mcap without summary"]


@pytest.mark.parametrize("name", EMPTY)
def test_a_container_without_messages_is_one(name, tmp_path):
    found = open_container(MAKERS[name](tmp_path, []))
    assert read(found) == ([], [])
    assert (found.start_ns, found.stop_ns, found.losses) == (0, 0, ())
    found.close()


def test_ros_1_messages_in_mcap_have_the_types_of_ros_2(tmp_path):
    with (tmp_path / "one.mcap").open("wb") as file:
        writer = McapWriter(file)
        writer.start("ros1")
        schema = writer.register_schema("std_msgs/String", "ros1msg", b"string data\n")
        writer.add_message(writer.register_channel("/words", "ros1", schema), 3, b"\x02\x00\x00\x00hi", 3)
        writer.finish()
    found = open_container(tmp_path / "one.mcap")
    (m,), _ = read(found)
    assert (found.kind, m.topic.type, m.topic.encoding, m.decode().data) == ("MCAP (ros1)", STRING, "ros1", "hi")
    found.close()


def test_a_window_of_an_indexed_file_leaves_the_rest_unread(tmp_path):
    rows = [("/words", ORIGIN_NS + k, {"data": f"message {k} {'x' * 9000}"}) for k in range(200)]
    path = write_mcap(tmp_path / "far.mcap", rows, compression=CompressionType.NONE)
    found = open_container(path)
    data = bytearray(path.read_bytes())
    inside = [p.at <= data.index(b"message 100 ") < p.stop for p in found.chunks.places]
    for place, kept in zip(found.chunks.places, inside, strict=True):
        if not kept:
            data[place.at : place.stop] = bytes(place.stop - place.at)
    found.close()
    path.write_bytes(data)  # whoever reads more than the one chunk and the index finds nothing there
    messages, losses = opened(path, window=(ORIGIN_NS + 100, ORIGIN_NS + 101))
    assert [(m.ordinal, m.decode().data[:12]) for m in messages] == [(100, "message 100 ")]
    assert not losses
    assert len(inside) > 10


# ---- decoding


def test_empty_and_short_payloads_are_told(tmp_path):
    with (tmp_path / "odd.mcap").open("wb") as file:
        writer = McapWriter(file)
        writer.start("ros2")
        schema = writer.register_schema(POINT, "ros2msg", b"float64 x\nfloat64 y\nfloat64 z\n")
        broken = writer.register_schema("a/msg/B", "ros2msg", b"this is no definition at all {")
        channels = [writer.register_channel("/p", "cdr", schema), writer.register_channel("/b", "cdr", broken)]
        channels.append(writer.register_channel("/x", "flatbuffer", 0))
        rows = [(0, b""), (0, b"\x00\x01\x00\x00abc"), (0, b"\xff" * 28), (1, b"\x00\x01\x00\x00"), (2, b"?")]
        for k, (channel, raw) in enumerate(rows):
            writer.add_message(channels[channel], k, raw, k)
        writer.finish()
    reasons = []
    for m in opened(tmp_path / "odd.mcap", ("/p", "/b", "/x"))[0]:
        with pytest.raises(MessageError) as e:
            m.decode()
        reasons.append(str(e.value))
    unmatched = "message does not match its definition"
    assert reasons[:4] == ["message is empty", unmatched, unmatched, "message definition cannot be read"]
    assert reasons[4] == "message encoding 'flatbuffer' is not read"


def write_foxglove(path, encoding, language, name, definition, raw):
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start()
        channel = writer.register_channel("/image", encoding, writer.register_schema(name, language, definition))
        writer.add_message(channel, 5, raw, 5)
        writer.finish()
    return path


def test_json_becomes_attributes_with_bytes(tmp_path):
    shape = {"properties": {"data": {"type": "string", "contentEncoding": "base64"}, "frame_id": {"type": "string"}}}
    raw = json.dumps({"data": base64.b64encode(b"\x00\xffpixels").decode(), "frame_id": "cam", "t": {"sec": 1}})
    path = write_foxglove(
        tmp_path / "j.mcap", "json", "jsonschema", "foxglove.RawImage", json.dumps(shape).encode(), raw.encode()
    )
    (m,), losses = opened(path, ["/image"])
    assert m.decode() == SimpleNamespace(data=b"\x00\xffpixels", frame_id="cam", t=SimpleNamespace(sec=1))
    assert (m.topic.type, m.topic.encoding, losses) == ("foxglove.RawImage", "json", [])


def test_protobuf_is_read_by_the_files_own_descriptors(tmp_path):
    pb2 = pytest.importorskip("google.protobuf.descriptor_pb2")
    text, number = pb2.FieldDescriptorProto.TYPE_STRING, pb2.FieldDescriptorProto.TYPE_MESSAGE
    inner = pb2.FileDescriptorProto(name="inner.proto", package="foxglove", syntax="proto3")
    inner.message_type.add(name="Inner").field.add(name="frame_id", number=1, type=text, label=1)
    outer = pb2.FileDescriptorProto(name="outer.proto", package="foxglove", syntax="proto3", dependency=["inner.proto"])
    outer.message_type.add(name="Outer").field.add(
        name="inner", number=1, type=number, label=1, type_name=".foxglove.Inner"
    )
    definition = pb2.FileDescriptorSet(file=[outer, inner]).SerializeToString()
    path = write_foxglove(
        tmp_path / "p.mcap", "protobuf", "protobuf", "foxglove.Outer", definition, b"\x0a\x05\x0a\x03cam"
    )
    (m,), _ = opened(path, ["/image"])
    assert m.decode().inner.frame_id == "cam"


# ---- damage


CUT = ["bag", "bag bz2", "bag lz4", "db3", "mcap zstd", "mcap plain", "mcap without chunks"]


@pytest.mark.parametrize("name", CUT)
def test_of_a_file_cut_anywhere_all_that_is_left_is_read_and_the_loss_is_named(name, tmp_path):
    path = MAKERS[name](tmp_path, sample())
    data = path.read_bytes()
    whole = {identity(m) for m in opened(path)[0]}
    most = 0
    cut = tmp_path / f"cut{path.suffix}"
    for size in range(0, len(data), len(data) // 40):
        cut.write_bytes(data[:size])
        try:
            messages, losses = opened(cut)
        except InputError as e:
            assert size < 0.3 * len(data), e  # so little is left that nothing says what it is
            continue
        assert {identity(m) for m in messages} <= whole
        assert [m.log_ns for m in messages] == sorted(m.log_ns for m in messages)
        assert any(loss.reason == "file is cut off or damaged" for loss in losses)
        assert len(messages) >= most or name == "db3"  # its pages do not lie in the order of rows
        most = max(most, len(messages))
    assert most > 0.5 * len(whole)


@pytest.mark.parametrize("name", ["mcap zstd", "mcap lz4", "mcap plain", "mcap without message index"])
def test_no_altered_message_passes_a_crc(name, tmp_path):
    path = MAKERS[name](tmp_path, sample())
    data = path.read_bytes()
    whole = {identity(m) for m in opened(path)[0]}
    rng = np.random.default_rng(4)
    bad = tmp_path / "bad.mcap"
    for at in rng.integers(8, len(data), 80):
        damaged = bytearray(data)
        damaged[at] ^= int(rng.integers(1, 256))
        bad.write_bytes(damaged)
        messages, losses = opened(bad)
        assert {identity(m) for m in messages} <= whole
        assert len(messages) == len(whole) or losses


@pytest.mark.parametrize("name", ["mcap zstd", "bag lz4", "bag bz2"])
def test_a_damaged_chunk_is_skipped_and_the_next_ones_keep_their_ordinals(name, tmp_path):
    path = MAKERS[name](tmp_path, sample())
    found = open_container(path)
    whole, _ = read(found)
    place = found.chunks.places[1]
    found.close()
    data = bytearray(path.read_bytes())
    middle = (place.at + place.stop) // 2
    data[middle : middle + 50] = bytes(50)
    path.write_bytes(data)
    messages, losses = opened(path)
    (loss,) = losses
    assert loss.reason in ("chunk fails its CRC", "chunk cannot be decompressed")
    lost = sum(int(part.split()[0]) for part in loss.what.split(", "))
    assert len(messages) == len(whole) - lost
    ordinals = {(*identity(m), m.ordinal) for m in whole}
    assert {(*identity(m), m.ordinal) for m in messages} < ordinals


@pytest.mark.parametrize("compression", ["none", "bz2", "lz4"])
def test_a_bag_whose_recorder_was_killed_is_read_to_its_end(compression, tmp_path):
    """Its header names no index; its last chunk is open: its head says 0 bytes, and no index follows."""
    formats = {"none": None, "bz2": BAG.BZ2, "lz4": BAG.LZ4}
    path = write_bag(tmp_path / "k.bag", sample(), formats[compression])
    whole, _ = opened(path)
    found = open_container(path)
    last = found.chunks.places[-1]
    found.close()
    data = bytearray(path.read_bytes()[: last.stop])
    at = data.index(b"index_pos=") + len(b"index_pos=")
    data[at : at + 8] = bytes(8)
    data[last.start - 4 : last.start] = bytes(4)
    path = tmp_path / "k.bag.active"
    path.write_bytes(data)
    assert is_container(path)
    messages, losses = opened(path)
    assert [identity(m) for m in messages] == [identity(m) for m in whole]
    assert losses[0].reason == "bag has no usable index; its records were read in turn"


def test_a_chunk_of_several_lz4_frames_is_read_whole():
    parts = [bytes([k]) * (50_000 * k) for k in range(1, 4)]
    data = b"".join(lz4.frame.compress(part) for part in parts)
    whole = b"".join(parts)
    assert chunk_content(data, b"lz4", len(whole)) == whole
    with pytest.raises(ChunkError):
        chunk_content(data[:-9], b"lz4", len(whole))


def test_damaged_pages_of_a_database_cost_their_rows_only(tmp_path):
    path = bare(tmp_path / "d", sample(400))
    whole = {identity(m) for m in opened(path)[0]}
    data = bytearray(path.read_bytes())
    at = len(data) // 2 // 4096 * 4096
    data[at : at + 8192] = b"\xa5" * 8192
    path.write_bytes(data)
    messages, losses = opened(path)
    intact = {identity(m) for m in messages} & whole
    assert 0.9 * len(whole) < len(intact) < len(whole)
    assert {"rows cannot be read", "row cannot be read"} & {loss.reason for loss in losses}


# ---- folders


def test_a_folder_without_metadata_is_read_in_the_order_of_names(tmp_path):
    path, _ = write_parts(tmp_path / "bag", sample())
    assert is_container(path)
    messages, losses = opened(path)
    assert [(m.topic.name, m.log_ns) for m in messages] == [r[:2] for r in sorted(sample(), key=lambda r: r[1])]
    assert [loss.reason for loss in losses] == ["metadata.yaml is missing; parts were taken in the order of names"]


def test_missing_empty_and_unlisted_parts_are_named(tmp_path):
    path, names = write_parts(tmp_path / "bag", sample(), parts=4)
    (path / "metadata.yaml").write_text(metadata_of([*names[:3], "gone.db3"], count=60))
    (path / names[1]).write_bytes(b"")
    messages, losses = opened(path)
    assert len(messages) == 30
    assert [(x.what, x.reason) for x in losses] == [
        ("gone.db3", "part named in metadata.yaml is missing"),
        (names[3], "part is not named in metadata.yaml"),
        (names[1], "part of the bag cannot be opened"),
        ("30 messages", "counted in metadata.yaml, but in no part"),
    ]


def test_a_write_ahead_log_is_read_too(tmp_path):
    file = bare(tmp_path / "d", sample())
    with sqlite3.connect(file) as db:
        db.execute("PRAGMA journal_mode = WAL")
        db.execute("PRAGMA wal_autocheckpoint = 0")
        db.execute(
            "INSERT INTO messages (topic_id, timestamp, data) SELECT topic_id, timestamp + 1, data FROM messages"
        )
        db.commit()
        killed = tmp_path / "killed"
        killed.mkdir()
        for p in file.parent.glob("*.db3*"):
            shutil.copy(p, killed)
    db.close()
    messages, losses = opened(killed / file.name)
    assert len(messages) == 2 * len(sample())
    assert not losses


# ---- what cannot be opened


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("a.bag", b"", "is empty"),
        ("a.mcap", b"some text\n", "first bytes are others"),
        ("a.db3", b"\x00" * 5000, "first bytes are others"),
        ("a.bag", b"#ROSBAG V1.2\n", "version 1.2"),
        ("a.mcap", b"\x89MCAP0\r\n", "no MCAP header"),
        ("a.db3", b"SQLite format 3\x00", "SQLite"),
        ("a.db3.zstd", zstandard.compress(b"text"), "first bytes are others"),
    ],
)
def test_what_is_no_container_is_told_in_one_line(name, content, says, tmp_path):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=says) as e:
        open_container(tmp_path / name)
    assert "\n" not in str(e.value)


def test_folders_that_are_no_bags_are_told(tmp_path):
    assert not is_container(tmp_path)
    with pytest.raises(InputError, match="no ROS 2 bag"):
        open_container(tmp_path)
    (tmp_path / "metadata.yaml").write_text(metadata_of(["gone.db3"]))
    with pytest.raises(InputError, match=r"no part of the bag is there; copy gone\.db3 "):
        open_container(tmp_path)
    with pytest.raises(InputError, match="no such file"):
        open_container(tmp_path / "none.bag")


def test_a_folder_of_several_recordings_is_not_one(tmp_path):
    for name in ("morning.mcap", "evening.mcap"):
        write_mcap(tmp_path / name, sample(5))
    with pytest.raises(InputError, match=r"holds several recordings .* take one of them: evening.mcap, morning.mcap"):
        open_container(tmp_path)
