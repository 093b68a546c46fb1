"""Map files: without loss, the same bytes for the same map, and one line for whatever is none."""

import dataclasses
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from known_maps import (
    bits,
    element,
    evidence,
    kitchen,
    observations,
    saved,
    saved_maps,
    singles,
    world,
)
from vlmm_log.background import Background
from vlmm_log.elements import OBSERVATION, MotionClass, columns
from vlmm_log.maps import load_map, save_map
from vlmm_log.maps.json import shortest
from vlmm_log.maps.parquet_schema import schema
from vlmm_log.maps.seal import seal
from vlmm_log.types import InputError

FORMATS = ["json", "parquet"]
files_in_a_folder = settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])


def written(folder, saved_map, suffix):
    path = folder / f"map.{suffix}"
    save_map(path, saved_map, force=True)
    return path


def refused(path):
    """The one line with which loading fails."""
    with pytest.raises(InputError) as e:
        load_map(path)
    assert "\n" not in str(e.value)
    assert str(e.value).startswith(f"{path}: ")
    return str(e.value).removeprefix(f"{path}: ")


# ---- without loss


@files_in_a_folder
@given(saved_maps())
@example(kitchen())
@example(saved())
@example(saved(world([element(1, seen=observations(2, first_ns=[-(2**63), 2**63 - 1]))])))
def test_a_map_comes_back_to_the_bit_and_in_the_same_bytes(tmp_path, saved_map):
    as_json = written(tmp_path, saved_map, "json")
    first = as_json.read_bytes()
    as_parquet = written(tmp_path, saved_map, "parquet")
    for path in (as_json, as_parquet):
        loaded = load_map(path)
        assert bits(loaded) == bits(saved_map)
        loaded.world.columns  # noqa: B018  a map that loads can be used
        assert written(tmp_path, loaded, "json").read_bytes() == first


@pytest.mark.parametrize("suffix", FORMATS)
def test_equal_maps_are_equal_bytes_whatever_their_order(tmp_path, suffix):
    there = kitchen()
    turned = dataclasses.replace(
        there,
        world=dataclasses.replace(
            there.world,
            elements=dict(reversed(there.world.elements.items())),
            evidence=dict(reversed(there.world.evidence.items())),
            touched=(4,),
        ),
        run=dataclasses.replace(there.run, versions=dict(reversed(there.run.versions.items()))),
    )
    assert written(tmp_path, there, suffix).read_bytes() == written(tmp_path, turned, suffix).read_bytes()


@given(st.lists(singles, min_size=1))
@example([0.1, -0.0, 1e-45, 3.4028235e38, 16777216.0, 1e5, 9.999999e-5, 117.122696, 0.0146721825])
def test_the_shortest_number_gives_the_float32_back_and_is_short(values):
    exact = np.array(values, np.float32)
    numbers = shortest(exact)
    assert numbers.astype(np.float32).tobytes() == exact.tobytes()
    usual = (np.abs(exact) > 1e-15) & (np.abs(exact) < 1e15)
    for number, x in zip(numbers[usual].tolist(), exact[usual], strict=True):
        assert len(repr(number)) <= max(len(repr(float(str(x)))), len(str(x)))


def test_numbers_of_numpy_s_own_types_are_written_as_python_s(tmp_path):
    there = kitchen()
    door = dataclasses.replace(there.world.elements[7], o=np.float32(0.1), motion_class=2)
    seen = {**there.world.elements, 7: door}
    turned = dataclasses.replace(there, world=dataclasses.replace(there.world, elements=seen), origin_ns=np.int64(5))
    for suffix in FORMATS:
        loaded = load_map(written(tmp_path, turned, suffix))
        assert (loaded.world.elements[7].o, loaded.origin_ns) == (float(np.float32(0.1)), 5)
        assert loaded.world.elements[7].motion_class is MotionClass.MOVING


