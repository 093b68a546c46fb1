"""The paper's figures beside ours."""

from __future__ import annotations

from collections.abc import Mapping

from benchmarks.router import PARSERS, intent, sections, verdict
from vlmm_log.evaluation.page import Table, number, share
from vlmm_log.evaluation.results import Evaluation, PixelRow
from vlmm_log.evaluation.scores import QUERIES

ABLATION = {  # our row -> the paper's (Table II), AP moving, movable, static
    "semantic only [words]": ("(i) semantic-only", (0.10, 0.40, 0.70)),
    "observed motion only": ("(ii) + observed motion only", (1.00, 0.73, 0.71)),
    "movability prior only": ("(iii) + movability prior only", (0.30, 0.99, 0.99)),
    "full": ("(iv) full fusion + uncertainty", (1.00, 0.99, 0.99)),
    "no uncertainty": ("(v) full fusion, no uncertainty", (1.00, 0.99, 0.99)),
    "VLMaps/ConceptFusion-style": ("VLMaps-style", (0.18, 0.66, None)),
    "DualMap-style": ("DualMap-style", (0.32, 0.80, None)),
    "random": ("random / prevalence", (0.09, 0.48, 0.52)),
}
Done = Mapping[str, list[Evaluation]]


def tables(done: Done) -> list[Table]:
    """Those whose evaluations were made."""
    found = [must_show(done)]
    for job, title in (
        ("clean", "Fields are not substitutable (paper, Table II): clean depth"),
        ("noisy", "Fields are not substitutable: Kinect-like noise"),
    ):
        if job in done:
            found.append(ablation(title, done[job][0]))
    found.append(uncertainty(done))
    found += [against(done[job][0]) for job in ("clean", "noisy", "real_fruit") if job in done]
    return [t for t in found if t.rows]


def ablation(title: str, e: Evaluation) -> Table:
    """Average precision of the three queries with fields taken away."""
    by_name = {r.name: r for r in e.objects}
    rows = []
    for name, (theirs, figures) in ABLATION.items():
        if name in by_name:
            ours = [number(by_name[name].ap[q]) for q in QUERIES]
            rows.append([theirs, *ours, *(number(x) for x in figures)])
    head = ["", *(f"{q}, ours" for q in QUERIES), *(f"{q}, paper" for q in QUERIES)]
    return Table(title, head, rows, "Average precision over the elements of all scenes. Word features for region-CLIP.")


def uncertainty(done: Done) -> Table:
    """Raw displacement against d_M, paper against default."""
    rows = []
    for job, theirs in (
        ("clean_default", "1.00 / 1.00"),
        ("noisy", ".41 / .68"),
        ("real_sensor", ""),
        ("real_slice", ".10 to .20 / .13 to .33"),
        ("real_pairs", ""),
        ("real_fruit", ""),
    ):
        for e in done.get(job, []):
            p = {(r.trial, r.score): r for r in e.pixels}
            cells = [
                number(p[k].ap) if (k := (t, s)) in p else "" for t in ("paper", "default") for s in ("raw", "d_M")
            ]
            flags = [share(p["default", s].far_flags) if ("default", s) in p else "" for s in ("raw", "d_M")]
            matched = [
                share(p["default", s].far_flags_at_recall) if ("default", s) in p else "" for s in ("raw", "d_M")
            ]
            rows.append([e.title, *cells, " -> ".join(flags), " -> ".join(matched), theirs])
    head = [
        "",
        "paper, raw",
        "paper, d_M",
        "default, raw",
        "default, d_M",
        "far flags",
        "at equal recall",
        "paper prints",
    ]
    return Table("Uncertainty (paper, Table III): full-frame AP of pixels", head, rows)


def against(e: Evaluation) -> Table:
    """Where a baseline is at least as good as the method, said plainly."""
    rows = []
    full = next((r for r in e.objects if r.name == "full"), None)
    if full is not None:
        others = [r for r in e.objects if r.reference and r.name != "random"]
        for query, text in QUERIES.items():
            best = max(others, key=lambda r: r.ap[query])
            rows.append([text, *_verdict(full.ap[query], best.name, best.ap[query])])
    own = [r for r in e.pixels if r.score == "own"]
    if own:
        strongest = max(own, key=lambda r: r.ap)
        rows.append(["moving pixels", *_verdict(e.pixels[0].ap, strongest.trial, strongest.ap)])
    head = ["", "default", "best baseline", "its AP", "verdict"]
    return Table(f"Default against every baseline: {e.title}", head, rows)


def _verdict(ours: float, name: str, theirs: float) -> list[str]:
    gap = ours - theirs
    verdict = "default is better" if gap > 0.0005 else "equal" if gap > -0.0005 else "the baseline is better"
    return [number(ours), name, number(theirs), verdict]


def must_show(done: Done) -> Table:
    """What was promised, and what came of it."""
    rows = []

    def say(what: str, asked: str, got: str, holds: bool) -> None:
        rows.append([what, asked, got, "yes" if holds else "NO"])

    for e in done.get("clean", []):
        ap = next(r for r in e.objects if r.name == "full").ap
        got = " / ".join(number(ap[q]) for q in QUERIES)
        holds = round(ap["moving"], 2) >= 1.0 and ap["movable"] >= 0.99 and ap["static"] >= 0.99
        say("clean: AP moving / movable / static, at two decimals", "1.00 / .99 / .99", got, holds)
    for e in done.get("noisy", []):
        p: dict[tuple[str, str], PixelRow] = {(r.trial, r.score): r for r in e.pixels}
        d, raw, paper = p["default", "d_M"], p["default", "raw"], p["paper", "d_M"]
        say("noisy: d_M AP - raw AP", ".27", f"{d.ap - raw.ap:+.3f}", d.ap - raw.ap >= 0.27)
        say("noisy: default AP - paper AP", ".15", f"{d.ap - paper.ap:+.3f}", d.ap - paper.ap >= 0.15)
        say("noisy: far static pixels flagged", "4 %", share(d.far_flags), d.far_flags <= 0.04)
        for c in e.calibration:
            if c.name.startswith("calibrated"):
                say(f"ECE held out, {c.name}, {c.unit}s", ".05", f"{c.ece:.3f}", c.ece <= 0.05)
        off = next(r for r in e.pixels if r.trial.startswith("default, poses off") and r.score == "d_M")
        without = {t: p[t, "d_M"].ap for t, s in p if s == "d_M" and t.startswith("poses trusted")}
        say("poses off, with ego-refinement: AP changes", ".01", f"{off.ap - d.ap:+.4f}", abs(off.ap - d.ap) <= 0.01)
        exact, wrong = (without[t] for t in sorted(without, key=len))
        say("poses off, without", "clearly worse", f"{exact:.3f} -> {wrong:.3f}", wrong < exact - 0.05)
    return Table("What must show", ["", "asked", "found", "holds"], rows)


def routing() -> Table:
    """Of both parsers, by section of the query file."""
    rows = []
    for name, queries in sections().items():
        for parser, to_tree in PARSERS.items():
            parsed = [(to_tree(q["text"]), q) for q in queries]
            verdicts = [verdict(query, q) for query, q in parsed]
            intents = sum(intent(query) == q["intent"] for query, q in parsed)
            counts = [str(verdicts.count(v)) for v in ("right", "refused", "wrong")]
            rows.append([f"{name}, {parser}", str(len(queries)), str(intents), *counts])
    head = ["queries, parser", "of", "intent right", "noun too", "refused", "wrong"]
    return Table("Routing of queries (paper: 24 of 30 paraphrases)", head, rows)
