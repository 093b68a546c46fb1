"""Recordings as MCAP, in schemas of ROS 2 and Foxglove: equal to the Rerun recording, readable by others, robust."""

import json
from collections import Counter
from functools import partial

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

import render_room
import vlmm_log
from vlmm_log import entries
from vlmm_log.depth_pixels import metres
from vlmm_log.readers.bag.mcap_index import top_records
from vlmm_log.recording import open_recording
from vlmm_log.sinks import views
from vlmm_log.sinks.mcap import McapFile, load_dialect
from vlmm_log.types import InputError, Run, RunEnd

IMAGE = "world/camera/image"
SCHEMAS = ("ros2", "foxglove")
RUNS = {"ros2": (), "foxglove": (), "ros2-dense": ("log.dense=true",), "foxglove-dense": ("log.dense=true",)}


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs") / "room"
    render_room.write_tum(folder, 7)
    return folder


@pytest.fixture(scope="module")
def runs(room, tmp_path_factory):
    """Name of a run -> its .mcap; the .rrd lies beside it."""
    folder = tmp_path_factory.mktemp("runs")
    return {name: processed(room, folder / f"{name}.mcap", name.split("-")[0], sets) for name, sets in RUNS.items()}


def processed(room, path, schema, sets=()):
    s = vlmm_log.Settings.load(sets=[f'objects.segmenter="masks:{room / "masks"}"', *sets])
    options = {"mcap_schema": schema, "queries": ("things that moved", "everything"), "settings": s}
    vlmm_log.process(room, rrd=path.with_suffix(".rrd"), mcap=path, **options)
    return path


def bits(values):
    """Type, shape and bytes; one NaN is like another."""
    values = np.array(values)
    if values.dtype.kind == "f":
        values[np.isnan(values)] = np.nan
    return values.dtype.name, values.shape, values.tobytes()


def content(value):
    """All that a value holds and every container keeps, for comparison with ==."""
    match value:
        case entries.Raster(values, channels):
            return channels, bits(values.astype(np.float32))  # half precision has no ROS encoding
        case entries.DepthMap():
            return bits(metres(value))
        case entries.Cloud(points, colors, _):
            return bits(points), bits(colors)
        case entries.Arrows(origins, vectors, _):
            return bits(origins), bits(vectors)
        case entries.Table(columns):
            told = {name: c if isinstance(c, tuple) else bits(c) for name, c in columns.items()}
            return told if len(value) else {}  # a cleared one is of no columns in Rerun
        case _:
            held = ((name, getattr(value, name)) for name in value.__dataclass_fields__)
            return {name: bits(v) if isinstance(v, np.ndarray | float) else v for name, v in held}


def read(path):
    """All entries but what only decides how a viewer draws: (key, content), as they stand in the file; and losses."""
    recording = open_recording(path)
    told = [e for e in recording.entries(recording.entities) if not isinstance(e.value, entries.Look)]
    told = [((e.entity, type(e.value).__name__, e.index, e.stamp_ns), content(e.value)) for e in told]
    return told, recording.losses


def grouped(told):
    held = {}
    for key, value in told:
        held.setdefault(key, []).append(value)
    return held


@pytest.mark.parametrize("name", RUNS)
def test_every_value_equals_the_rerun_recordings(runs, name):
    (told, losses), (expected, _) = read(runs[name]), read(runs[name].with_suffix(".rrd"))
    assert not losses
    a, b = grouped(told), grouped(expected)
    assert a.keys() == b.keys()
    assert [key for key in a if a[key] != b[key]] == []
    assert len({kind for _, kind, _, _ in a}) == 13  # all but LabelNames, StateNames and Look
    assert any(entity == f"{IMAGE}/residual/tensor" for entity, *_ in a) == name.endswith("dense")
    assert vlmm_log.diff(runs[name].with_suffix(".rrd"), runs[name]).same


@pytest.mark.parametrize("name", SCHEMAS)
def test_run_and_end_are_told_and_settings_attached(runs, name):
    recording, expected = (open_recording(runs[name].with_suffix(suffix)) for suffix in (".mcap", ".rrd"))
    assert (recording.run, recording.end) == (expected.run, expected.end)
    with runs[name].open("rb") as file:
        reader = make_reader(file)
        assert reader.get_header().profile == ("ros2" if name == "ros2" else "")
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        attachment = next(reader.iter_attachments())
    assert metadata["vlmm_log"]["settings"] == recording.run.settings == attachment.data.decode()
    assert (attachment.name, metadata["vlmm_log_end"]["complete"]) == ("settings.toml", "true")