def test_a_loaded_map_can_be_read_as_columns(tmp_path):
    for suffix in FORMATS:
        loaded = load_map(written(tmp_path, kitchen(), suffix)).world
        assert bits(loaded.columns) == bits(columns(kitchen().world.elements.values()))
        assert loaded.touched == ()


# ---- what a reader of the file finds


def test_json_bears_the_paper_s_names(tmp_path):
    lines = written(tmp_path, kitchen(), "json").read_text("utf-8").splitlines()
    top = json.loads("\n".join(lines))
    assert (top["format"], top["version"]) == ("vlmm-log map", 1)
    door = top["elements"][1]
    assert sum(line.startswith('{"id":') for line in lines) == 4  # a line each, for grep and diff
    assert (door["label"], door["position"], door["motion_class"]) == ("door", [2.0, 0.0, 1.0], "MOVING")
    assert {"o": 3.5, "kappa": 0.7, "p_stat": 0.25}.items() <= door["observed_motion"].items()
    assert door["movability_prior"] == {"rho": 0.1, "source": "table: AI2-THOR"}
    assert door["observations"]["o"] == [9.5, 8.25, 7.1, 1.5, 2.0]
    assert door["semantic_feat"]["dtype"] == "<f4"
    assert [small["id"] for small in top["pending"]] == [2**62]


def test_other_tools_read_the_parquet(tmp_path):
    import pyarrow.parquet as pq

    table = pq.read_table(written(tmp_path, kitchen(), "parquet"))
    assert table["label"].to_pylist()[:2] == ["mug", "door"]
    assert table["motion_class"].to_pylist() == ["MOVABLE_STATIC", "MOVING", "STATIC", None]
    assert [round(row["o"], 5) for row in table["observations"].to_pylist()[1]] == [9.5, 8.25, 7.1, 1.5, 2.0]


def test_version_1_holds_these_fields():
    """Another set of fields is another version: change ``VERSION`` with this."""
    seen = "first_ns second_ns index pixels scored o phi gamma kappa gamma_all part position extent drift"
    assert " ".join(OBSERVATION.names) == seen
    names = "id position extent motion_class label o kappa p_stat score speed rho rho_source confidence intervals"
    assert " ".join(schema(2).names) == f"{names} votes feature_pixels feature_index semantic_feat observations"


# ---- files


@pytest.mark.parametrize("suffix", FORMATS)
def test_an_existing_file_is_replaced_only_with_force(tmp_path, suffix):
    path = tmp_path / "new" / f"map.{suffix}"
    save_map(path, kitchen(), force=False)
    before = path.read_bytes()
    with pytest.raises(InputError, match="exists; give --force"):
        save_map(path, saved(), force=False)
    assert path.read_bytes() == before
    save_map(path, saved(), force=True)
    assert path.read_bytes() != before
    assert [p.name for p in path.parent.iterdir()] == [path.name]
    left = path.with_name(path.name + ".partial")  # of a killed process
    left.write_text("")
    path.unlink()
    with pytest.raises(InputError, match="partial: exists; give --force"):
        save_map(path, saved(), force=False)


@pytest.mark.parametrize("suffix", [*FORMATS, "ply"])
def test_what_fails_half_way_replaces_nothing_and_leaves_nothing(tmp_path, suffix, monkeypatch):
    path = tmp_path / f"map.{suffix}"
    path.write_bytes(b"before")

    def full(partial, _):
        partial.write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(f"vlmm_log.maps.{suffix}.write", full)
    with pytest.raises(InputError, match=r"map\.\w+: cannot be written: No space left on device"):
        save_map(path, kitchen(), force=True)
    assert path.read_bytes() == b"before"
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("suffix", [*FORMATS, "ply"])
def test_a_full_disk_is_one_line(tmp_path, suffix):
    """A file-size limit fails as a full disk does: each writer for itself has to tell."""
    if suffix == "ply":
        pytest.importorskip("open3d", reason="PLY needs the extra 'sim'")
    code = (
        "import resource, signal, sys; from pathlib import Path; sys.path.insert(0, sys.argv[2])\n"
        "from known_maps import background, saved, world; import numpy as np\n"
        "from vlmm_log.maps import save_map; from vlmm_log.types import InputError\n"
        "voxels = background(np.random.default_rng(0).uniform(-9, 9, (20000, 3)))\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "path = Path(sys.argv[1])\n"
        "if path.suffix == '.ply': import open3d\n"
        "else: import pyarrow.parquet\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (20000, 20000))\n"
        "try: save_map(path, saved(world(voxels=voxels)), force=False)\n"
        "except InputError as e: print('told:', e)\n"
    )
    path = tmp_path / f"map.{suffix}"
    tests = str(Path(__file__).parent)
    done = subprocess.run([sys.executable, "-c", code, path, tests], capture_output=True, text=True, check=False)
    assert done.stdout.startswith(f"told: {path}: cannot be written: "), done.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["map.rrd", "map", "map.json.gz"])
