"""All baselines of a log."""

from __future__ import annotations

from vlmm_log.evaluation.baselines.dewan import DewanStyle
from vlmm_log.evaluation.baselines.displacement import NoUncertainty, RawDisplacement
from vlmm_log.evaluation.baselines.khronos import KhronosStyle
from vlmm_log.evaluation.baselines.protocol import Baseline
from vlmm_log.evaluation.baselines.semantic import (
    ConceptGraphsStyle,
    DualMapStyle,
    SemanticOnly,
    VlMapsStyle,
    VoxelandStyle,
)
from vlmm_log.protocols import Models
from vlmm_log.settings import Settings


def all_baselines(s: Settings, models: Models) -> list[Baseline]:
    """Each with nothing seen yet, by a trial's settings and models."""
    embedder = s.objects.embedder.partition(":")[0]
    return [
        RawDisplacement(),
        NoUncertainty(s, models.prior),
        SemanticOnly(models.embed, embedder),
        VlMapsStyle(models.embed),
        ConceptGraphsStyle(models.embed),
        DualMapStyle(models.embed),
        VoxelandStyle(models.prior),
        DewanStyle(models.prior),
        KhronosStyle(),
    ]
