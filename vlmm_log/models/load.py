"""The models that settings name."""

from __future__ import annotations

from importlib import metadata

from vlmm_log.models.embedders import load_embedder
from vlmm_log.models.prior import load_prior
from vlmm_log.models.segmenters import load_segmenter
from vlmm_log.protocols import FlowEstimator, Models
from vlmm_log.settings import FlowSettings, Settings


def load_models(s: Settings) -> tuple[Models, dict[str, str]]:
    """The models, and the versions and fingerprints of all that decides their results.

    Raises InputError where a package or weights are missing.
    """
    flow, of_flow = _load_flow(s.flow)
    segment, of_segments = load_segmenter(s.objects)
    embed, of_features = load_embedder(s.objects)
    prior, of_prior = load_prior(s.objects, embed)
    return Models(flow, segment, embed, prior), of_flow | of_segments | of_features | of_prior


def _load_flow(s: FlowSettings) -> tuple[FlowEstimator, dict[str, str]]:
    if s.estimator == "dis":
        from vlmm_log.models.dis import Dis

        return Dis(s), {}
    from vlmm_log.models.weights import find_raft

    find_raft(s.weights)  # before torch, whose import takes seconds
    from vlmm_log.models.raft import Raft

    raft = Raft(s)
    versions = {name: metadata.version(name) for name in ("torch", "torchvision")}
    return raft, versions | {"weights": raft.fingerprint}
