"""Language over maps: the parser that settings name, a query on a map file or a recording, its hits as a recording."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vlmm_log.elements import Elements, MotionClass
from vlmm_log.outputs import claim
from vlmm_log.pipeline.language.answer import answer
from vlmm_log.pipeline.language.explain import explain
from vlmm_log.queries import Answer, Query, View
from vlmm_log.recording import is_recording
from vlmm_log.settings import MapSettings, QuerySettings, Settings
from vlmm_log.types import Float64, InputError
from vlmm_log.writers.staging import claim_folder, replacing_folder

if TYPE_CHECKING:
    from vlmm_log.maps import SavedMap
    from vlmm_log.protocols import Embedder

Parser = Callable[[str], Query]


@dataclass(frozen=True)
class Questions:
    """Queries that were understood, and what answers them."""

    queries: tuple[Query, ...]
    embed: Embedder
    s: QuerySettings
    map_settings: MapSettings
    up: str  # axis of the world that points up

    def answers(self, elements: Elements, T_world_cam: Float64 | None, origin_ns: int) -> list[Answer]:
        """Each query's answer, as seen from a camera."""
        view = View(T_world_cam, self.up, origin_ns)
        named = self.embed.labels(elements.labels)  # of the label that won, not of the largest frame's
        elements = elements if named is None else replace(elements, features=named)
        texts, theta_s = self.embed.texts, self.embed.threshold
        return [answer(q, elements, texts, self.s, self.map_settings, view, theta_s) for q in self.queries]


def parse(texts: Sequence[str], s: Settings) -> tuple[tuple[Query, ...], tuple[str, ...]]:
    """The queries that texts ask, each text once; and what the parser has to tell: an endpoint's cost.

    Raises InputError where one holds words that the parser does not understand: a query is never answered in part.
    """
    parser = load_parser(s) if texts else None
    queries = tuple(parser(text) for text in dict.fromkeys(texts)) if parser else ()
    for query in queries:
        if query.unparsed:
            words = ", ".join(repr(word) for word in query.unparsed)
            raise InputError(
                f"query {query.text!r}: not understood: {words}; leave it out or say it otherwise"
                f" (understood: {explain(replace(query, unparsed=()))})"
            )
    endpoint = getattr(parser, "endpoint", None)
    return queries, () if endpoint is None else (f"parser's endpoint {endpoint.where}: {endpoint.cost}",)


def load_parser(s: Settings) -> Parser:
    """The parser of ``query.parser``. Raises InputError for an unknown one."""
    kind, _, url = s.query.parser.partition(":")
    if s.query.parser == "default":
        from vlmm_log.pipeline.language.parser import parse as default

        return default
    if s.query.parser == "paper":
        from vlmm_log.pipeline.language.router import route

        return route
    if kind == "llm" and url:
        from vlmm_log.models.endpoint import Endpoint
        from vlmm_log.models.llm_parser import LlmParser

        return LlmParser(Endpoint(url, s.objects.llm_model))
    raise InputError(f"query.parser {s.query.parser!r}: no such parser; it is default, paper or llm:URL")


def load_map(path: str | Path) -> SavedMap:
    """The map of a map file (.json, .parquet) or a recording (.rrd, .mcap). Raises InputError where it is neither."""
    path = Path(path)
    if path.is_dir():
        raise InputError(
            f"{path}: is a folder; process it, and ask its map (.json, .parquet) or recording (.rrd, .mcap)"
        )
    if not path.is_file():
        raise InputError(f"{path}: no such file; give a map (.json, .parquet) or a recording (.rrd, .mcap)")
    if is_recording(path):
        from vlmm_log.recording.map import read_map

        return read_map(path)
    from vlmm_log import maps

    return maps.load_map(path)


def query(source: str | Path | SavedMap, text: str, *, sets: Sequence[str] = ()) -> Answer:
    """Elements of a map or recording that a text asks for, the best first, each with its reason.

    ``sets`` change the settings that the map was made with: "query.parser=paper", "query.threshold=0.4". Raises
    InputError where the source cannot be read or the text is not understood.
    """
    saved = load_map(source) if isinstance(source, str | Path) else source
    return _ask(saved, text, _settings(saved, sets))[0]


@dataclass(frozen=True)
class Found:
    """What the ``query`` command leaves."""

    answer: Answer
    elements: Elements
    outputs: tuple[Path, ...]
    told: tuple[str, ...]  # by the parser: an endpoint's cost

    def report(self, limit: int) -> dict[str, Any]:
        """The answer with field values, ready for JSON."""
        a, rows = self.answer, np.searchsorted(self.elements.ids, self.answer.ids[:limit])
        return {
            "query": a.text,
            "explanation": a.explanation,
            "returns": a.returns,
            "matches": a.matches,
            "answers": [
                _fields(self.elements, r) | {"score": float(a.scores[rank]), "reason": a.reasons[rank]}
                for rank, r in enumerate(rows.tolist())
            ],
            "outputs": [str(path) for path in self.outputs],
            "told": list(self.told),
        }