def test_rosbags_reads_every_message(runs):
    counts, missing = Counter(), 0
    with AnyReader([runs["ros2"]]) as reader:
        for connection, _, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            counts[connection.topic] += 1
            if connection.topic == f"/{IMAGE}/residual/d_m":
                missing += np.isnan(np.frombuffer(message.data, np.float32)).sum()
    assert missing > 1000
    fields = ("flow/tensor/u", "residual/d_m", "residual/covariance/zz", "residual/vectors", "validity", "instances")
    four = ["/tf", "/digests", "/stats/valid_share", "/world/map/elements", "/world/map/observations"]
    four += [f"/{IMAGE}/{field}" for field in ("rgb", "depth", "boxes", "query/things_that_moved", *fields)]
    four += [f"/world/map/{t}/{view}" for t in ("elements", "query/everything") for view in ("markers", "detections")]
    assert {topic: counts[topic] for topic in four} == dict.fromkeys(four, 4)
    once = [f"/{IMAGE}/{part}" for part in ("camera_info", "validity/labels", "instances/labels")]
    assert {topic: counts[topic] for topic in once} == dict.fromkeys(once, 1)
    assert counts["/world/map/elements/id_1/o"] == 2


@pytest.mark.parametrize("name", SCHEMAS)
def test_reruns_own_importer_shows_it(runs, name):
    from rerun.chunk import McapReader

    rows = Counter()
    for chunk in McapReader(str(runs[name])).stream():
        for column in chunk.to_record_batch().schema.names:
            rows[chunk.entity_path, column.split(":")[0]] += chunk.num_rows
    # Images of floats are depth to Rerun only from ROS. Annotations, scenes, detections, markers and our tables come as
    # columns that no view draws; JSON as bytes: no curves.
    image, scalar = ("DepthImage", "std_msgs.msg.Float64") if name == "ros2" else ("Image", "McapMessage")
    assert rows[f"/{IMAGE}/rgb", "EncodedImage"] >= 4
    assert rows["/tf", "Transform3D"] >= 4
    assert rows[f"/{IMAGE}/camera_info", "Pinhole"] and rows["/world/map/points", "Points3D"]
    assert min(rows[f"/{IMAGE}/{field}", image] for field in ("depth", "residual/d_m", "flow/tensor/u")) >= 4
    assert rows["/stats/valid_share", scalar] == 4


def test_foxglove_takes_the_json_schemas(runs):
    """It refuses a channel whose schema has arrays of arrays or several types, and text that is no strict JSON."""
    flat = {"boolean", "string", "number", "integer"}
    with runs["foxglove"].open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            if channel.message_encoding == "json" and schema.name != "vlmm_log.LabelNames":
                told, described = json.loads(message.data, parse_constant=pytest.fail), json.loads(schema.data)
                fields = described["properties"]
                assert {(f["items"] if f["type"] == "array" else f)["type"] for f in fields.values()} <= flat
                assert told.keys() == (fields.keys() | described.get("columns", {}).keys())


f32 = partial(np.array, dtype=np.float32)
NONE = np.zeros((0, 3), np.float32)
ODD = [
    entries.Table({"stage": ("input", "größe"), "xxh3": np.array([2**64 - 1, 2**63 + 1], np.uint64)}),
    entries.Table({"o": f32([np.nan, np.inf, -np.inf, 0.1, -0.0]), "x": np.full((5, 2), np.nan, np.float32)}),
    entries.Table({"i": np.array([2**62 + 1, -1]), "k": np.array([True, False]), "n": np.array([1, 2], np.int32)}),
    entries.Table({"element_id": np.zeros(0, np.int64), "name": (), "position": NONE}),
    *(entries.Scalar(x) for x in (np.nan, np.inf, 0.1)),
    entries.Boxes(np.zeros((0, 4), np.float32), np.zeros(0, np.int64), ()),
    entries.Boxes(f32([[-0.5, 3.5, 7.5, 9.5]] * 3), np.array([1, 2, 70000]), ("", "a b  c", "größe")),
    entries.Arrows(NONE[:, :2], NONE[:, :2]),
    entries.Cloud(NONE, NONE.astype(np.uint8), 0.1),
    entries.Cloud(f32([[0.1, np.nan, -3]]), np.array([[1, 2, 3]], np.uint8), 0.1),
    *(entries.DepthMap(np.array([[0, 1, 65535]], kind), 1000.0) for kind in (np.uint16, np.float32)),
    *(entries.Labels(np.array([[0, np.iinfo(kind).max]], kind)) for kind in (np.uint8, np.uint16)),
    entries.Pose(f32([0.1, 0, -1]), f32([0, 0, 0, 1])),  # not -0: Protobuf says nothing of zeros, whatever their sign
    entries.States(("moving", "moves")),
    entries.LogLine("größe", "WARN"),
]


