"""What ``process`` leaves."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from vlmm_log.maps import SavedMap
from vlmm_log.queries import Answer
from vlmm_log.sinks.summary import Summary
from vlmm_log.types import Run, RunEnd


@dataclass(frozen=True)
class Processed:
    """Where what it wrote lies, and the figures of the run."""

    run: Run
    end: RunEnd
    outputs: tuple[Path, ...]  # as they lie on disk: ``NAME.partial`` if the run was interrupted
    summary: Summary
    map: SavedMap
    answers: tuple[Answer, ...]  # of the queries, over the whole map
    resumed: int = 0  # pairs that an earlier run had looked at

    def report(self) -> dict[str, object]:
        """The closing figures for scripts."""
        return {
            "source": self.run.source,
            "reader": self.run.reader,
            "notes": [*self.run.notes, *self.end.told],
            "complete": self.end.complete,
            "input_hash": self.end.input_hash,
            "frames": self.end.frames,
            "outputs": [str(path) for path in self.outputs],
            "figures": self.summary.figures(),
            "elements": self.elements_told(),
            "answers": [
                {"query": a.text, "matches": a.matches, "ids": a.ids.tolist(), "reasons": list(a.reasons)}
                for a in self.answers
            ],
            "skipped": dict(self.summary.skipped),
            "versions": self.run.versions,
        }

    def elements_told(self) -> str:
        """How many elements there are, of which class, in a line."""
        elements = self.map.world.elements.values()
        classes = Counter(e.motion_class.name.lower() for e in elements)
        moved = sum(len(e.intervals) > 0 for e in elements)
        counts = ", ".join(f"{n} {name}" for name, n in sorted(classes.items()))
        return f"{len(elements)} elements: {counts or 'none'}; {moved} seen to move at some time"
