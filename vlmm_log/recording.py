"""Recordings read back: the map that a run's observations make."""

from __future__ import annotations

import json
import warnings
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import rerun.chunk

from vlmm_log.background import Background, empty_background
from vlmm_log.elements import OBSERVATION, Evidence, Movability, WorldMap
from vlmm_log.maps.saved import SavedMap
from vlmm_log.pipeline.fusion import fuse
from vlmm_log.pipeline.world_map import merge_evidence
from vlmm_log.settings import MapSettings, Settings
from vlmm_log.types import Float32, Float64, InputError, Run, RunEnd, UInt16

OBSERVATIONS, FEATURES, ELEMENTS = "/world/map/observations", "/world/map/features", "/world/map/elements"
POINTS, CAMERA = "/world/map/points", "/world/camera"
RUN, END = "/__properties/vlmm", "/__properties/vlmm_end"
INSTANCES = "/world/camera/image/instances"
ENTITIES = [OBSERVATIONS, FEATURES, ELEMENTS, POINTS, CAMERA, RUN, END]


def read_map(path: Path) -> SavedMap:
    """The map of a recording, also of one whose writer was killed: then up to where it came.

    Its background has one point a voxel: a recording shows mean colours, not sums. Raises InputError where the file
    is no recording of this tool.
    """
    rows = _Rows.of(path)
    if not rows.run:
        raise InputError(f"{path}: not a recording of vlmm-log process: it holds no settings")
    run, settings = _run(path, rows.run)
    end = RunEnd(**rows.end) if rows.end else RunEnd(False, "", 0, len(rows.cameras))
    if not rows.cameras:
        raise InputError(f"{path}: the recording holds no pair")
    cameras = sorted(rows.cameras, key=lambda c: c[0])
    world = _world(rows, settings.map)
    return SavedMap(world, run, end, cameras[0][0], cameras[-1][1])


def read_masks(path: Path) -> Iterator[tuple[int, int, UInt16]]:
    """Every frame's index, stamp ns and instance masks (H, W), as they lie in the file: element ids, 0 for none."""
    for _, batch in _batches(path, [INSTANCES]):
        if "SegmentationImage:buffer" not in batch.schema.names:  # their names and colours
            continue
        for row in range(batch.num_rows):
            pixels, form = (_value(batch, f"SegmentationImage:{name}", row) for name in ("buffer", "format"))
            if pixels is not None:
                size = form[0]
                labels = np.frombuffer(pixels.tobytes(), np.uint16).reshape(size["height"], size["width"])
                yield _value(batch, "frame", row), _value(batch, "time", row), labels


@dataclass
class _Rows:
    """What is needed of a recording."""

    evidence: dict[int, list[Evidence]] = field(default_factory=dict)  # one observation each
    features: dict[tuple[int, int], Float32] = field(default_factory=dict)  # by element and frame
    priors: dict[str, Movability] = field(default_factory=dict)
    cloud: tuple[int, Float32, Any] | None = None  # time, centres, packed colours
    cameras: list[tuple[int, Float64]] = field(default_factory=list)  # time ns, T_world_cam
    run: dict[str, Any] = field(default_factory=dict)
    end: dict[str, Any] = field(default_factory=dict)

    @staticmethod
    def of(path: Path) -> _Rows:
        parts: dict[tuple[str, bytes], dict[str, Any]] = defaultdict(dict)  # a row's columns may lie in several chunks
        for entity, batch in _batches(path, ENTITIES):
            ids = batch.column("rerun.controls.RowId").to_pylist()
            for row, row_id in enumerate(ids):
                values = {name: _value(batch, name, row) for name in batch.schema.names}
                parts[entity, row_id].update({name: value for name, value in values.items() if value is not None})
        rows = _Rows()
        for (entity, _), values in parts.items():
            rows.add(entity, values)
        return rows

    def add(self, entity: str, row: dict[str, Any]) -> None:
        if entity == OBSERVATIONS and "element_id" in row:
            self._observe(row)
        elif entity == FEATURES and "feature" in row:
            vectors = row["feature"].reshape(len(row["element_id"]), -1)
            for i, vector in zip(row["element_id"].tolist(), vectors, strict=True):
                self.features[i, row["frame"]] = vector
        elif entity == ELEMENTS and "label" in row:
            for label, rho, source in zip(row["label"], row["rho"], row["rho_source"], strict=True):
                self.priors[str(label)] = Movability(float(rho), str(source))
        elif entity == CAMERA and "Transform3D:mat3x3" in row:
            T = np.eye(4)
            T[:3, :3] = row["Transform3D:mat3x3"].reshape(3, 3).T
            T[:3, 3] = row["Transform3D:translation"].ravel()
            self.cameras.append((row["time"], T))
        elif entity == POINTS and "Points3D:positions" in row:
            cloud = (row["time"], row["Points3D:positions"], row["Points3D:colors"])
            self.cloud = max(cloud, self.cloud or cloud, key=lambda c: len(c[1]))
        elif entity in (RUN, END):
            (self.run if entity == RUN else self.end).update({k: _plain(v[0]) for k, v in row.items()})

    def _observe(self, row: dict[str, Any]) -> None:
        n = len(row["element_id"])
        table = np.zeros(n, OBSERVATION)
        for name in OBSERVATION.names or ():
            table[name] = row[name].reshape(table[name].shape)
        for k in np.flatnonzero(row["observed"]).tolist():
            i, pixels, index = int(row["element_id"][k]), int(table["pixels"][k]), int(table["index"][k])
            votes = {str(row["name"][k]): round(1000 * float(row["detection_score"][k]))}
            one = Evidence(i, votes, table[k : k + 1], np.zeros(0, np.float32), pixels, index)
            self.evidence.setdefault(i, []).append(one)