@pytest.mark.parametrize("name", SCHEMAS)
def test_odd_values_come_back(tmp_path, name):
    run = Run("log", "own", vlmm_log.Settings().to_toml(), {}, False, "-y", ())
    file = McapFile(tmp_path / "a.mcap", run, load_dialect(name))
    for k, value in enumerate(ODD):
        file.put(entries.Entry(f"odd/{k}", value, 0, k))  # time 0: Protobuf says nothing of that, too
    file.finish(RunEnd(True, "", 1, 1))
    told, losses = read(tmp_path / "a.mcap")
    assert ([c for _, c in told], losses) == ([content(value) for value in ODD], ())


@pytest.mark.parametrize("name", ["ros2", "foxglove-dense"])
def test_what_was_cut_off_is_told_and_the_rest_read(runs, tmp_path, name):
    whole, (expected, _) = runs[name].read_bytes(), read(runs[name])
    ends, (data_end,) = ([stop for _, stop in records(runs[name], opcode)] for opcode in (0x06, 0x0F))
    shares = (int(len(whole) * share) for share in (0.3, 0.7))
    cuts = sorted({*ends[:12], *shares, ends[-1] - 1, data_end + 99, len(whole) - 1})  # within a first tensor, too
    seen = [cut_off(whole[:cut], expected, tmp_path / "cut.mcap") for cut in cuts]
    assert seen == sorted(seen)
    assert len(set(seen)) > 8
    assert seen[-3] < seen[-2] == seen[-1] == len(expected)
    (tmp_path / "cut.mcap").write_bytes(whole[:100])
    with pytest.raises(InputError, match="holds no settings or no entities"):
        open_recording(tmp_path / "cut.mcap")


def records(path, wanted):
    """Where the contents of a kind of record, outside chunks, start and end."""
    with path.open("rb") as file:
        return [(a, b) for opcode, a, b in top_records(file, path.stat().st_size) if opcode == wanted]


def cut_off(data, expected, path):
    """How many entries are read of a file that was cut off."""
    path.write_bytes(data)
    assert open_recording(path).losses
    told, losses = read(path)
    assert losses and told == expected[: len(told)]
    return len(told)


@pytest.mark.parametrize("name", SCHEMAS)
def test_a_flipped_byte_is_told_and_never_delivered(runs, tmp_path, name):
    path, whole, held = tmp_path / "a.mcap", runs[name].read_bytes(), grouped(read(runs[name])[0])
    chunks = records(runs[name], 0x06)
    places = [p for start, stop in chunks[1::3] for p in (start + 60, (start + stop) // 2, stop - 1)]
    start, _ = chunks[len(chunks) // 2]
    for at in (*places, start - 9, start - 8, start + 16, start + 24):  # also opcode, length, size and checksum
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 0x20]) + whole[at + 1 :])
        told, losses = read(path)
        unharmed = len(told) == sum(map(len, held.values()))  # LZ4 has bytes that decode alike: then nothing is lost
        assert bool(losses) != unharmed, at
        assert told
        assert all(value in held[key] for key, value in told)


@pytest.mark.parametrize("name", SCHEMAS)
def test_equal_runs_give_equal_messages_but_for_the_time_taken(room, runs, tmp_path, name):
    def messages(path):
        with path.open("rb") as file:
            told = [(c.topic, s.data, m) for s, c, m in make_reader(file).iter_messages(log_time_order=False)]
        return [(t, s, m.log_time, m.sequence, m.data) for t, s, m in told if not t.startswith("/stats/stage_ms/")]

    again = messages(processed(room, tmp_path / "again.mcap", name))
    assert len(again) > 150
    assert again == messages(runs[name])


def test_arrows_are_their_ends_to_the_bit():
    flow = np.random.default_rng(0).normal(size=(960, 1280, 2)).astype(np.float32) * np.float32(1e-5)
    origins, vectors = views.arrows(flow)
    ends = origins.astype(float) + vectors
    assert ((ends - origins).astype(np.float32) == vectors).all()
    assert np.abs(vectors - flow[8::16, 8::16].reshape(-1, 2)).max() < 1e-6
