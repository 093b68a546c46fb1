"""What commands print: tables and lines for people, reports for scripts. No label can steer the terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.console import Console

    from vlmm_log.api import Processed
    from vlmm_log.ask import Found
    from vlmm_log.compare_batches import BatchDifference
    from vlmm_log.comparison.difference import Difference
    from vlmm_log.conversion import Converted
    from vlmm_log.datasets import Got, Shelved
    from vlmm_log.diagnosis import Diagnosis
    from vlmm_log.evaluation.results import Evaluation
    from vlmm_log.fleet import Batch
    from vlmm_log.picturing import Rendered
    from vlmm_log.rendering import Simulated
    from vlmm_log.survey import Info


def run_report(done: Processed) -> dict[str, object]:
    """The closing figures of a run for scripts."""
    return {
        "source": done.run.source,
        "reader": done.run.reader,
        "notes": [*done.run.notes, *done.end.told],
        "complete": done.end.complete,
        "input_hash": done.end.input_hash,
        "frames": done.end.frames,
        "outputs": [str(path) for path in done.outputs],
        "figures": done.summary.figures(),
        "elements": _elements_line(done),
        "answers": [
            {"query": a.text, "matches": a.matches, "ids": a.ids.tolist(), "reasons": list(a.reasons)}
            for a in done.answers
        ],
        "skipped": dict(done.summary.skipped),
        "versions": done.run.versions,
    }


def printable(text: str) -> str:
    """A label as a terminal may show it: control and direction characters as escapes."""
    return "".join(c if c.isprintable() else f"\\u{ord(c):04x}" for c in text)


def print_answer(found: Found, limit: int, explain: bool) -> None:
    """What a query found."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console(markup=False)
    answer, elements = found.answer, found.elements
    if explain:
        console.print(answer.explanation, highlight=False)
    if answer.returns == "count":
        console.print(str(answer.matches), highlight=False)
    elif not answer.matches:
        console.print(f"nothing in {len(elements)} elements answers {answer.text!r}", highlight=False)
    if answer.matches:
        table = Table(title=Text(f"{answer.matches} of {len(elements)} elements"), title_justify="left")
        for name in ("id", "label", "class", "score", "position m", "why"):
            table.add_column(name, overflow="fold")
        for row in found.report(limit)["answers"]:
            place = " ".join(f"{x:.2f}" for x in row["position"])
            cells = (row["id"], row["label"], row["motion_class"], f"{row['score']:.2f}", place, row["reason"])
            table.add_row(*(Text(printable(str(cell))) for cell in cells))
        console.print(table)
    if answer.returns == "mask" and not found.outputs:
        console.print("asks for where: --masks FOLDER or --rrd F writes the pixels", highlight=False)
    for told in found.told:
        console.print(f"  {told}", highlight=False)
    for path in found.outputs:
        console.print(f"wrote {printable(str(path))}", highlight=False, soft_wrap=True)


def print_difference(d: Difference, limit: int = 40) -> None:
    """What differs: in words, then settings, entities and elements, a line each."""
    from rich.console import Console

    from vlmm_log.comparison.words import entity_words, grouped, id_words, summary

    console = Console(markup=False)

    def show(title: str, lines: list[str]) -> None:
        if lines:
            console.print(title, style="bold", highlight=False)
        for line in lines[:limit]:
            console.print(f"  {printable(line)}", highlight=False, soft_wrap=True)
        if len(lines) > limit:
            console.print(f"  and {len(lines) - limit} more: --json tells all", highlight=False)

    console.print(f"A {printable(d.a)}\nB {printable(d.b)}", highlight=False, soft_wrap=True)
    for line in summary(d):
        console.print(printable(line), highlight=False, soft_wrap=True)
    show("settings, A -> B", [f"{c.name}: {c.a} -> {c.b}" for c in d.settings])
    show("entities, in the order of the stages", [entity_words(name, group) for name, group in grouped(d.entities)])
    changes = [c for c in d.elements.changes if c.kinds != ("changed",)]
    show("elements", [f"{id_words(c)} {c.label}: {', '.join(c.kinds)}: {c.told}" for c in changes])
    show("about the runs, A -> B", [f"{change.name}: {change.a} -> {change.b}" for change in d.about])


