"""The map that a recording's observations make."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from vlmm_log.background import Background, empty_background
from vlmm_log.elements import OBSERVATION, Element, Evidence, Movability, WorldMap
from vlmm_log.entries import Cloud, Column, Labels, Pose, Table, Value
from vlmm_log.maps.saved import SavedMap
from vlmm_log.pipeline.fusion import fuse
from vlmm_log.pipeline.world_map import merge_evidence
from vlmm_log.recording import open_recording
from vlmm_log.se3 import from_quaternion
from vlmm_log.settings import MapSettings, Settings
from vlmm_log.types import Float32, Float64, InputError, RunEnd, UInt16

OBSERVATIONS, FEATURES, ELEMENTS = "world/map/observations", "world/map/features", "world/map/elements"
POINTS, CAMERA = "world/map/points", "world/camera"
INSTANCES = "world/camera/image/instances"


def read_map(path: Path) -> SavedMap:
    """The map of a recording, also of one whose writer was killed: then up to where it came.

    Its background has one point a voxel: a recording shows mean colours, not sums. Raises InputError where the file
    is no recording of this tool.
    """
    recording = open_recording(path)
    rows = _Rows()
    for entry in recording.entries([OBSERVATIONS, FEATURES, ELEMENTS, POINTS, CAMERA]):
        rows.add(entry.entity, entry.value, entry.stamp_ns or 0, entry.index or 0)
    end = recording.end or RunEnd(False, "", 0, len(rows.cameras))
    if not rows.cameras:
        raise InputError(f"{path}: the recording holds no pair")
    cameras = sorted(rows.cameras, key=lambda c: c[0])
    settings = Settings.from_toml(recording.run.settings, str(path))
    world = _world(rows, settings.map)
    return SavedMap(world, recording.run, end, cameras[0][0], cameras[-1][1])


def read_masks(path: Path) -> Iterator[tuple[int, int, UInt16]]:
    """Every frame's index, stamp ns and instance masks (H, W), as they lie in the file: element ids, 0 for none."""
    for entry in open_recording(path).entries([INSTANCES]):
        if isinstance(entry.value, Labels) and entry.stamp_ns is not None and entry.index is not None:
            yield entry.index, entry.stamp_ns, np.asarray(entry.value.values, np.uint16)


@dataclass
class _Rows:
    """What is needed of a recording."""

    evidence: dict[int, list[Evidence]] = field(default_factory=dict)  # one observation each
    features: dict[tuple[int, int], Float32] = field(default_factory=dict)  # by element and frame
    priors: dict[str, Movability] = field(default_factory=dict)
    probabilities: dict[int, tuple[int, float]] = field(default_factory=dict)  # of calibrated elements: see _judge
    cloud: tuple[int, Cloud] | None = None  # time, the largest
    cameras: list[tuple[int, Float64]] = field(default_factory=list)  # time ns, T_world_cam

    def add(self, entity: str, value: Value, stamp_ns: int, index: int) -> None:
        """Take a value of one of the entities that make the map."""
        match value:
            case Pose(translation, quaternion):
                self.cameras.append((stamp_ns, from_quaternion(translation.astype(float), quaternion.astype(float))))
            case Cloud():
                if self.cloud is None or len(value.points) >= len(self.cloud[1].points):
                    self.cloud = (stamp_ns, value)
            case Table(columns) if len(value):
                {OBSERVATIONS: self._observe, FEATURES: self._describe, ELEMENTS: self._judge}[entity](columns, index)
            case _:
                pass

    def _describe(self, columns: Mapping[str, Column], index: int) -> None:
        vectors = np.asarray(columns["feature"]).reshape(len(columns["element_id"]), -1)
        for i, vector in zip(np.asarray(columns["element_id"]).tolist(), vectors, strict=True):
            self.features[i, index] = vector

    def _judge(self, columns: Mapping[str, Column], _: int) -> None:
        for label, rho, source in zip(*(columns[name] for name in ("label", "rho", "rho_source")), strict=True):
            self.priors[str(label)] = Movability(float(rho), str(source))
        names = ("element_id", "observations", "p_moving")
        if "p_moving" in columns:  # kept with the number of observations behind it
            for i, seen, p in zip(*(np.asarray(columns[name]).tolist() for name in names), strict=True):
                if seen >= self.probabilities.get(i, (0, 0.0))[0]:
                    self.probabilities[i] = int(seen), float(p)

    def _observe(self, columns: Mapping[str, Column], _: int) -> None:
        ids = np.asarray(columns["element_id"])
        table = np.zeros(ids.size, OBSERVATION)
        for name in OBSERVATION.names or ():
            table[name] = np.asarray(columns[name]).reshape(table[name].shape)
        for k in np.flatnonzero(columns["observed"]).tolist():
            i, pixels, index = int(ids[k]), int(table["pixels"][k]), int(table["index"][k])
            votes = {str(columns["name"][k]): round(1000 * float(columns["detection_score"][k]))}
            one = Evidence(i, votes, table[k : k + 1], np.zeros(0, np.float32), pixels, index)
            self.evidence.setdefault(i, []).append(one)


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
    fused = fuse(bare, lambda label: rows.priors.get(label, Movability(0.5, "unknown")), s)
    return replace(fused, elements={i: _calibrated(e, rows) for i, e in fused.elements.items()})


def _calibrated(e: Element, rows: _Rows) -> Element:
    """With the probability that the run gave it: its curves need not be at hand. NaN where it was cut off before."""
    seen, p_moving = rows.probabilities.get(e.id, (0, float("nan")))
    return replace(e, p_moving=p_moving) if seen == e.evidence.observations.size else e


def _background(rows: _Rows, voxel_m: float) -> Background:
    if rows.cloud is None:
        return empty_background(voxel_m)
    cloud = rows.cloud[1]
    cells = np.floor(cloud.points / voxel_m).astype(np.int32)
    sums = np.hstack([np.ones((len(cells), 1), np.int64), cloud.colors.astype(np.int64)])
    return Background(voxel_m, cells, sums)
