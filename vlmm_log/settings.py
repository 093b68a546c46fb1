"""Every knob of a run: frozen, one dataclass a concern, from a profile, a TOML file and ``--set a.b=v``.

Profile ``paper`` does what the paper prints, ``default`` what measured better.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path

from vlmm_log.knobs import is_table, knob, nested, parse_set, read_toml, with_values, written
from vlmm_log.types import InputError

NO_OPTIONS: Mapping[str, object] = {}


@dataclass(frozen=True)
class ReadSettings:
    """How a log becomes frames."""

    topics: str = knob("", "of a bag: 'rgb=/a,depth=/b,info=/c,depth_info=/d,pose=/e'; what is not named is chosen")
    intrinsics: str = knob(
        "",
        "pinhole intrinsics: a camera.txt, 'fx,fy,cx,cy' px or freiburg1 to 3, bonn, icl, kinect; empty: the source's",
    )
    distortion: str = knob(
        "", "lens distortion to undo: 'k1,k2,p1,p2[,k3[,k4,k5,k6]]' as OpenCV orders them, or none; empty: the source's"
    )
    depth_units_per_meter: float = knob(0.0, "stored depth value of one metre; 0: as the source says", low=0)
    depth_min_m: float = knob(0.1, "nearer depth is unseen, m", low=0)
    depth_max_m: float = knob(10.0, "farther depth is unseen, m", low=0, high=math.inf)
    association_s: float = knob(
        0.02, "largest time between a colour image and its depth image, s", low=0, high=math.inf
    )
    pose_gap_s: float = knob(
        0.1, "largest time between the two poses that a frame's pose is taken from, s", low=0, high=math.inf
    )
    poses: str = knob(
        "camera_to_world",
        "what a listed pose maps; none: poses are not used",
        of=("camera_to_world", "world_to_camera", "none"),
    )
    quaternion: str = knob("xyzw", "order in which quaternions are listed", of=("xyzw", "wxyz"))
    camera_axes: str = knob(
        "optical",
        "axes of the listed frame: optical (x right, y down), body (x forward, z up), opengl (x right, y up)",
        of=("optical", "body", "opengl"),
    )
    pose_to_camera: str = knob(
        "", "camera in the tracked frame: none, bonn, icl or 'tx,ty,tz,qx,qy,qz,qw' m; empty: as the source says"
    )
    depth_to_rgb: str = knob(
        "",
        "depth camera in the colour camera's frame: 'tx,ty,tz,qx,qy,qz,qw' m, or registered; empty: the source's",
    )
    position_units_per_meter: float = knob(1.0, "listed position of one metre", low=1e-6)
    pose_offset_s: float = knob(0.0, "added to the stamps of poses, s", low=-10, high=10)
    depth_offset_s: float = knob(0.0, "added to the stamps of depth images, s", low=-10, high=10)
    depth_shift_px: str = knob("0,0", "'dx,dy': depth images are moved right and down by so many px")
    start_s: float = knob(0.0, "first moment used, s from the log's first frame", low=0, high=math.inf)
    stop_s: float = knob(1e9, "first moment no longer used, s from the log's first frame", low=0, high=math.inf)


@dataclass(frozen=True)
class KeyframeSettings:
    """Which frames are compared."""

    stride: int = knob(1, "every n-th frame starts a pair", low=1)
    gap: int | str = knob(3, "distance of a pair: frames (3) or seconds ('0.1s')", low=1, kinds=(int, str))


@dataclass(frozen=True)
class FlowSettings:
    """Dense optical flow."""

    estimator: str = knob("dis", "dis: OpenCV, no weights; raft: torchvision's raft_large", of=("dis", "raft"))
    dis_preset: str = knob("fast", "OpenCV's DIS preset", of=("ultrafast", "fast", "medium"))
    raft_scale: float = knob(0.5, "image scale that RAFT runs at", low=0.1, high=1)
    raft_updates: int = knob(8, "RAFT's iterations", low=1, high=64)
    weights: str = knob("", "RAFT weights file or a folder that holds it; empty: VLMM_LOG_WEIGHTS, user cache")


@dataclass(frozen=True)
class GateSettings:
    """Which pixels are scored."""

    fb_px: float = knob(2.0, "largest forward-backward error of the flow, px", low=0)
    depth_band: float = knob(
        0.05, "depth at b: neighbours within this share of the nearest one's depth are averaged; 0: nearest", low=0
    )
    occlusion_sigma: float = knob(
        3.0, "occluded: predicted depth in b this many sigmas behind the measured one; 0: never", low=0
    )
    occlusion_m: float = knob(0.3, "and at least this far behind it, m: an approaching mover is not occluded", low=0)


@dataclass(frozen=True)
class NoiseSettings:
    """Sigma of a match: depth noise, lateral noise, flow noise."""

    scale: float = knob(
        1.0, "factor on every sigma below; `process` prints the one that calibrates a still log", low=1e-6
    )
    sigma_z_a: float = knob(0.0012, "a in sigma_z = a + b (z - z0)^2, m (Nguyen, Izadi, Lovell 2012)", low=0)
    sigma_z_b: float = knob(0.0019, "b in sigma_z, 1/m", low=0)
    sigma_z_z0: float = knob(0.4, "z0 in sigma_z, m; the paper prints 0.4e-3", low=0)
    sigma_px_first: float = knob(0.15, "lateral noise at a, px", low=0)
    sigma_px_second: float = knob(0.15, "lateral noise at b, px", low=0)
    fb_variance: float = knob(0.3, "flow variance at b as a multiple of the squared forward-backward error", low=0)
    displacement: float = knob(
        0.0082, "lateral noise at b as a share of the flow's length: lens distortion, blur, time offset", low=0
    )
    edge_inflation: float = knob(0.4, "depth noise of this multiple of the local 3x3 depth range, in quadrature", low=0)
    flow_sigma: float = knob(
        3.5, "s_I, grey levels, of the texture's flow covariance s_I^2 (G - N + lambda I)^-1; 0: off", low=0
    )
    flow_lambda: float = knob(1.0, "lambda of the texture's flow covariance, grey levels^2/px^2", low=1e-6)
    grey_sigma: float = knob(1.0, "image noise, grey levels: the part N of G that is no texture; not scaled", low=0)
    flow_spread: float = knob(
        0.75,
        "flow noise at b as a share of the flow's own standard deviation over 36x36 px, camera's part removed",
        low=0,
    )
    alpha: float = knob(0.05, "share of still pixels that the test may flag", low=1e-9, high=0.999)


@dataclass(frozen=True)
class EgoSettings:
    """Ego-refinement."""

    model: str = knob(
        "row_linear",
        "off: trust the poses; rigid: RANSAC and least squares; row_linear: rigid and a twist linear in the image row",
        of=("off", "rigid", "row_linear"),
    )
    inlier: str = knob("sigma", "inlier test and weights: in sigmas of the match, or in metres", of=("sigma", "metric"))
    inlier_sigma: float = knob(3.0, "inlier threshold for 'sigma'", low=0.1)
    inlier_m: float = knob(0.02, "inlier threshold for 'metric', m", low=1e-6)
    stride: int = knob(4, "matches are taken at every n-th row and column", low=1)
    hypotheses: int = knob(256, "RANSAC hypotheses", low=1, high=100_000)
    sample: int = knob(2048, "matches that score a hypothesis", low=3)
    instance_share: float = knob(
        0.08, "no thing with a mask supplies more than this share of hypotheses and votes; 1: any", low=1e-3, high=1
    )
    iterations: int = knob(40, "refits at most", low=1, high=100)
    row_prior_rad: float = knob(0.05, "standard deviation of the row twist's rotation, rad", low=1e-9)
    row_prior_m: float = knob(0.05, "standard deviation of the row twist's translation, m", low=1e-9)
    min_matches: int = knob(200, "fewer: the pair is marked unreliable", low=3)
    min_inlier_share: float = knob(0.3, "less: the pair is marked unreliable", low=0, high=1)
    pose_sigma_rad: float = knob(
        0.01, "rotation noise of the log's relative pose, rad; in Sigma where it is not refined", low=0
    )
    pose_sigma_m: float = knob(
        0.01, "translation noise of the log's relative pose, m; in Sigma where it is not refined", low=0
    )


@dataclass(frozen=True)
class ObjectSettings:
    """Instances, and what a pair shows of each."""

    segmenter: str = knob("geometric", "geometric, yolo:FILE.onnx, masks:FOLDER or none")
    yolo_score: float = knob(0.25, "detections below it are dropped", low=0, high=1)
    yolo_iou: float = knob(0.7, "of two boxes of a class that overlap more, the better stays", low=0, high=1)
    yolo_names: str = knob("", "class names of the network, a text file, one a line; empty: from its metadata")
    embedder: str = knob("words", "words, clip, clip:WEIGHTS, maskclip or maskclip:WEIGHTS")
    crop_px: int = knob(640, "side that a region's crop is scaled to before the image encoder's own, px", low=32)
    prior: str = knob("table", "movability prior: table, or llm:URL of an OpenAI-compatible endpoint")
    llm_model: str = knob("gpt-4o-mini", "model that the endpoint is asked for")
    quantile: float = knob(0.75, "o: this quantile of d_M over an instance's scored pixels", low=0, high=1)
    coherence: str = knob(
        "flagged", "gamma over the pixels above tau_px, or over all scored ones", of=("flagged", "all")
    )
    min_scored: int = knob(30, "fewer scored pixels in a pair: no observation", low=1)


@dataclass(frozen=True)
class TrackSettings:
    """Which instance is which element. Identities of the source bypass it."""

    min_similarity: float = knob(0.3, "an assignment scores at least this, in [0, 1]", low=0, high=1)
    overlap_weight: float = knob(0.5, "weight of the mask carried by the flow (IoU)", low=0)
    position_weight: float = knob(0.25, "weight of the 3-D distance", low=0)
    feature_weight: float = knob(0.25, "weight of label and semantic feature", low=0)
    position_sigma_m: float = knob(0.1, "standard deviation of a centroid beyond the element's own extent, m", low=1e-6)
    drift_m_s: float = knob(0.5, "and it grows this fast while an element with a label is unseen, m/s", low=0)
    drift_most_m: float = knob(1.0, "and by this at most, m", low=0)
    forget_s: float = knob(60.0, "an element unseen for longer is not found again", low=0, high=math.inf)


@dataclass(frozen=True)
class MapSettings:
    """The persistent map and the fusion rule."""

    min_pixels: int = knob(150, "an element needs this many pixels in some keyframe", low=1)
    voxel_m: float = knob(0.05, "voxel of the background cloud, m", low=1e-3)
    o_unit: float = knob(2.027, "o is divided by it: 2.027 is that of a calibrated still element", low=1e-6)
    tau_o: float = knob(1.35, "moving: o above it", low=0)
    kappa_o: float = knob(0.3, "and kappa at least this", low=0, high=1)
    rho_tau: float = knob(0.55, "else movable: movability prior at least this", low=0, high=1)
    part: float = knob(
        0.1,
        "or, for an interval alone, a moving part larger than this share of the mask",
        low=0,
        high=1,
    )
    interval_pairs: int = knob(7, "a motion interval needs this many such pairs in a row (`moving`: one)", low=1)


@dataclass(frozen=True)
class CalibrationSettings:
    """From scores to probabilities."""

    file: str = knob("", "calibration that gives p_moving of pixels and elements, as `eval --calibrate` writes it")


@dataclass(frozen=True)
class QuerySettings:
    """Language."""

    parser: str = knob("default", "default, paper (the paper's keyword router) or llm:URL")
    threshold: float | str = knob(
        "auto",
        "theta_s, cosine from which a text names an element (0.4); auto: the embedder's",
        kinds=(float, str),
        low=0,
        high=1,
        of=("auto",),
    )
    near_m: float = knob(1.0, "what 'near' means, m", low=0)
    limit: int = knob(1000, "answers at most", low=1)


@dataclass(frozen=True)
class GridSettings:
    """How a map becomes an occupancy grid."""

    resolution_m: float = knob(0.05, "side of a cell, m", low=1e-3)
    low_m: float = knob(0.1, "what is lower above the floor is no obstacle, m", low=0)
    high_m: float = knob(2.0, "what is higher above the floor is no obstacle, m", low=0)
    floor: str = knob("auto", "height of the floor along the up axis, m; auto: the lowest layer that is dense")
    floor_share: float = knob(0.1, "dense: this share of the fullest layer's voxels", low=0, high=1)
    min_points: int = knob(1, "voxels of fewer points are left out", low=1)
    sigmas: float = knob(2.0, "an element covers so many standard deviations of its extent", low=0)
    max_cells: int = knob(2**24, "a larger grid is refused", low=1)


@dataclass(frozen=True)
class LogSettings:
    """What a recording holds."""

    dense: bool = knob(False, "full float32 tensors and covariances instead of the lean form")


@dataclass(frozen=True)
class Settings:
    """All of them."""

    profile: str = knob("default", "which values the others started from", of=("default", "paper"))
    seed: int = knob(0, "of all randomness", low=0, high=math.inf)
    read: ReadSettings = ReadSettings()
    keyframes: KeyframeSettings = KeyframeSettings()
    flow: FlowSettings = FlowSettings()
    gate: GateSettings = GateSettings()
    noise: NoiseSettings = NoiseSettings()
    ego: EgoSettings = EgoSettings()
    objects: ObjectSettings = ObjectSettings()
    tracks: TrackSettings = TrackSettings()
    map: MapSettings = MapSettings()
    calibration: CalibrationSettings = CalibrationSettings()
    query: QuerySettings = QuerySettings()
    grid: GridSettings = GridSettings()
    log: LogSettings = LogSettings()

    @staticmethod
    def load(
        profile: str | None = None,
        toml: Path | None = None,
        sets: Iterable[str] = (),
        options: Mapping[str, object] = NO_OPTIONS,
    ) -> Settings:
        """A profile, changed by a TOML file, by ``a.b=v`` texts, then by options: names ``a.b`` and their values.

        Raises InputError for a name that does not exist, a value of the wrong type or out of range.
        """
        tables = [] if toml is None else [(str(toml), read_toml(toml))]
        tables += [(f"--set {text}", parse_set(text)) for text in sets]
        tables += [("option", nested(name, value)) for name, value in options.items()]
        for where, table in tables:
            named = table.get("profile")
            if isinstance(named, str) and named != (profile or named):
                raise InputError(f"{where}: it sets profile {named!r}, another one says {profile!r}; keep one of them")
            profile = named if isinstance(named, str) else profile
        profile = profile or "default"
        if profile not in PROFILES:
            raise InputError(f"profile {profile!r}: no such profile; there are {', '.join(PROFILES)}")
        settings = PROFILES[profile]
        for where, table in tables:
            settings = with_values(settings, table, where)
        return settings

    @staticmethod
    def from_toml(text: str, where: str) -> Settings:
        """Settings of a TOML text, as ``to_toml`` gives it. Raises InputError, which names ``where``."""
        try:
            table = tomllib.loads(text)
        except (tomllib.TOMLDecodeError, RecursionError) as e:
            raise InputError(f"{where}: its settings are no TOML: {str(e)[:80]}") from e
        profile = table.get("profile", "default")
        if not isinstance(profile, str) or profile not in PROFILES:
            raise InputError(f"{where}: profile {profile!r}: no such profile; there are {', '.join(PROFILES)}")
        return with_values(PROFILES[profile], table, where)

    def changed(self, sets: Iterable[str]) -> Settings:
        """These settings with ``a.b=v`` texts applied. Raises InputError as ``load`` does."""
        settings = self
        for text in sets:
            settings = with_values(settings, parse_set(text), f"--set {text}")
        return settings

    def to_toml(self) -> str:
        """All settings as TOML that ``load`` takes back."""
        tops = [f"{f.name} = {written(getattr(self, f.name))}" for f in fields(self) if not is_table(self, f.name)]
        blocks = ["\n".join(tops)]
        for f in fields(self):
            if is_table(self, f.name):
                table = getattr(self, f.name)
                rows = [f"{g.name} = {written(getattr(table, g.name))}" for g in fields(table)]
                blocks.append("\n".join([f"[{f.name}]", *rows]))
        return "\n\n".join(blocks) + "\n"


PROFILES = {
    "default": Settings(),
    "paper": Settings(
        profile="paper",
        gate=GateSettings(depth_band=0.0, occlusion_sigma=0.0),
        noise=NoiseSettings(
            sigma_z_z0=0.0004,
            sigma_px_first=1.5,
            sigma_px_second=1.5,
            fb_variance=0.0,
            displacement=0.0,
            edge_inflation=0.0,
            flow_sigma=0.0,
            flow_spread=0.0,
        ),
        ego=EgoSettings(model="rigid", inlier="metric", instance_share=1.0),
        objects=ObjectSettings(coherence="all"),
        map=MapSettings(o_unit=1.0, tau_o=0.69, kappa_o=0.05, part=1.0, interval_pairs=1),
        query=QuerySettings(parser="paper"),
    ),
}