ROWS = {  # figure -> what the table calls it, how it is written
    "pairs": ("pairs", "{:.0f}"),
    "unreliable_pairs": ("pairs with unreliable ego-motion", "{:.0f}"),
    "coverage": ("coverage (pixels scored)", "{:.1%}"),
    "flagged_share": ("flagged (d_M above tau_px)", "{:.2%}"),
    "static_d_m2_median": ("d_M^2 median (2.366 expected of a still world)", "{:.2f}"),
    "calibrating_noise_scale": ("noise.scale that would make it 2.366", "{:.2f}"),
    "residual_median_m": ("residual median", "{:.4f} m"),
    "instances": ("instances a frame", "{:.0f}"),
    "ego_inlier_share": ("ego-refinement inliers", "{:.1%}"),
    "flow_ms": ("flow", "{:.1f} ms"),
    "matches_ms": ("noise of the matches", "{:.1f} ms"),
    "ego_ms": ("ego-refinement", "{:.1f} ms"),
    "motion_ms": ("motion channel", "{:.1f} ms"),
    "posterior_ms": ("calibrated probabilities", "{:.1f} ms"),
    "segments_ms": ("segmenter", "{:.1f} ms"),
    "embed_ms": ("embedder", "{:.1f} ms"),
    "aggregate_ms": ("observations", "{:.1f} ms"),
    "associate_ms": ("association", "{:.1f} ms"),
    "map_ms": ("map and fusion", "{:.1f} ms"),
}


def _elements_line(done: Processed) -> str:
    from collections import Counter

    classes = Counter(e.motion_class.name.lower() for e in done.map.world.elements.values())
    moved = sum(len(e.intervals) > 0 for e in done.map.world.elements.values())
    counts = ", ".join(f"{n} {name}" for name, n in sorted(classes.items()))
    return f"{len(done.map.world.elements)} elements: {counts or 'none'}; {moved} seen to move at some time"


