"""What a recording shows of one pair: images, flow, the motion channel."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from vlmm_log import rvl, se3
from vlmm_log.entries import Arrows, Camera, DepthMap, LabelNames, Labels, Picture, Pose, Raster, Scalar, Steps, Value
from vlmm_log.sinks import views
from vlmm_log.types import Ego, Float32, Float64, FlowField, Frame, FramePair, Judgement, Motion, Posterior

IMAGE = "world/camera/image"
VECTORS = f"{IMAGE}/residual/vectors"
TRUTH, OUTCOME = f"{IMAGE}/truth", f"{IMAGE}/outcome"
JUDGED_NAMES: Mapping[str, LabelNames] = {  # of what only judged runs hold
    TRUTH: LabelNames(tuple((v, name, color) for v, (name, color) in views.TRUTH_COLORS.items())),
    OUTCOME: LabelNames(
        tuple((int(o), o.name.lower().replace("_", " "), color) for o, color in views.OUTCOME_COLORS.items())
    ),
}
Range = tuple[float, float, Literal["viridis", "magma"]]
LOOKS: Mapping[str, Range] = {  # range and colours of dense fields: told apart also by the colour-blind
    f"{IMAGE}/depth": (0.0, 5.0, "viridis"),
    f"{IMAGE}/residual/d_m": (0.0, 8.0, "magma"),
    f"{IMAGE}/residual/norm": (0.0, 0.3, "magma"),
    f"{IMAGE}/residual/sigma_z": (0.0, 0.1, "viridis"),
    f"{IMAGE}/residual/p_stat": (0.0, 1.0, "viridis"),
    f"{IMAGE}/flow/fb_error": (0.0, 2.0, "magma"),
    f"{IMAGE}/residual/p_moving": (0.0, 1.0, "magma"),
    f"{IMAGE}/score": (0.0, 8.0, "magma"),
}
D_M_STEP = FB_STEP = 2.0**-6  # sigmas, px
P_MOVING_STEP = 2.0**-10  # most pixels are unlikely to move
NORM_STEP = 2.0**-13  # m
COVARIANCE = ("xx", "xy", "xz", "yy", "yz", "zz")
MOVED = (230, 159, 0)
MOST_MM = 65535

Named = tuple[str, Value]
"""An entity and its value."""


def of_camera(frame: Frame) -> Camera:
    """The pinhole camera of a frame."""
    return Camera(frame.K.astype(np.float32), frame.rgb.shape[1], frame.rgb.shape[0])


def of_pose(T_world_cam: Float64) -> Pose:
    """A camera's pose (4, 4) in single precision."""
    return Pose(T_world_cam[:3, 3].astype(np.float32), se3.quaternion(T_world_cam).astype(np.float32))


def of_images(frame: Frame) -> Iterator[Named]:
    """Colour and depth: the source's own bytes where it has them."""
    rgb, depth = frame.encoded_rgb, frame.encoded_depth
    if rgb is None:
        yield f"{IMAGE}/rgb", Picture(_jpeg(frame.rgb, 90), "image/jpeg")
    else:
        yield f"{IMAGE}/rgb", Picture(rgb.data, rgb.media_type)
    if depth is None:
        yield f"{IMAGE}/depth", _depth(frame.depth)
    else:
        yield f"{IMAGE}/depth", DepthMap(depth, depth.units_per_meter)


def _depth(depth: Float32) -> DepthMap:
    """In whole millimetres; as it is where 16 bits do not hold them."""
    if np.nanmax(depth, initial=0.0) > MOST_MM / 1e3:
        return DepthMap(depth, 1.0)
    return DepthMap(np.nan_to_num(depth * np.float32(1e3)).astype(np.uint16), 1e3)