def test_a_suffix_that_is_none(tmp_path, name):
    with pytest.raises(InputError, match=r"\.json, \.parquet or \.ply"):
        save_map(tmp_path / name, saved(), force=False)
    assert ".json or .parquet" in refused(tmp_path / name)


def test_paths_that_cannot_be_used(tmp_path):
    (tmp_path / "a.json").mkdir()
    (tmp_path / "b").write_text("")
    (tmp_path / "a.parquet").mkdir()
    assert "Is a directory" in refused(tmp_path / "a.json")
    assert "Is a directory" in refused(tmp_path / "a.parquet")
    assert "No such file" in refused(tmp_path / "c.parquet")
    assert "only to look at" in refused(tmp_path / "c.ply")
    for path in (tmp_path / "a.json", tmp_path / "b" / "c.json", tmp_path / f"{'x' * 300}.json", tmp_path / "\0.json"):
        with pytest.raises(InputError, match=r"^[^\n]+$"):
            save_map(path, saved(), force=True)


# ---- what no map may hold is told before anything is written


def _with(**changes):
    return saved(world([dataclasses.replace(element(3), **changes)]))


def _voxels(voxel_m, cells, sums):
    cells, sums = np.array(cells, np.int32).reshape(-1, 3), np.array(sums, np.int64).reshape(-1, 4)
    return saved(world(voxels=Background(voxel_m, cells, sums)))


@pytest.mark.parametrize(
    ("broken", "told"),
    [
        (_with(score=float("nan")), "element 3: score: is not finite"),
        (_with(position=np.array([0, np.inf, 0], np.float32)), "element 3: position: is not finite"),
        (saved(world([element(3, seen=observations(2, o=np.nan))])), "element 3: observations.o: not all"),
        (saved(world([element(3, seen=observations(0))])), "element 3: observations: there is none"),
        (saved(world([element(3, seen=observations(3)[::-1].copy())])), "first_ns: is not in time order"),
        (saved(world([element(-1)])), "element -1: id: is negative"),
        (saved(world([element(3), element(4, feature=(1,))])), "element 4: semantic_feat: has 1 numbers, another"),
        (saved(world(pending=[evidence(3, feature=(np.nan,))])), "element 3: semantic_feat: not all"),
        (saved(world([element(3, "\ud800")])), "a name in the map is no Unicode text: "),
        (saved(world_up="up"), "run.world_up: is none of +z, -z, +y, -y, +x, -x"),
        (saved(T_world_cam=np.full((4, 4), np.nan)), "T_world_cam: is not 4 x 4 finite"),
        (_voxels(0.0, [], []), "background.voxel_m: is not a positive number"),
        (
            _voxels(1.0, [[0, 0, 0]] * 2, [[1, 0, 0, 0]] * 2),
            "background.cells: are not in lexicographic order, each once",
        ),
        (_voxels(1.0, [[0, 1, 0], [0, 0, 9]], [[1, 0, 0, 0]] * 2), "background.cells: are not in lexicographic order"),
        (_voxels(1.0, [[0, 0, 0]], [[1, 0, 256, 0]]), "background.sums: no colour has these sums"),
        (_voxels(1.0, [[0, 0, 0]], [[0, 0, 0, 0]]), "background.sums: no colour has these sums"),
    ],
)
@pytest.mark.parametrize("suffix", FORMATS)
def test_what_no_map_may_hold(tmp_path, broken, told, suffix):
    path = tmp_path / f"map.{suffix}"
    with pytest.raises(InputError) as e:
        save_map(path, broken, force=False)
    assert str(e.value).startswith(f"{path}: ")
    assert told in str(e.value)
    assert not path.exists()