def print_run(done: Processed) -> None:
    """The closing figures of a run."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console(markup=False)  # names may hold brackets
    title = Text(printable(f"{done.run.source} ({done.run.reader}), medians over pairs"))
    table = Table(title=title, title_justify="left")
    table.add_column("figure")
    table.add_column("value", justify="right")
    figures = done.summary.figures()
    for name, (label, form) in ROWS.items():
        if name in figures:
            table.add_row(label, form.format(figures[name]))
    for reason, count in sorted(done.summary.skipped.items()):
        table.add_row(Text(printable(f"noted: {reason}")), str(count))
    console.print(table)
    console.print(_elements_line(done), highlight=False)
    for found in done.answers:
        names = ", ".join(f"{i} {done.map.world.elements[i].label}".strip() for i in found.ids[:10].tolist())
        names = printable(names)
        console.print(f"{found.text!r}: {found.matches} of the map's elements{': ' if names else ''}{names}")
    for note in (*done.run.notes, *done.end.told):
        console.print(f"  {printable(note)}", highlight=False)
    for path in done.outputs:
        size = path.stat().st_size / 1e6
        state = "" if done.end.complete else " (interrupted: readable up to the last pair)"
        console.print(f"wrote {printable(str(path))}{state}, {size:.1f} MB", highlight=False, soft_wrap=True)
    if not done.end.complete and not done.outputs:
        console.print("interrupted before the first pair: nothing was kept")


def print_batch(done: Batch, most_movers: int = 6) -> None:
    """How the logs stand, then what failed and why."""
    from collections import Counter

    from rich.console import Console

    console = Console(markup=False)
    rows = []
    for o in done.outcomes:
        figures = o.row
        movers = figures.get("movers", [])
        more = f" and {len(movers) - most_movers} more" if len(movers) > most_movers else ""
        cells = (
            _known(figures.get("pairs"), "{:.0f}"),
            _known(o.seconds, "{:.1f}"),
            _known(figures.get("flagged_share"), "{:.1%}"),
            _known(figures.get("static_d_m2_median"), "{:.2f}"),
            _known(figures.get("elements"), "{:.0f}"),
        )
        rows.append((o.name, str(o.state), *cells, ", ".join(movers[:most_movers]) + more))
    _print_rows(console, "", ("log", "state", "pairs", "s", "flagged", "d_M^2", "elements", "seen to move"), rows)
    for o in done.outcomes:
        if o.error:
            console.print(printable(f"{o.name}: {o.error}"), highlight=False, soft_wrap=True)
    states = Counter(str(o.state) for o in done.outcomes)
    told = ", ".join(f"{n} {state}" for state, n in sorted(states.items()))
    console.print(f"{len(done.outcomes)} logs: {told}", highlight=False, soft_wrap=True)
    if not done.complete:
        console.print("interrupted: the same command goes on with what is pending", highlight=False, soft_wrap=True)
    console.print(f"wrote {printable(str(done.out))}", highlight=False, soft_wrap=True)


def print_batch_difference(d: BatchDifference) -> None:
    """A line a log."""
    from collections import Counter

    from rich.console import Console

    console = Console(markup=False)
    console.print(f"A {printable(d.a)}\nB {printable(d.b)}", highlight=False, soft_wrap=True)
    for log in d.logs:
        told = f"{log.name}: {log.verdict}{': ' if log.told else ''}{log.told}"
        console.print(printable(told), highlight=False, soft_wrap=True)
    counts = Counter(log.verdict for log in d.logs)
    told = ", ".join(f"{n} {verdict}" for verdict, n in counts.most_common())
    console.print(f"{len(d.logs)} logs: {told}", highlight=False, soft_wrap=True)


def print_datasets(shelved: Sequence[Shelved]) -> None:
    """What can be fetched, a line a sequence; then the terms of each collection."""
    from rich.console import Console

    console = Console(markup=False)
    width = max(len(x.offer.name) for x in shelved)
    for x in shelved:
        size = f"{x.offer.size / 1e6:.0f} MB" if x.offer.size else "? MB"
        state = f" [{x.state}{f': {x.size / 1e6:.0f} MB' if x.size else ''}]" if x.state else ""
        moves = f" Moves: {x.offer.movers}." if x.offer.movers else ""
        line = f"{x.offer.name:<{width}} {size:>8}  {x.offer.about}.{moves}{state}"
        console.print(line, highlight=False, soft_wrap=True)
    for title, page, licence in dict.fromkeys((x.offer.title, x.offer.page, x.offer.licence) for x in shelved):
        console.print(f"{title} ({page}), licence: {licence}", highlight=False, soft_wrap=True)


def print_dataset(got: Got) -> None:
    """Where a sequence lies now, and how far it is known to be the right one."""
    from rich.console import Console

    lines = [f"SHA-256 {got.sha256}, as {got.source} says"]
    if not got.source:
        record = got.path.parent / f"{got.offer.file}.sha256"
        lines = [f"SHA-256 {got.sha256}: nobody publishes one, so this download was trusted; kept in {record}"]
    if got.outside:
        lines.append(f"left out: {got.outside} members of the archive outside of {got.offer.folder}/")
    lines.append(f"wrote {got.path}; next: vlmm-log info {got.path}")
    for line in lines:
        Console(markup=False).print(printable(line), highlight=False, soft_wrap=True)


def print_info(told: Info) -> None:
    """What a log holds."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console(markup=False)
    streams = Table(title=Text(f"{printable(told.source)} ({told.reader})"), title_justify="left")
    for name, side in (("", "left"), ("stream", "left"), ("type", "left"), ("count", "right"), ("Hz", "right")):
        streams.add_column(name, justify=side, overflow="fold")  # type: ignore[arg-type]
    streams.add_column("longest gap", justify="right")
    for x in told.streams:
        cells = (x.role, printable(x.name), printable(x.type), _known(x.count), _known(x.rate_hz, "{:.2f}"))
        streams.add_row(*(Text(cell) for cell in (*cells, _known(x.longest_gap_s, "{:.3f} s"))))
    console.print(streams)
    lines = [f"about {told.frames} frames in {told.span_s:.1f} s"]
    if told.problem:
        lines = [f"{told.span_s:.1f} s; gives no frames as it is: {told.problem}"]
    elif told.first is None:
        lines.append("no frame could be read: `vlmm-log doctor` looks for the reason")
    else:
        f = told.first
        lines.append(
            f"first frame {f.width}x{f.height} at {f.stamp_ns} ns, {f.depth_seen:.0%} of its pixels with depth, "
            f"median {f.depth_median_m:.2f} m"
        )
    lines.append(f"poses: {told.poses or 'none'}")
    lines += told.notes
    lines += [f"noted: {reason}, {count} times" for reason, count in sorted(told.skipped.items())]
    lines += [f"for {role}, best first: {'; '.join(c)}" for role, c in told.candidates.items() if len(c) > 1]
    for line in lines:
        console.print(f"  {printable(line)}", highlight=False, soft_wrap=True)


def _known(value: float | None, form: str = "{}") -> str:
    return "" if value is None or value != value else form.format(value)


def print_diagnosis(diagnosis: Diagnosis) -> None:
    """Findings with their remedies, then what was examined."""
    from rich.console import Console

    console = Console(markup=False)
    for finding in diagnosis.findings:
        console.print(f"FOUND {finding.check}: {printable(finding.message)}", highlight=False, soft_wrap=True)
        console.print(f"      mend it: {printable(finding.remedy)}", highlight=False, soft_wrap=True)
    for seen in diagnosis.evidence:
        console.print(f"  {seen.check}: {printable(seen.message)}", highlight=False, soft_wrap=True)
    if not diagnosis.findings:
        console.print("nothing found that contradicts the data", highlight=False, soft_wrap=True)


