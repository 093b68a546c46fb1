"""What a Rerun recording shows of one pair: images, flow, the motion channel."""

from __future__ import annotations

from typing import Literal

import cv2
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from vlmm_log.sinks import views
from vlmm_log.sinks.blueprint import IMAGE
from vlmm_log.types import FlowField, Frame, FramePair, Motion

LOOKS: dict[str, tuple[float, float, Literal["turbo", "viridis", "magma"]]] = {  # range and colours
    "residual/d_m": (0.0, 8.0, "turbo"),
    "residual/norm": (0.0, 0.3, "turbo"),
    "residual/sigma_z": (0.0, 0.1, "viridis"),
    "residual/p_stat": (0.0, 1.0, "viridis"),
    "flow/fb_error": (0.0, 2.0, "magma"),
}


def log_looks(rec: rr.RecordingStream) -> None:
    """Colours of the dense images, once."""
    for path, (low, high, colors) in LOOKS.items():
        look = rr.DepthImage.from_fields(meter=1.0, colormap=colors, depth_range=[low, high])
        rec.log(f"{IMAGE}/{path}", look, static=True)
    classes = [(int(v), v.name.lower(), color) for v, color in views.VALIDITY_COLORS.items()]
    rec.log(f"{IMAGE}/validity", rr.AnnotationContext(classes), static=True)


def log_images(rec: rr.RecordingStream, frame: Frame) -> None:
    """Colour and depth: the source's own bytes where it has them."""
    rgb, depth = frame.encoded_rgb, frame.encoded_depth
    if rgb is None:
        rec.log(f"{IMAGE}/rgb", rr.Image(frame.rgb).compress(jpeg_quality=90))
    else:
        rec.log(f"{IMAGE}/rgb", rr.EncodedImage(contents=rgb.data, media_type=rgb.media_type))
    if depth is None:
        millimetres = np.nan_to_num(frame.depth * np.float32(1e3)).astype(np.uint16)
        rec.log(f"{IMAGE}/depth", rr.DepthImage(millimetres, meter=1e3))
    else:
        encoded = rr.EncodedDepthImage(blob=depth.data, media_type=depth.media_type, meter=depth.units_per_meter)
        rec.log(f"{IMAGE}/depth", encoded)


def log_flow(rec: rr.RecordingStream, flow: FlowField, *, dense: bool) -> None:
    """Flow in colours, as arrows and as numbers, and its round-trip error."""
    _, jpeg = cv2.imencode(".jpg", views.flow_color(flow.forward)[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 85])
    rec.log(f"{IMAGE}/flow/color", rr.EncodedImage(contents=jpeg.tobytes(), media_type="image/jpeg"))
    origins, vectors = views.arrows(flow.forward)
    rec.log(f"{IMAGE}/flow/arrows", rr.Arrows2D(origins=origins, vectors=vectors))
    names = ["height", "width", "uv"]
    if dense:
        rec.log(f"{IMAGE}/flow/tensor", rr.Tensor(flow.forward, dim_names=names))
        rec.log(f"{IMAGE}/flow/fb_error", rr.DepthImage(flow.fb_error))
    else:
        rec.log(f"{IMAGE}/flow/tensor", rr.Tensor(views.half(flow.forward[::2, ::2]), dim_names=names))
        rec.log(f"{IMAGE}/flow/fb_error", rr.DepthImage(views.half(flow.fb_error[::2, ::2])))


def log_motion(rec: rr.RecordingStream, pair: FramePair, motion: Motion, *, dense: bool) -> None:
    """Scores, validity, residuals and their covariance."""
    path = f"{IMAGE}/residual"
    rec.log(f"{IMAGE}/validity", rr.SegmentationImage(motion.validity))
    thin = motion.covariances(1 if dense else 4)
    if dense:
        rec.log(f"{path}/d_m", rr.DepthImage(motion.d_m))
        rec.log(f"{path}/p_stat", rr.DepthImage(motion.p_stat))
        rec.log(f"{path}/norm", rr.DepthImage(motion.norm))
        rec.log(f"{path}/sigma_z", rr.DepthImage(thin.sigma_z))
        rec.log(f"{path}/tensor", rr.Tensor(motion.residual, dim_names=["xyz", "height", "width"]))
        covariance: NDArray[np.floating] = thin.upper
    else:
        rec.log(f"{path}/d_m", rr.DepthImage(views.half(motion.d_m)))
        rec.log(f"{path}/p_stat", rr.DepthImage(views.half(motion.p_stat[::2, ::2])))
        rec.log(f"{path}/norm", rr.DepthImage(views.half(motion.norm[::2, ::2])))
        rec.log(f"{path}/sigma_z", rr.DepthImage(views.half(thin.sigma_z)))
        covariance = views.half(thin.upper * 1e4)  # cm^2: metres squared underflow half precision
    rec.log(f"{path}/covariance", rr.Tensor(covariance, dim_names=["xx_xy_xz_yy_yz_zz", "height", "width"]))
    origins, vectors = views.moved_arrows(motion, pair.first, pair.second)
    rec.log(f"{path}/vectors", rr.Arrows2D(origins=origins, vectors=vectors, colors=[230, 159, 0]))
