"""How a merged recording opens: A, B and their difference beside each other."""

from __future__ import annotations

import rerun.blueprint as rrb

from vlmm_log.sinks.pair_entries import IMAGE

FIELDS = {  # tab -> entity
    "validity": "validity",
    "flow": "flow/tensor",
    "sigma_z": "residual/sigma_z",
    "p_stat": "residual/p_stat",
    "|m|": "residual/norm",
    "depth": "depth",
}
PLOTS = ("flagged_share", "median_d_m", "valid_share", "inlier_share", "spread")


def merged_blueprint() -> rrb.Blueprint:
    """d_M and elements of both always in sight, the rest in tabs; plots of both, and what differs in words."""
    d_m = _beside("residual/d_m", "d_M")
    elements = rrb.Horizontal(
        *(_elements(side) for side in "AB"), _view("delta", "instances", "elements"), name="elements"
    )
    fields = [_beside(entity, name) for name, entity in FIELDS.items()]
    words = rrb.TextDocumentView(name="what differs", origin="diff")
    worlds = rrb.Horizontal(*(_world(side) for side in "AB"), name="world")
    plots = rrb.Tabs(*(_plot(name) for name in PLOTS))
    return rrb.Blueprint(
        rrb.Vertical(d_m, rrb.Tabs(elements, *fields, worlds), rrb.Horizontal(words, plots), row_shares=[3, 3, 2]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline="frame"),
        auto_views=False,
        auto_layout=False,
    )


def _beside(entity: str, name: str) -> rrb.Horizontal:
    pictured = "flow/color" if entity == "flow/tensor" else entity  # colours for the eye; the difference is in px
    views = [_view(side, pictured, name) for side in "AB"]
    return rrb.Horizontal(*views, _view("delta", entity, name), name=name)


def _view(side: str, entity: str, name: str) -> rrb.Spatial2DView:
    label = f"|A - B| {name}" if side == "delta" else f"{side} {name}"
    return rrb.Spatial2DView(name=label, origin=f"{side}/{IMAGE}/{entity}")


def _elements(side: str) -> rrb.Spatial2DView:
    image = f"{side}/{IMAGE}"
    contents = [f"{image}/{part}" for part in ("rgb", "instances", "boxes")]
    return rrb.Spatial2DView(name=f"{side} elements", origin=image, contents=contents)


def _world(side: str) -> rrb.Spatial3DView:
    world = f"{side}/world"
    parts = ("", "/camera", "/camera/image", "/camera/image/rgb", "/map/points", "/map/elements")
    return rrb.Spatial3DView(name=f"{side} world", origin=world, contents=[f"{world}{part}" for part in parts])


def _plot(name: str) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(name=name, origin="/", contents=[f"{side}/stats/{name}" for side in "AB"])