def print_simulated(done: Simulated) -> None:
    """What was rendered."""
    from rich.console import Console

    console = Console(markup=False)
    kinds = len(set(done.visible))
    console.print(
        f"  {done.frames} frames of {done.scene}: {len(done.visible)} objects of {kinds} names are seen "
        f"of {done.things}, {len(done.movers)} move: {', '.join(done.movers)}",
        highlight=False,
        soft_wrap=True,
    )
    console.print(f"wrote {printable(str(done.out))}", highlight=False, soft_wrap=True)


def print_converted(done: Converted) -> None:
    """What was written."""
    from rich.console import Console

    console = Console(markup=False)
    for name, count in done.counts.items():
        console.print(f"  {printable(name)}: {count}", highlight=False, soft_wrap=True)
    for line in (*done.notes, *(f"noted: {reason}, {n} times" for reason, n in sorted(done.skipped.items()))):
        console.print(f"  {printable(line)}", highlight=False, soft_wrap=True)
    console.print(f"wrote {printable(str(done.out))}", highlight=False, soft_wrap=True)


def print_rendered(done: Rendered) -> None:
    """What was drawn, and what is missing in it."""
    from rich.console import Console

    console = Console(markup=False)
    for line in done.told:
        console.print(f"noted: {printable(line)}", highlight=False, soft_wrap=True)
    shown = f"frame {done.first}" if done.fps is None else f"{done.frames} frames at {done.fps:g}/s"
    told = f"wrote {done.out}: {shown}, {done.size[0]} x {done.size[1]} px: {', '.join(done.panels)}"
    console.print(printable(told), highlight=False, soft_wrap=True)


def print_evaluation(e: Evaluation) -> None:
    """Tables of an evaluation: pixels, elements, identities, calibration."""
    from rich.console import Console

    console = Console(markup=False)
    console = Console(markup=False, width=max(console.width, 110))  # narrower cells are no longer read
    for log in e.logs:
        told = f"{log.name}: {log.truth}; {log.frames} frames, {log.judged_pairs} of {log.pairs} pairs judged"
        console.print(printable(told), highlight=False, soft_wrap=True)
    pixels = [
        (
            *(r.trial, r.score, _figure(r.ap, "{:.3f}"), _figure(r.scored_ap, "{:.3f}"), _figure(r.coverage, "{:.1%}")),
            *(_figure(x, "{:.1%}") for x in (r.recall, r.static_flags, r.far_flags, r.far_flags_at_recall)),
        )
        for r in e.pixels
    ]
    head = ("settings or baseline", "score", "AP", "scored", "coverage", "recall", "static", "far", "equal recall")
    share = e.pixels[0].prevalence if e.pixels else float("nan")
    _print_rows(console, f"moving pixels, {_figure(share, '{:.1%}')} of all; flags of static ones", head, pixels)
    objects = [
        (
            r.name,
            *(_figure(ap, "{:.3f}") for ap in r.ap.values()),
            *(_figure(d.f1, "{:.2f}") for d in r.decisions.values()),
        )
        for r in e.objects
    ]
    queries = tuple(e.objects[0].ap) if e.objects else ()
    if e.objects:
        names = ("elements", *(f"AP {q}" for q in queries), *(f"F1 {q}" for q in queries))
        _print_rows(console, "queries", names, [(*row, *[""] * (len(names) - len(row))) for row in objects])
    for a in e.association:
        told = f"identities, {a.trial}: IDF1 {_figure(a.idf1, '{:.3f}')}, {a.elements} elements for {a.things} things"
        console.print(printable(told), highlight=False)
    for c in e.calibration:
        console.print(f"ECE of {c.name}: {_figure(c.ece, '{:.3f}')} ({c.count} {c.unit}s)", highlight=False)
    console.print(f"static d_M^2 median {_figure(e.static_d_m2, '{:.2f}')} (2.366 expected)", highlight=False)
    if e.sigma_z is not None:
        a_m, b = e.sigma_z
        console.print(
            f"depth noise of static pixels: --set noise.sigma_z_a={a_m:.5f} --set noise.sigma_z_b={b:.5f}",
            highlight=False,
        )


def _figure(value: float, form: str) -> str:
    """A dash where nothing could be judged."""
    return _known(value, form) or "–"


def _print_rows(console: Console, title: str, head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    from rich.table import Table
    from rich.text import Text

    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    for k, name in enumerate(head):
        table.add_column(name, justify="right" if k else "left", overflow="fold")
    for row in rows:
        table.add_row(*(Text(printable(cell)) for cell in row))
    console.print(table)