def _fields(e: Elements, r: int) -> dict[str, Any]:
    """An element's row, under the paper's names."""
    return {
        "id": int(e.ids[r]),
        "label": e.labels[r],
        "position": e.positions[r].tolist(),
        "motion_class": MotionClass(e.motion_class[r]).name.lower(),
        "confidence": float(e.confidence[r]),
        "o": float(e.o[r]),
        "kappa": float(e.kappa[r]),
        "rho": float(e.rho[r]),
        "intervals_ns": e.intervals[e.interval_rows == r].tolist(),
    } | ({} if np.isnan(e.p_moving[r]) else {"p_moving": float(e.p_moving[r])})


def find(
    source: str | Path,
    text: str,
    *,
    sets: Sequence[str] = (),
    rrd: Path | None = None,
    masks: Path | None = None,
    grid: Path | None = None,
    force: bool = False,
) -> Found:
    """``query``, with its hits as a recording that opens together with the source's, as masks, as an occupancy grid.

    Raises InputError as ``query`` does, and where an output cannot be written; masks need a recording.
    """
    source = Path(source)
    if masks is not None and not is_recording(source):
        raise InputError(f"{source}: a map file holds no masks; ask the run's recording")
    files = [path for path in (rrd, *_grid_files(grid)) if path is not None]
    claim(files, force=force, inputs=[source])
    if masks is not None:
        from vlmm_log.sinks.hits import holds_masks

        claim_folder(masks, [source, *files], force=force, replaceable=holds_masks)
    saved = load_map(source)
    s = _settings(saved, sets)
    found, told = _ask(saved, text, s)
    outputs = []
    if grid is not None:
        from vlmm_log.maps.grid import save_grid
        from vlmm_log.maps.occupancy import occupancy

        everything = replace(s, query=replace(s.query, limit=max(len(saved.world.columns), 1)))
        ids = found.ids if found.matches == found.ids.size else _ask(saved, text, everything)[0].ids
        save_grid(grid, occupancy(saved, s.grid, ids.tolist()), force=force)
        outputs.append(grid)
    if rrd is not None:
        from vlmm_log.outputs import replacing
        from vlmm_log.recording.map import read_masks
        from vlmm_log.sinks.hits import write_hits

        frames = read_masks(source) if is_recording(source) else ()
        with replacing(rrd, force=force) as (partial,):
            write_hits(partial, saved.world.columns, found, saved.run.recording_id, frames)
        outputs.append(rrd)
    if masks is not None:
        from vlmm_log.maps.header import header
        from vlmm_log.recording.map import read_masks
        from vlmm_log.sinks.hits import write_masks

        about = {"query": text, "ids": found.ids.tolist(), "settings": s.to_toml(), "map": header(saved)}
        with replacing_folder(masks) as staged:
            write_masks(staged, found, read_masks(source), about)
        outputs.append(masks)
    return Found(found, saved.world.columns, tuple(outputs), told)


def _grid_files(grid: Path | None) -> tuple[Path, ...]:
    if grid is None:
        return ()
    return (grid,) if grid.suffix == ".npz" else (grid, grid.with_suffix(".pgm"))


def _settings(saved: SavedMap, sets: Sequence[str]) -> Settings:
    """The map's own settings, changed. Raises InputError for those that a finished map cannot follow."""
    made = Settings.from_toml(saved.run.settings, saved.run.source)
    changed = made.changed(sets)
    asking = replace(changed.objects, **{name: getattr(made.objects, name) for name in ("embedder", "llm_model")})
    if replace(changed, query=made.query, grid=made.grid, objects=asking) != made:
        raise InputError(
            f"--set {' '.join(sets)}: the map was made with its settings; process the log again with these"
        )
    return changed


def _ask(saved: SavedMap, text: str, s: Settings) -> tuple[Answer, tuple[str, ...]]:
    from vlmm_log.models.embedders import load_embedder

    queries, told = parse([text], s)
    embed, versions = load_embedder(s.objects)
    _check_embedder(saved, embed, versions)
    questions = Questions(queries, embed, s.query, s.map, saved.run.world_up)
    return questions.answers(saved.world.columns, saved.T_world_cam, saved.origin_ns)[0], told


def _check_embedder(saved: SavedMap, embed: Embedder, versions: Mapping[str, str]) -> None:
    """Features made of pixels compare only with texts of the same weights."""
    made, here = saved.run.versions.get("embedder"), versions.get("embedder")
    if embed.labels([]) is None and made != here:
        raise InputError(
            f"{saved.run.source}: its features are of {made}, the embedder here is {here}; give the same weights, "
            "as in --set objects.embedder=clip:FILE"
        )