# ---- bad JSON


def edited(tmp_path, edit):
    """The kitchen's document, changed in place by ``edit`` and written again."""
    path = written(tmp_path, kitchen(), "json")
    document = json.loads(path.read_text("utf-8"))
    edit(document)
    path.write_text(json.dumps(document), "utf-8")
    return path


def test_an_unedited_document_is_a_map(tmp_path):
    assert bits(load_map(edited(tmp_path, lambda d: None))) == bits(kitchen())


def door(d):
    return d["elements"][1]


@pytest.mark.parametrize(
    ("edit", "told"),
    [
        (lambda d: d.update(version=2), "is version 2 of the map format, this vlmm-log reads version 1"),
        (lambda d: d.update(version="1"), "version: is a text, not an integer"),
        (lambda d: d.update(version=True), "version: is a truth value, not an integer"),
        (lambda d: d.update(format="x"), "is not a map of vlmm-log"),
        (lambda d: d.pop("run"), "lacks 'run'"),
        (lambda d: d.update(more=1), "has a field 'more' that this version does not know"),
        (lambda d: door(d).pop("label"), "elements[1]: lacks 'label'"),
        (lambda d: door(d).update(label=None), "elements[1].label: is null, not a text"),
        (lambda d: door(d).update(label="\ud800"), "elements[1].label: is no Unicode text"),
        (lambda d: door(d).update(id=4), "elements, pending: id 4 stands there twice"),
        (lambda d: door(d).update(id=2**63), "elements[1].id: an integer has more than 64 bits"),
        (lambda d: door(d).update(id=1.0), "elements[1].id: is a number, not an integer"),
        (lambda d: door(d).update(id=-1), "element -1: id: is negative"),
        (lambda d: door(d).update(position=[0, 1]), "elements[1].position: has 2 numbers, not 3"),
        (lambda d: door(d).update(position=[0, 1, "2"]), "elements[1].position: not all of it are numbers"),
        (lambda d: door(d).update(position=[0, 1, 1e39]), "element 7: position: is not finite"),
        (lambda d: door(d).update(confidence=10**400), "elements[1].confidence: a number is too large"),
        (lambda d: door(d).update(confidence=3.5e38), "element 7: confidence: is not finite, or too large"),
        (lambda d: door(d).update(feature_pixels=2**31), "element 7: feature_pixels, feature_index: one is"),
        (lambda d: door(d).update(confidence=float("nan")), "is not JSON: NaN is no number"),
        (lambda d: door(d).update(motion_class="FLYING"), "motion_class: is none of STATIC, MOVABLE_STATIC, MOVING"),
        (lambda d: door(d).update(votes={}), "element 7: votes: there is none"),
        (lambda d: door(d).update(votes={"door": -1}), "element 7: votes: "),
        (lambda d: door(d).update(votes={"do\nor": "1"}), "elements[1].votes.do or: is a text, not an integer"),
        (lambda d: door(d)["observed_motion"].update(o=None), "elements[1].observed_motion.o: is null, not a number"),
        (lambda d: door(d)["observed_motion"].update(intervals=[[1]]), "intervals: is not a list of rows of 2"),
        (lambda d: door(d)["observations"]["o"].pop(), "elements[1].observations.o: has 4 rows, first_ns has 5"),
        (lambda d: door(d)["observations"].pop("phi"), "elements[1].observations: lacks 'phi'"),
        (lambda d: door(d)["observations"].update(index=[2**31] * 5), "index: an integer has more than 32 bits"),
        (lambda d: door(d)["semantic_feat"].update(base64="AAAAA"), "semantic_feat.base64: is not base64 of <f4"),
        (lambda d: door(d)["semantic_feat"].update(base64="AAAA"), "semantic_feat.base64: is not base64 of <f4"),
        (lambda d: door(d)["semantic_feat"].update(base64="\xe4"), "semantic_feat.base64: is not base64 of <f4"),
        (lambda d: door(d)["semantic_feat"].update(base64="!AAAAAAAAAAA="), "is not base64 of <f4"),
        (lambda d: door(d)["semantic_feat"].update(dtype="O"), "semantic_feat.dtype: is 'O', not '<f4'"),
        (lambda d: d["background"]["x"].pop(), "background: x, y, z, points, red, green, blue are not equally many"),
        (lambda d: d.update(T_world_cam=[[1, 0, 0, 0]]), "T_world_cam: is not 4 x 4"),
        (lambda d: d.update(elements={}), "elements: is an object, not a list"),
        (lambda d: d["run"]["versions"].update({"\udfff": "1"}), "run.versions: is no Unicode text"),
        (lambda d: d["run"].update(notes=[1]), "run.notes[0]: is an integer, not a text"),
    ],
)
def test_a_document_that_is_no_map(tmp_path, edit, told):
    assert told in refused(edited(tmp_path, edit))