def of_flow(flow: FlowField, *, dense: bool) -> Iterator[Named]:
    """Flow in colours, as arrows and as numbers, and its round-trip error."""
    yield f"{IMAGE}/flow/color", Picture(_jpeg(views.flow_color(flow.forward), 85), "image/jpeg")
    yield f"{IMAGE}/flow/arrows", Arrows(*views.arrows(flow.forward))
    planar = np.moveaxis(flow.forward, -1, 0)
    if dense:
        yield f"{IMAGE}/flow/tensor", Raster(np.ascontiguousarray(planar), ("u", "v"))
        yield f"{IMAGE}/flow/fb_error", Raster(flow.fb_error)
    else:
        yield f"{IMAGE}/flow/tensor", Raster(views.half(planar[:, ::4, ::4]), ("u", "v"))  # as coarse as DIS is
        yield f"{IMAGE}/flow/fb_error", _steps(flow.fb_error[::2, ::2], FB_STEP)


def of_ego(ego: Ego) -> Iterator[Named]:
    """Figures of the camera's motion: shares, sigmas, rad and m."""
    yield "stats/inlier_share", Scalar(ego.inlier_share)
    yield "stats/spread", Scalar(ego.spread)
    for name, twist in (("ego", ego.correction), ("row", ego.row_twist)):
        yield f"stats/{name}_rotation", Scalar(float(np.linalg.norm(twist[:3])))
        yield f"stats/{name}_translation", Scalar(float(np.linalg.norm(twist[3:])))


def of_motion(pair: FramePair, motion: Motion, *, dense: bool) -> Iterator[Named]:
    """Scores, validity, residuals and their covariance."""
    yield "stats/valid_share", Scalar(motion.valid_share)
    if motion.valid_share:
        yield "stats/median_d_m", Scalar(float(np.sqrt(motion.static_d_m2_median)))
        yield "stats/flagged_share", Scalar(motion.flagged_share)
        yield "stats/median_residual", Scalar(motion.median_norm)
    path = f"{IMAGE}/residual"
    yield f"{IMAGE}/validity", Labels(motion.validity)
    if dense:
        full = motion.covariances(1)
        yield f"{path}/tensor", Raster(motion.residual, ("x", "y", "z"))
        yield f"{path}/d_m", Raster(motion.d_m)
        yield f"{path}/p_stat", Raster(motion.p_stat)
        yield f"{path}/norm", Raster(motion.norm)
        yield f"{path}/sigma_z", Raster(full.sigma_z)
        yield f"{path}/covariance", Raster(full.upper, COVARIANCE)
    else:
        thin = motion.covariances(4)
        yield f"{path}/d_m", _steps(motion.d_m, D_M_STEP)
        yield f"{path}/p_stat", Raster(views.half(motion.p_stat[::4, ::4]))
        yield f"{path}/norm", _steps(motion.norm[::2, ::2], NORM_STEP)
        yield f"{path}/sigma_z", Raster(views.half(thin.sigma_z))
        cm2 = views.half(thin.upper[:, ::2, ::2], 1e4)  # metres squared underflow half precision
        yield f"{path}/covariance", Raster(cm2, COVARIANCE)
    yield VECTORS, Arrows(*views.moved_arrows(motion, pair.first, pair.second), color=MOVED)


def of_posterior(posterior: Posterior, *, dense: bool) -> Iterator[Named]:
    """How likely each pixel moved."""
    p = posterior.p_moving
    yield f"{IMAGE}/residual/p_moving", Raster(p) if dense else _steps(p[::2, ::2], P_MOVING_STEP)


def of_judgement(judgement: Judgement, *, dense: bool) -> Iterator[Named]:
    """The truth, what became of each pixel, the score that was judged, and the pair's metrics."""
    yield TRUTH, Labels(judgement.truth)
    yield OUTCOME, Labels(judgement.outcome)
    yield f"{IMAGE}/score", Raster(judgement.score if dense else views.half(judgement.score))
    yield from ((f"metrics/{name}", Scalar(float(value))) for name, value in judgement.figures.items())


def _steps(field: Float32, step: float) -> Steps:
    return Steps(rvl.encode_steps(field, step), step)


def _jpeg(rgb: NDArray[np.uint8], quality: int) -> bytes:
    _, file = cv2.imencode(".jpg", rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])
    return file.tobytes()