def _batches(path: Path, entities: list[str]) -> Iterator[tuple[str, pa.RecordBatch]]:
    try:
        with warnings.catch_warnings(action="ignore"):  # that a killed writer left no footer, the map tells
            stream = rerun.chunk.RrdReader(path).stream()
        for chunk in stream.filter(content=entities):
            yield chunk.entity_path, chunk.to_record_batch()
    except (OSError, ValueError, RuntimeError) as e:
        remedy = (
            f"; if it was cut off: rerun rrd optimize {path} -o REPAIRED.rrd" if "exceeds file size" in str(e) else ""
        )
        raise InputError(f"{path}: cannot be read as a Rerun recording: {str(e)[-120:]}{remedy}") from e


def _value(batch: pa.RecordBatch, name: str, row: int) -> Any:
    """One cell: a time as an integer, a component as an array of its values; None where there is none."""
    if name == "rerun.controls.RowId":
        return None
    cell = batch.column(name)
    if pa.types.is_timestamp(cell.type) or pa.types.is_integer(cell.type):
        return cell.cast("int64")[row].as_py()
    values = cell[row].values
    if values is None:
        return None
    while pa.types.is_fixed_size_list(values.type) or pa.types.is_list(values.type):
        values = values.flatten()
    return values.to_numpy(zero_copy_only=False)


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value


def _run(path: Path, row: dict[str, Any]) -> tuple[Run, Settings]:
    try:
        settings = Settings.from_toml(row["settings"], str(path))
        run = Run(
            row["source"],
            row["reader"],
            row["settings"],
            json.loads(row["versions"]),
            bool(row["has_poses"]),
            row["world_up"],
            tuple(json.loads(row["notes"])),
        )
    except (KeyError, ValueError) as e:
        raise InputError(f"{path}: its properties are not those of this version: {e}; process the log again") from e
    return run, settings


def _world(rows: _Rows, s: MapSettings) -> WorldMap:
    evidence = {}
    unknown = np.zeros(next((len(f) for f in rows.features.values()), 0), np.float32)  # cut off before it was written
    for i, seen in sorted(rows.evidence.items()):
        whole = seen[0]
        for one in seen[1:]:
            whole = merge_evidence(whole, one)
        feature = rows.features.get((i, whole.feature_index), unknown)
        evidence[i] = Evidence(i, whole.votes, whole.observations, feature, whole.feature_pixels, whole.feature_index)
    background = _background(rows, s.voxel_m)
    bare = WorldMap(evidence, {}, (background,), tuple(evidence))
    return fuse(bare, lambda label: rows.priors.get(label, Movability(0.5, "unknown")), s)


def _background(rows: _Rows, voxel_m: float) -> Background:
    if rows.cloud is None:
        return empty_background(voxel_m)
    cells = np.floor(rows.cloud[1].reshape(-1, 3) / voxel_m).astype(np.int32)
    packed = rows.cloud[2].astype(np.int64)
    sums = np.stack([np.ones_like(packed), packed >> 24 & 255, packed >> 16 & 255, packed >> 8 & 255], axis=1)
    return Background(voxel_m, cells, sums)
