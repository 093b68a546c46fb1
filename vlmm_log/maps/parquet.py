"""Maps as Parquet: a row an element, the observations as a list of structs, all else in the file's metadata.

Rows of what is too small to be an element yet have nulls for the fused part.
"""

from __future__ import annotations

import base64
import json
import zlib
from math import isnan
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from vlmm_log.background import Background
from vlmm_log.elements import OBSERVATION, Element, Evidence, MotionClass, Observations, WorldMap
from vlmm_log.maps.fields import Field, twice
from vlmm_log.maps.header import NAMES, check_version, header, read_header
from vlmm_log.maps.parquet_schema import CALIBRATED, OBSERVATIONS, SCALARS, schema
from vlmm_log.maps.saved import SavedMap
from vlmm_log.maps.seal import seal, sealed
from vlmm_log.types import Float32, InputError

KEY = b"vlmm-log map"
MOST_VALUES = 2**28  # of a column: a small file can ask for a large memory
MOST_VOXELS = 2**26
VOXEL = np.dtype([("cell", "<i4", 3), ("sum", "<i8", 4)])


def write(path: Path, saved: SavedMap) -> None:
    """Write a map that is ``checked``. Raises OSError, and UnicodeEncodeError for text that is none."""
    told = header(saved) | {"feature_width": saved.feature_width, "background": _packed(saved.world.background)}
    table = _table(saved)
    with path.open("wb") as f, pq.ParquetWriter(f, table.schema, compression="zstd") as writer:
        writer.write_table(table)
        writer.add_key_value_metadata({KEY: json.dumps(told, ensure_ascii=False).encode()})
    seal(path)


def read(path: Path) -> SavedMap:
    """A map, its types checked; ``checked`` looks at its values. Raises InputError."""
    data = sealed(path)
    try:
        file = pq.ParquetFile(pa.BufferReader(data), thrift_string_size_limit=2**30)
        top = _told(file, path)
        width = top.member("feature_width").integer()
        table = _checked_table(file, path, width)
    except (pa.ArrowException, OSError, UnicodeDecodeError) as e:
        first_line = (str(e).splitlines() or [type(e).__name__])[0]
        raise InputError(f"{path}: cannot be read as Parquet: {first_line[:200]}") from e
    *_, background = top.members((*NAMES, "feature_width", "background"))
    evidence = _evidence(table, width, path)
    world = WorldMap({e.id: e for e in evidence}, _elements(table, evidence, path), (_unpacked(background),))
    if len(world.evidence) < len(evidence):
        raise top.wrong(f"id: {twice(e.id for e in evidence)} stands there twice")
    return SavedMap(world, *read_header(top))


def _table(saved: SavedMap) -> pa.Table:
    """Elements by id, then the pending ones by id."""
    world, pending = saved.world, saved.pending
    elements = [world.elements[i] for i in sorted(world.elements)]
    evidence = [e.evidence for e in elements] + pending
    nulls = [None] * len(pending)
    scalars = SCALARS if all(isnan(e.p_moving) for e in elements) else CALIBRATED
    columns: dict[str, object] = {
        "id": [e.id for e in evidence],
        "position": [e.position for e in elements] + nulls,
        "extent": [e.extent for e in elements] + nulls,
        "motion_class": [MotionClass(e.motion_class).name for e in elements] + nulls,
        **{name: [getattr(e, name) for e in elements] + nulls for name in scalars},
        "intervals": [[tuple(span) for span in e.intervals.tolist()] for e in elements] + nulls,
        "votes": [sorted((name, int(n)) for name, n in e.votes.items()) for e in evidence],
        "feature_pixels": [e.feature_pixels for e in evidence],
        "feature_index": [e.feature_index for e in evidence],
        "semantic_feat": [e.feature for e in evidence],
        "observations": _observation_lists([e.observations for e in evidence]),
    }
    kinds = schema(saved.feature_width, scalars)
    arrays = [
        values if isinstance(values, pa.Array) else pa.array(values, kinds.field(name).type)
        for name, values in columns.items()
    ]
    return pa.Table.from_arrays(arrays, schema=kinds)


def _observation_lists(seen: list[Observations]) -> pa.Array:
    rows = np.concatenate([np.zeros(0, OBSERVATION), *seen])
    struct = OBSERVATIONS.value_type
    columns = []
    for field in struct:
        values = pa.array(np.ascontiguousarray(rows[field.name]).ravel())
        nested = pa.types.is_fixed_size_list(field.type)
        columns.append(pa.FixedSizeListArray.from_arrays(values, type=field.type) if nested else values)
    offsets = np.cumsum([0, *(len(o) for o in seen)], dtype=np.int32)
    return pa.ListArray.from_arrays(
        offsets, pa.StructArray.from_arrays(columns, fields=list(struct)), type=OBSERVATIONS
    )


def _told(file: pq.ParquetFile, path: Path) -> Field:
    """The file's own account, of a known version."""
    text = (file.metadata.metadata or {}).get(KEY)
    if text is None:
        raise InputError(f"{path}: is not a map of vlmm-log")
    try:
        top = Field(json.loads(text), path)
    except (ValueError, RecursionError) as e:
        raise InputError(f"{path}: metadata: is not JSON") from e
    check_version(top)
    return top


