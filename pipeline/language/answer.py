"""The executor: a query over the map's columns, its answers ranked and each with its reason."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from vlmm_log.elements import Elements
from vlmm_log.pipeline.language.explain import explain, in_words
from vlmm_log.pipeline.language.judge import distances, judge
from vlmm_log.pipeline.language.scene import Scene, values
from vlmm_log.pipeline.language.truth import Truth
from vlmm_log.queries import Answer, Order, Query, View
from vlmm_log.query_tree import Compare, Named, Near, Node, Side, walk
from vlmm_log.settings import MapSettings, QuerySettings
from vlmm_log.types import Float32, InputError, Int64

BLOCK = 512  # rows
TextFeatures = Callable[[Sequence[str]], Float32]


def answer(
    query: Query,
    elements: Elements,
    features: TextFeatures,
    s: QuerySettings,
    map_settings: MapSettings,
    view: View,
    theta_s: float,
) -> Answer:
    """The elements that a query asks for (paper, eq. "query"), extended by the tree.

    ``features`` gives the (m, D) unit features of texts, ``theta_s`` is their embedder's threshold, used where
    ``s.threshold`` is auto. Answers are ranked by the query's order, else by how well the filter holds (see ``judge``);
    ties by id. Raises InputError where texts and map have features of different widths.
    """
    texts = sorted({n.text for root in _roots(query) for n, _ in walk(root) if isinstance(n, Named)})
    scene = Scene(
        elements,
        _similarities(texts, elements, features),
        theta_s if isinstance(s.threshold, str) else s.threshold,
        s.near_m,
        map_settings,
        view.T_world_cam,
        view.up,
        view.origin_ns if view.origin_ns is not None else int(elements.first_ns.min(initial=2**62)),
    )
    truth = judge(query.filter, scene)
    scores, why_score = _scores(query.order, truth, scene)
    matching = np.flatnonzero(truth.yes)
    rows = matching[np.isfinite(scores[matching])]
    kept = _best(rows, scores, query.order, elements.ids, min(query.limit or s.limit, s.limit))
    notes = [
        *_notes(query, scene),
        *_left_out(query.order, matching.size - rows.size),
        *_ties(query.order, scores[rows], scores[kept]),
    ]
    return Answer(
        query.text,
        "; ".join([explain(query), *notes]),
        query.returns,
        elements.ids[kept],
        scores[kept].astype(np.float32),
        tuple(", ".join(filter(None, (truth.why(i), why_score(i)))) or "every element" for i in kept.tolist()),
        matches=int(rows.size),
    )


def _roots(query: Query) -> list[Node]:
    return [query.filter, *([query.order.target] if query.order and query.order.target else [])]


def _similarities(texts: Sequence[str], elements: Elements, features: TextFeatures) -> dict[str, Float32]:
    """Cosine (n,) of every element with each text; NaN where element or text has no feature (all zeros)."""
    if not texts or not len(elements):
        return {text: np.zeros(len(elements), np.float32) for text in texts}
    wanted = np.asarray(features(texts), np.float32)
    if wanted.shape != (len(texts), elements.features.shape[1]):
        raise InputError(
            f"query: the embedder gives features {wanted.shape[-1]} wide, the map's are {elements.features.shape[1]}; "
            "ask with the embedder that the map was made with"
        )
    found = {}
    for text, feature, similarity in zip(texts, wanted, _products(wanted, elements.features), strict=True):
        exact = np.flatnonzero(similarity == 0)  # unrelated, or no feature at all
        similarity[exact[~elements.features[exact].any(axis=1)]] = np.nan
        found[text] = similarity if feature.any() else np.full_like(similarity, np.nan)
    return found


def _products(texts: Float32, features: Float32) -> Float32:
    """(m, n) dot products, in blocks that stay in the cache whatever the number of texts."""
    out = np.empty((len(texts), len(features)), np.float32)
    with np.errstate(all="ignore"):  # what is not finite compares as unknown
        for i in range(0, len(features), BLOCK):
            out[:, i : i + BLOCK] = texts @ features[i : i + BLOCK].T
    return out


def _scores(order: Order | None, truth: Truth, scene: Scene) -> tuple[Float32, Callable[[int], str]]:
    """What answers are ranked by (n,); NaN where unknown."""
    if order is None:
        return truth.strength, lambda row: ""  # noqa: ARG005
    if order.field == "distance_m":
        targets = None if order.target is None else np.flatnonzero(judge(order.target, scene).yes)
        distance, name = distances(targets, scene, np.flatnonzero(truth.yes))
        return distance, lambda row: f"{distance[row]:.2f} m from {name(row)}"
    column = values(scene, order.field)
    if order.field == "speed":
        column = np.where(scene.has_moved, column, np.float32(np.nan))
    return np.asarray(column, np.float32), lambda row: f"{order.field} {column[row]:.4g}"


def _best(rows: Int64, scores: Float32, order: Order | None, ids: Int64, limit: int) -> Int64:
    """Rows by falling score (rising for "least"), ties by id, at most so many."""
    key = scores[rows] if order is not None and order.direction == "least" else -scores[rows]
    if rows.size > 4 * limit:  # sorting all of a large map would take longer than asking it
        some = key <= np.partition(key, limit - 1)[limit - 1]
        rows, key = rows[some], key[some]
    return rows[np.lexsort((ids[rows], key))[:limit]]


def _ties(order: Order | None, scores: Float32, kept: Float32) -> list[str]:
    """That the last of the answers is no better than some that the limit left out."""
    tied, told = (int(np.count_nonzero(s == kept[-1])) if kept.size else 0 for s in (scores, kept))
    by = order.field if order else "score"
    return [f"{tied} tie at {by} {kept[-1]:.4g}, {told} of them told, the lowest ids"] if tied > told else []


def _left_out(order: Order | None, count: int) -> list[str]:
    return [f"{count} left out, no {order.field} known"] if order and count else []


def _notes(query: Query, scene: Scene) -> list[str]:
    """What could not be decided, and why."""
    nodes = [n for root in _roots(query) for n, _ in walk(root)]
    notes = [
        f"no feature for {text!r}: the embedder does not know it"
        for text, similarity in scene.similarity.items()
        if similarity.size and np.isnan(similarity).all()
    ]
    targets = [n.target for n in nodes if isinstance(n, Near | Side)] + [query.order.target if query.order else None]
    notes += [
        f"nothing is {in_words(target)}, so nothing can be judged by where that is"
        for target in dict.fromkeys(targets)
        if target is not None and not judge(target, scene).yes.any()
    ]
    if scene.T_world_cam is None and (any(map(_needs_camera, nodes)) or _by_camera(query.order)):
        notes.append("no camera pose known: what is left, right, in front, behind or how far from it is undecided")
    return notes


def _by_camera(order: Order | None) -> bool:
    return order is not None and order.field == "distance_m" and order.target is None


def _needs_camera(node: Node) -> bool:
    match node:
        case Side(relation, target):
            return target is None or relation not in ("above", "below")
        case Near(target):
            return target is None
        case Compare(field="distance_m"):
            return True
        case _:
            return False
