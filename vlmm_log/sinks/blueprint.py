"""How a recording opens in the Rerun viewer."""

from __future__ import annotations

from collections.abc import Sequence

import rerun.blueprint as rrb

from vlmm_log.sinks.legend import LEGEND
from vlmm_log.sinks.pair_entries import IMAGE

CALIBRATED = ("residual/p_moving",)
JUDGED = ("outcome", "truth", "score")


def default_blueprint(images: Sequence[str] = ()) -> rrb.Blueprint:
    """The world, the images, the motion channel, plots and the log; a tab for each image that few recordings hold."""
    # A depth image under a pinhole is back-projected into any 3-D view that includes it, d_M too: name them all.
    space = rrb.Spatial3DView(
        name="world",
        origin="world",
        contents=[
            "world",
            "world/camera",
            IMAGE,
            f"{IMAGE}/rgb",
            f"{IMAGE}/depth",
            "world/map/points",
            "world/map/elements",
            "world/map/query/**",
        ],
    )
    motion = rrb.Horizontal(_objects(), _image("validity", "validity"), _image("flow", "flow/color"))
    noise = rrb.Horizontal(
        _image("sigma_z", "residual/sigma_z"),
        _image("p_stat", "residual/p_stat"),
        _image("|m|", "residual/norm"),
        name="noise",
    )
    more = rrb.Horizontal(
        _image("depth", "depth"), _image("forward-backward error", "flow/fb_error"), _flow_arrows(), name="input"
    )
    legend = rrb.Spatial2DView(name="legend", origin=LEGEND)
    few = [_image(path.rsplit("/", 1)[-1], path) for path in images]
    numbers = rrb.Tabs(
        rrb.StateTimelineView(name="elements: class, and moves or still", origin="world/map/elements"),
        rrb.TimeSeriesView(name="o of elements, sigmas", origin="world/map/elements", contents="$origin/*/o"),
        rrb.DataframeView(name="map", origin="world/map/elements", contents=["world/map/elements"]),
        rrb.TimeSeriesView(
            name="shares",
            origin="stats",
            contents=["stats/inlier_share", "stats/valid_share", "stats/flagged_share"],
        ),
        rrb.TimeSeriesView(name="sigmas", origin="stats", contents=["stats/median_d_m", "stats/spread"]),
        rrb.TimeSeriesView(
            name="ego", origin="stats", contents=["stats/ego_rotation", "stats/ego_translation", "stats/row_rotation"]
        ),
        rrb.TimeSeriesView(name="stage ms", origin="stats/stage_ms"),
        rrb.TextLogView(name="log", origin="log"),
        rrb.TextDocumentView(name="run", origin="run"),
    )
    rgb = rrb.Tabs(
        rrb.Spatial2DView(name="rgb", origin=IMAGE, contents=[f"{IMAGE}/rgb", f"{IMAGE}/residual/vectors"]),
        rrb.Spatial2DView(name="query hits", origin=IMAGE, contents=[f"{IMAGE}/rgb", f"{IMAGE}/query/**"]),
    )
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(space, rgb, _image("d_M", "residual/d_m")),
            motion,
            rrb.Horizontal(rrb.Tabs(legend, noise, *few, more), numbers),
            row_shares=[5, 5, 4],  # on a laptop, images are as wide as their views
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline="frame"),
        auto_views=False,
        auto_layout=False,
    )


def _image(name: str, path: str) -> rrb.Spatial2DView:
    return rrb.Spatial2DView(name=name, origin=f"{IMAGE}/{path}")


def _objects() -> rrb.Spatial2DView:
    return rrb.Spatial2DView(
        name="elements", origin=IMAGE, contents=[f"{IMAGE}/rgb", f"{IMAGE}/instances", f"{IMAGE}/boxes"]
    )


def _flow_arrows() -> rrb.Spatial2DView:
    return rrb.Spatial2DView(name="flow arrows", origin=IMAGE, contents=[f"{IMAGE}/rgb", f"{IMAGE}/flow/arrows"])