@pytest.mark.parametrize(
    ("data", "told"),
    [
        (b"", "is not JSON: Expecting value"),
        (b"[]", "is not a map of vlmm-log"),
        (b"\xff\xfe", "no UTF-8 at byte 0"),
        (b"[" * 10**6, "nested too deep"),
        (b'{"a":' * 10**6, "nested too deep"),
        (b"9" * 10**5, "is not JSON: Exceeds the limit"),
        (b'{"format":"vlmm-log map","format":"vlmm-log map"}', "'format' stands twice"),
        (b'{"format":"vlmm-log map"}', "lacks 'version'"),
    ],
)
def test_bytes_that_are_no_document(tmp_path, data, told):
    path = tmp_path / "map.json"
    path.write_bytes(data)
    assert told in refused(path)


def test_a_file_too_large_for_json_is_told_before_it_is_read(tmp_path):
    path = tmp_path / "map.json"
    with path.open("wb") as f:
        f.truncate(2**31 + 1)  # takes no room on the disk
    assert "larger than 2.1 GB; keep a map of this size as .parquet" in refused(path)


# ---- bad Parquet


def rewritten(path, change, metadata=None):
    """The file with its table changed, its own metadata kept or replaced."""
    import pyarrow.parquet as pq

    from vlmm_log.maps.parquet import KEY

    told = metadata or pq.ParquetFile(path).metadata.metadata[KEY]
    table = change(pq.read_table(path))
    with pq.ParquetWriter(path, table.schema) as writer:
        writer.write_table(table)
        writer.add_key_value_metadata({KEY: told})
    seal(path)
    return path


def _null_label(table):
    import pyarrow as pa

    labels = pa.array([None, *table["label"].to_pylist()[1:]])
    return table.set_column(table.schema.names.index("label"), "label", labels)


def _o_as_float32(table):
    at = table.schema.names.index("o")
    return table.set_column(at, "o", table["o"].cast("float32"))


def _twice(table):
    import pyarrow as pa

    return pa.concat_tables([table, table])


def _one_label_two_votes(table):
    import pyarrow as pa

    at = table.schema.names.index("votes")
    votes = [[*v, v[0]] for v in table["votes"].to_pylist()]
    return table.set_column(at, table.schema.field(at), pa.array(votes, table.schema.field(at).type))


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda t: t.drop_columns(["votes"]), "column feature_pixels: is int64, not votes"),
        (lambda t: t.drop_columns(["observations"]), "has 18 columns, not 19"),
        (_o_as_float32, "column o: is float, not o: double"),
        (_null_label, "element 4: label: is null"),
        (_twice, "stands there twice"),
        (_one_label_two_votes, "element 4: votes: a label stands there twice"),
    ],
)
def test_a_table_that_is_no_map(tmp_path, change, told):
    path = written(tmp_path, kitchen(), "parquet")
    assert bits(load_map(rewritten(path, lambda t: t))) == bits(kitchen())
    assert told in refused(rewritten(path, change))


