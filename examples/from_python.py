"""A log from Python: open it, process it twice, ask the map, compare the runs.

    python examples/from_python.py LOG OUT [QUESTION]

OUT is a folder for the two recordings and the map; ``vlmm-log view OUT/before.rrd OUT/after.rrd`` shows both.
"""

from __future__ import annotations

import sys
from pathlib import Path

from vlmm_log import Settings, diff, load_map, open_log, process, query
from vlmm_log.types import InputError, Skipped

EVER = 2**62  # ns


def tour(source: Path, out: Path, question: str) -> None:
    """Each call of the API that most scripts need."""
    log = open_log(source)
    read = list(log.frames(0, EVER))  # Frame, or Skipped with its reason
    left_out = sum(isinstance(item, Skipped) for item in read)
    print(f"{log.name}: {len(read) - left_out} frames, {left_out} left out; poses: {log.has_poses}")

    out.mkdir(parents=True, exist_ok=True)
    process(source, rrd=out / "before.rrd", map=out / "map.json", force=True)
    after = process(source, rrd=out / "after.rrd", settings=Settings.load(sets=["noise.scale=2"]), force=True)
    for name, figure in after.summary.figures().items():
        print(f"  {name} {figure:.4g}")

    saved = load_map(out / "map.json")
    for element in saved.world.elements.values():
        print(f"  {element.id} {element.label}: {element.motion_class.name.lower()}, o {element.o:.2f}")
    answer = query(saved, question)
    print(f"{question}: {answer.explanation}")
    for i, reason in zip(answer.ids, answer.reasons, strict=True):
        print(f"  {saved.world.elements[i].label}: {reason}")

    difference = diff(out / "before.rrd", out / "after.rrd")
    if difference.first is not None:
        print(f"the runs part at frame {difference.first.at.index}, stage {difference.first.stage}")


if __name__ == "__main__":
    try:
        tour(Path(sys.argv[1]), Path(sys.argv[2]), " ".join(sys.argv[3:]) or "what moved")
    except InputError as e:  # one line: what, where, remedy
        sys.exit(str(e))
