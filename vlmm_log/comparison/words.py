"""A difference in words, for a terminal, a page, a recording."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path

from vlmm_log.comparison.difference import Difference, Divergence, ElementChange, EntityDifference, Figures, Place
from vlmm_log.sinks.markdown import plain

STAGES = {  # what a stage does, for those who do not know its name
    "input": "what was read and paired",
    "flow": "optical flow",
    "segments": "instances",
    "matches": "gate and noise model of the matches",
    "ego": "ego-refinement",
    "motion": "residual, Sigma and d_M",
    "posterior": "calibrated probabilities of pixels",
    "embed": "semantic features",
    "aggregate": "observations of instances",
    "odometry": "camera poses",
    "place": "instances in the world",
    "associate": "association of instances and elements",
    "map": "map and fusion",
    "query": "answers",
    "judge": "the score against the truth",
}
MOST = 8  # elements that are named in a line
HISTORY = re.compile(r"world/map/elements/\d+(/\w+)?")


def summary(d: Difference) -> list[str]:
    """The difference in a few lines, the most important first."""
    return list(_lines(d))


def _lines(d: Difference) -> Iterator[str]:
    yield from d.missing
    pairs = f"; both hold {d.frames[2]} pairs ({d.frames[0]} in A, {d.frames[1]} in B)" if any(d.frames) else ""
    if d.same:
        yield f"the same{pairs}"
        return
    yield f"different{pairs}"
    if d.settings:
        concerns = Counter(change.name.partition(".")[0] for change in d.settings if change.name != "profile")
        told = ", ".join(f"{'noise model' if name == 'noise' else name} ({n})" for name, n in concerns.items())
        profile = next((f"; profile {c.a} -> {c.b}" for c in d.settings if c.name == "profile"), "")
        yield f"settings: {len(d.settings)} differ: {told}{profile}"
    for change in d.inputs:
        yield f"input: {change.name} {_cut(change.a)} -> {_cut(change.b)}"
    if d.missing and not (d.stages or any(e.frames for e in d.entities)):
        yield "what both hold is the same"
    if d.first is not None:
        yield f"first divergence: {first_words(d.first)}"
    yield from _element_lines(d)
    for query in d.queries:
        changed = "; ".join(f"{e}: {a or 'none'} -> {b or 'none'}" for e, a, b in query.ranks[:MOST])
        yield f"query {query.query}: ranks {changed}"


def _element_lines(d: Difference) -> Iterator[str]:
    kinds = Counter(kind for change in d.elements.changes for kind in change.kinds)
    if not kinds:
        return
    yield f"elements: {d.elements.matched} in both; {', '.join(f'{n} {kind}' for kind, n in kinds.most_common())}"
    flipped = d.elements.of_kind("flipped")
    if flipped:
        more = f" and {len(flipped) - MOST} more" if len(flipped) > MOST else ""
        yield f"class flipped: {'; '.join(map(flip_words, flipped[:MOST]))}{more}"


def flip_words(change: ElementChange) -> str:
    """An element whose class flipped: its id, label, and both classes."""
    return f"{name_words(change)}: {' -> '.join(change.classes)}"


def name_words(change: ElementChange) -> str:
    """An element's id, and its label if it has one."""
    return f"{id_words(change)} {change.label}".rstrip()


def readable(path: Path) -> str:
    """A file's name as text: bytes that are none as escapes."""
    return str(path).encode("utf-8", "backslashreplace").decode()


def id_words(change: ElementChange) -> str:
    """Its id in A and B."""
    if change.a is None or change.b is None or change.a == change.b:
        return str(change.a if change.a is not None else change.b)
    return f"{change.a} (B: {change.b})"


def place_words(at: Place) -> str:
    """A moment."""
    if at.index is not None:
        return f"frame {at.index}"
    return "the whole recording" if at.stamp_ns is None else f"{at.stamp_ns} ns"


def first_words(first: Divergence) -> str:
    """Where, which stage, and what shows it."""
    stage = f"stage {first.stage} ({STAGES[first.stage]})" if first.stage else "no stage's result"
    shown = f", seen in {first.entity}" if first.entity else ", by the digest of its full result"
    return f"{place_words(first.at)}, {stage}{shown}"


def grouped(entities: Iterable[EntityDifference]) -> list[tuple[str, list[EntityDifference]]]:
    """Entities to list; histories of elements, of which there are many, together."""
    groups: dict[str, list[EntityDifference]] = {}
    for e in entities:
        name = "world/map/elements/*" if HISTORY.fullmatch(e.entity) else e.entity
        groups.setdefault(name, []).append(e)
    return list(groups.items())


def entity_words(name: str, group: list[EntityDifference]) -> str:
    """An entity, or histories of elements, in a line."""
    first = min((e.first for e in group), key=lambda place: place.order)
    differing, compared = sum(len(e.frames) for e in group), sum(e.compared for e in group)
    parts = [f"{differing} of {compared} differ" if differing else f"{compared} alike", f"first {place_words(first)}"]
    alone = (("A", sum(len(e.only_a) for e in group)), ("B", sum(len(e.only_b) for e in group)))
    parts += [f"{n} only in {side}" for side, n in alone if n]
    worst = group[0].worst if len(group) == 1 else None
    if worst is not None:
        parts.append(f"worst {place_words(worst.at)}: {figure_words(worst.figures)}")
    elif len(group) > 1:
        parts.append(f"{len(group)} entities")
    return f"{group[0].stage or '-'}: {name}: {', '.join(parts)}"


def figure_words(n: Figures) -> str:
    """How much."""
    told = f"; {n.told}" if n.told else ""
    if n.largest == n.largest and n.p50 == n.p50 and n.compared > 1:
        return f"p50 {n.p50:.3g}, p95 {n.p95:.3g}, max {n.largest:.3g} {n.unit}".strip() + told
    if n.unit == "px flipped":
        return f"{n.over} of {n.compared} px flipped{told}"
    if n.largest == n.largest and n.p50 == n.p50:
        return f"by {n.largest:.4g} {n.unit}".strip() + told
    return _cut(n.told, 200) or f"{n.over} of {n.compared} {n.unit}".strip()


def markdown(d: Difference) -> str:
    """The summary and all settings as Markdown."""
    lines = [f"# {plain(d.a)} | {plain(d.b)}", ""]
    lines += [f"- {plain(line)}" for line in summary(d)]
    if d.settings:
        lines += ["", "| setting | A | B |", "|---|---|---|"]
        lines += [f"| {plain(c.name)} | {plain(str(c.a))} | {plain(str(c.b))} |" for c in d.settings]
    if d.entities:
        lines += ["", "| entity | differs in | worst |", "|---|---|---|"]
        for name, group in grouped(d.entities):
            worst = group[0].worst
            where = place_words(worst.at) if worst is not None else ""
            count = sum(len(e.frames) for e in group)
            lines.append(f"| {plain(name)} | {count} | {where} |")
    return "\n".join(lines) + "\n"


def _cut(value: object, most: int = 16) -> str:
    text = str(value)
    return text if len(text) <= most else f"{text[: most - 4]}..."