@pytest.mark.parametrize(
    ("edit", "told"),
    [
        (lambda d: d.update(version=2), "is version 2 of the map format"),
        (lambda d: d.update(feature_width=3), "column semantic_feat: is fixed_size_list"),
        (lambda d: d.update(feature_width=10**12), "feature_width: 1000000000000 is out of range"),
        (lambda d: d["background"].update(voxels=39), "background.zlib_base64: does not hold 39 voxels"),
        (lambda d: d["background"].update(voxels=2**40), "background.voxels: is out of range"),
        (lambda d: d["background"].update(zlib_base64="AAAA"), "background.zlib_base64: is not zlib in base64"),
        (lambda d: d.pop("end"), "lacks 'end'"),
    ],
)
def test_metadata_that_is_none_of_a_map(tmp_path, edit, told):
    import pyarrow.parquet as pq

    path = written(tmp_path, kitchen(), "parquet")
    document = json.loads(pq.ParquetFile(path).metadata.metadata[b"vlmm-log map"])
    edit(document)
    assert told in refused(rewritten(path, lambda t: t, json.dumps(document).encode()))


def test_features_where_the_file_says_there_are_none(tmp_path):
    import pyarrow as pa

    path = written(tmp_path, saved(world([element(1, feature=())])), "parquet")
    kind = schema(0).field("semantic_feat")

    def longer(table):
        at = table.schema.names.index("semantic_feat")
        return table.set_column(at, kind, pa.array([[1.0]], kind.type))

    assert refused(rewritten(path, longer)) == "semantic_feat: not all have 0 numbers"


@pytest.mark.parametrize("data", [b"", b"PAR1", b"PAR1" * 3, b"\xff" * 100])
def test_bytes_that_are_no_parquet(tmp_path, data):
    path = tmp_path / "map.parquet"
    path.write_bytes(data)
    assert "no Parquet file that vlmm-log wrote" in refused(path)


def test_another_table_is_no_map(tmp_path):
    import pyarrow as pa
    import pyarrow.parquet as pq

    path = tmp_path / "map.parquet"
    pq.write_table(pa.table({"a": [1]}), path)
    assert "no Parquet file that vlmm-log wrote" in refused(path)
    seal(path)
    assert refused(path) == "is not a map of vlmm-log"
    assert pq.read_table(path)["a"].to_pylist() == [1]


def test_a_small_file_that_asks_for_a_large_memory(tmp_path, monkeypatch):
    path = written(tmp_path, kitchen(), "parquet")
    monkeypatch.setattr("vlmm_log.maps.parquet.MOST_VALUES", 8)
    assert bits(load_map(written(tmp_path, saved(), "parquet"))) == bits(saved())
    path = written(tmp_path, kitchen(), "parquet")
    assert refused(path) == "column position.list.element: more than 8 values"


# ---- damage


@pytest.fixture(scope="module")
def originals(tmp_path_factory):
    folder = tmp_path_factory.mktemp("originals")
    return {suffix: written(folder, kitchen(), suffix).read_bytes() for suffix in FORMATS}


def test_any_damage_to_parquet_is_told(tmp_path, originals):
    """Arrow aborts the process over some damaged footers: it must never see one."""
    path, data = tmp_path / "map.parquet", originals["parquet"]
    for at in {*range(0, len(data), 5), *range(len(data) - 200, len(data))}:
        path.write_bytes(data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :])
        assert "checksum" in refused(path)
    for length in range(0, len(data), 7):
        path.write_bytes(data[:length])
        assert "checksum" in refused(path)


