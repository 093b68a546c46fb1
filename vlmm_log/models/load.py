"""The models that settings name."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from importlib import metadata

from vlmm_log.calibration import Calibration
from vlmm_log.models.curves import load_curves, origin
from vlmm_log.models.embedders import load_embedder
from vlmm_log.models.feature_cache import FeatureCache
from vlmm_log.models.prior import LlmPrior, load_prior
from vlmm_log.models.segmenters import load_segmenter
from vlmm_log.protocols import Embedder, FlowEstimator, Models, MovabilityPrior
from vlmm_log.settings import FlowSettings, Settings


def load_models(s: Settings) -> tuple[Models, dict[str, str]]:
    """The models, and the versions and fingerprints of all that decides their results.

    Raises InputError where a package or weights are missing, and for a calibration that was fitted otherwise.
    """
    calibration, of_curves = load_curves(s)
    flow, of_flow = _load_flow(s.flow)
    segment, of_segments = load_segmenter(s.objects)
    embed, of_features = load_embedder(s.objects)
    prior, of_prior = load_prior(s.objects, embed)
    reports = tuple(_reports(embed, prior, calibration))
    models = Models(flow, segment, embed, prior, reports, calibration)
    return models, of_flow | of_segments | of_features | of_prior | of_curves


def _reports(embed: Embedder, prior: MovabilityPrior, calibration: Calibration | None) -> Iterator[Callable[[], str]]:
    if calibration is not None:
        yield lambda: origin(calibration)
    if isinstance(prior, LlmPrior):
        yield lambda: f"movability endpoint {prior.endpoint.where}: {prior.endpoint.cost}"
    cache = getattr(embed, "cache", None)
    if isinstance(cache, FeatureCache):
        yield lambda: f"feature cache: {cache}"


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