def _checked_table(file: pq.ParquetFile, path: Path, width: int) -> pa.Table:
    if not 0 <= width <= MOST_VALUES:
        raise InputError(f"{path}: feature_width: {width} is out of range")
    known = schema(width, CALIBRATED if "p_moving" in file.schema_arrow.names else SCALARS)
    for found, wanted in zip(file.schema_arrow, known, strict=False):
        if not found.equals(wanted):
            raise InputError(f"{path}: column {found.name}: is {found.type}, not {wanted.name}: {wanted.type}")
    if len(file.schema_arrow) != len(known):
        raise InputError(f"{path}: has {len(file.schema_arrow)} columns, not {len(known)}")
    groups = [file.metadata.row_group(i) for i in range(file.metadata.num_row_groups)]
    for k in range(file.metadata.num_columns):
        if sum(group.column(k).num_values for group in groups) > MOST_VALUES:
            raise InputError(f"{path}: column {file.metadata.schema.column(k).path}: more than {MOST_VALUES} values")
    table = file.read(use_threads=False).combine_chunks()
    table.validate(full=True)
    return table


def _array(column: pa.ChunkedArray) -> pa.Array:
    return column.combine_chunks() if column.num_chunks != 1 else column.chunk(0)


def _evidence(table: pa.Table, width: int, path: Path) -> list[Evidence]:
    flat: Float32 = np.array(_array(table["semantic_feat"]).flatten(), np.float32)
    if flat.size != table.num_rows * width:  # Parquet cannot say that a list is of length 0
        raise InputError(f"{path}: semantic_feat: not all have {width} numbers")
    features = flat.reshape(table.num_rows, width)
    seen = _array(table["observations"])
    rows = _observations(seen.flatten())
    counts = seen.value_lengths().to_numpy(zero_copy_only=False)
    ends = np.cumsum(counts, dtype=np.int64)
    ids, votes, pixels, indices = (table[n].to_pylist() for n in ("id", "votes", "feature_pixels", "feature_index"))
    by_label = [{vote["label"]: vote["thousandths"] for vote in row} for row in votes]
    for id_, row, labels in zip(ids, votes, by_label, strict=True):
        if len(labels) < len(row):
            raise InputError(f"{path}: element {id_}: votes: a label stands there twice")
    return [
        Evidence(
            id=ids[k],
            votes=by_label[k],
            observations=rows[ends[k] - counts[k] : ends[k]].copy(),
            feature=features[k].copy(),
            feature_pixels=pixels[k],
            feature_index=indices[k],
        )
        for k in range(table.num_rows)
    ]


def _observations(structs: pa.StructArray) -> Observations:
    rows = np.zeros(len(structs), OBSERVATION)
    for name in OBSERVATION.names or ():
        values = structs.field(name)
        shape = OBSERVATION[name].shape
        flat = values.flatten() if shape else values
        rows[name] = flat.to_numpy(zero_copy_only=False).reshape(-1, *shape)
    return rows


def _elements(table: pa.Table, evidence: list[Evidence], path: Path) -> dict[int, Element]:
    scalars = [name for name in CALIBRATED if name in table.column_names]
    names = ["position", "extent", "motion_class", *scalars, "intervals"]
    elements = {}
    for e, row in zip(evidence, table.select(names).to_pylist(), strict=True):
        missing = [name for name in names if row[name] is None]
        if len(missing) == len(names):
            continue
        if missing:
            raise InputError(f"{path}: element {e.id}: {missing[0]}: is null")
        if row["motion_class"] not in MotionClass.__members__:
            raise InputError(f"{path}: element {e.id}: motion_class: is none of {', '.join(MotionClass.__members__)}")
        elements[e.id] = Element(
            evidence=e,
            position=np.array(row["position"], np.float32),
            extent=np.array(row["extent"], np.float32),
            motion_class=MotionClass[row["motion_class"]],
            intervals=np.array([(s["start_ns"], s["stop_ns"]) for s in row["intervals"]], np.int64).reshape(-1, 2),
            **{name: row[name] for name in scalars},
        )
    return elements


def _packed(background: Background) -> dict[str, object]:
    rows = np.zeros(len(background.cells), VOXEL)
    rows["cell"], rows["sum"] = background.cells, background.sums
    data = base64.b64encode(zlib.compress(rows.tobytes()))
    return {"voxel_m": float(background.voxel_m), "voxels": len(rows), "zlib_base64": data.decode("ascii")}


def _unpacked(field: Field) -> Background:
    voxel_m, voxels, data = field.members(("voxel_m", "voxels", "zlib_base64"))
    if not 0 <= voxels.integer() <= MOST_VOXELS:
        raise voxels.wrong("is out of range")
    size = voxels.integer() * VOXEL.itemsize
    try:
        unpacked = zlib.decompressobj().decompress(base64.b64decode(data.text(), validate=True), size + 1)
    except (ValueError, zlib.error) as e:
        raise data.wrong("is not zlib in base64") from e
    if len(unpacked) != size:
        raise data.wrong(f"does not hold {voxels.integer()} voxels")
    rows = np.frombuffer(unpacked, VOXEL)
    return Background(voxel_m.number(), rows["cell"].astype(np.int32), rows["sum"].astype(np.int64))