def loads_or_is_told(path):
    try:
        loaded = load_map(path)
    except InputError as e:
        assert "\n" not in str(e)
        assert str(path) in str(e)
        return False
    loaded.world.columns  # noqa: B018  a map that loads can be used
    return True


changed_bytes = st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(0, 255)), min_size=1, max_size=4)


@settings(max_examples=400, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(flips=changed_bytes, cut=st.floats(0.2, 5))
def test_damaged_json_is_told_or_harmless(tmp_path, originals, flips, cut):
    data = bytearray(originals["json"])
    for where, value in flips:
        data[int(where * len(data))] = value
    path = tmp_path / "map.json"
    path.write_bytes(data[: int(min(cut, 1) * len(data))])
    loads_or_is_told(path)


def places(value, here=()):
    """Paths to every value of a document."""
    yield here
    inside = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, v in inside:
        yield from places(v, (*here, key))


anything = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=6,
)


@settings(max_examples=400, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_an_edited_document_is_told_or_a_map(tmp_path, originals, data):
    document = json.loads(originals["json"])
    *above, last = data.draw(st.sampled_from([p for p in places(document) if p]))
    inside = document
    for key in above:
        inside = inside[key]
    if data.draw(st.booleans()):
        inside[last] = data.draw(anything)
    else:
        del inside[last]
    path = tmp_path / "map.json"
    path.write_text(json.dumps(document), "utf-8")
    if loads_or_is_told(path):  # then it is a map in full: it can be written and is the same again
        loaded = load_map(path)
        assert bits(load_map(written(tmp_path, loaded, "parquet"))) == bits(loaded)


# ---- PLY


@pytest.fixture(scope="module")
def o3d():
    return pytest.importorskip("open3d", reason="PLY needs the extra 'sim'")


def test_ply_holds_the_voxels_and_the_ellipsoids_in_their_colours(tmp_path, o3d):
    axes = np.linalg.qr(np.arange(9).reshape(3, 3) ** 1.5 + 1)[0]
    shape = axes * [0.04, 0.01, 0.0025] @ axes.T  # m^2
    there = saved(
        world(
            [
                element(5, position=(1, 2, 3), extent=shape[np.triu_indices(3)], motion_class=MotionClass.MOVING),
                element(6, position=(-4, 0, 0)),
            ],
            voxels=kitchen().world.background,
        )
    )
    cloud = o3d.t.io.read_point_cloud(str(written(tmp_path, there, "ply")))
    points, colors = cloud.point.positions.numpy(), cloud.point.colors.numpy()
    ids, classes = cloud.point.element_id.numpy()[:, 0], cloud.point.motion_class.numpy()[:, 0]
    voxels = there.world.background
    np.testing.assert_array_equal(points[ids == -1], voxels.points)
    np.testing.assert_array_equal(colors[ids == -1], voxels.colors)
    assert set(classes[ids == -1]) == {255}
    assert set(map(tuple, colors[ids == 5])) == {(213, 94, 0)}
    assert set(map(tuple, colors[ids == 6])) == {(0, 114, 178)}
    away = (points[ids == 5] - [1, 2, 3]) @ axes / np.sqrt([0.04, 0.01, 0.0025])
    np.testing.assert_allclose(np.linalg.norm(away, axis=1), 2, atol=1e-4)  # two sigmas
    np.testing.assert_allclose(np.ptp(away, axis=0), 4, atol=0.05)  # on all sides
    assert not set(tmp_path.iterdir()) - {tmp_path / "map.ply"}


def test_an_empty_map_makes_no_ply(tmp_path, o3d):
    with pytest.raises(InputError, match="kitchen: its map has neither voxels nor elements"):
        save_map(tmp_path / "map.ply", saved(), force=False)
    assert not list(tmp_path.iterdir())


def test_without_open3d_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(InputError, match=r"needs Open3D: pip install 'vlmm-log\[sim\]'"):
        save_map(tmp_path / "map.ply", kitchen(), force=False)
