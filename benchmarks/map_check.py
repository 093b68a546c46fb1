"""The map on real recordings: who is one element, what moves, what stays.

    python -m benchmarks.map_check

The TUM slice with YOLOv8n masks (a seated person turns the head; monitors and keyboards stand), an opening door and
fruit rolled onto a table with the default segmenter. Prints what is found, wrong or right.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from benchmarks.data import DATA, MOVING_PAIRS, NOMINAL, SLICE, WEIGHTS, need
from vlmm_log.api import Processed, process
from vlmm_log.elements import Element, MotionClass
from vlmm_log.settings import Settings

YOLO = WEIGHTS / "yolov8n-seg.onnx"


def mapped(source: Path, *sets: str) -> Processed:
    """The map of a log, nothing written."""
    return process(source, settings=Settings.load(sets=sets))


def spans(e: Element, origin_ns: int) -> str:
    """Motion intervals in seconds from the first frame."""
    return ", ".join(f"{(a - origin_ns) / 1e9:.1f}-{(b - origin_ns) / 1e9:.1f} s" for a, b in e.intervals.tolist())


def row(e: Element, origin_ns: int) -> str:
    """One element in a line."""
    seen = e.evidence.observations
    kind = e.motion_class.name.lower()
    frames = f"frames {seen['index'].min()}-{seen['index'].max()}"
    figures = f"o {e.o:5.2f} kappa {e.kappa:.2f} largest part {seen['part'].max():.2f}"
    return (
        f"  {e.id:3d} {e.label or '-':14} {len(seen):3d} pairs, {frames:13} {kind:15} {figures}  {spans(e, origin_ns)}"
    )


def show(title: str, done: Processed, elements: Iterable[Element]) -> None:
    """Some of a map's elements."""
    print(f"{title}: {done.end.pairs} pairs, {len(done.map.world.elements)} elements")
    for e in elements:
        print(row(e, done.map.origin_ns))


def main() -> None:
    need(SLICE)
    if YOLO.exists():
        done = mapped(SLICE, f"objects.segmenter=yolo:{YOLO}")
        everything = list(done.map.world.elements.values())
        show("slice, YOLOv8n", done, everything)
        people = [e for e in everything if "person" in e.evidence.votes]
        screens = [e for e in everything if e.label in ("tv", "laptop", "keyboard")]
        print(f"  ids that were ever called a person: {len(people)} (at most 2)")
        moving = sum(e.motion_class is MotionClass.MOVING for e in screens)
        print(f"  screens and keyboards: {len(screens)}, of them moving: {moving} (0)")
    door = mapped(MOVING_PAIRS / "opening_door", "keyframes.gap=1", f"read.intrinsics={NOMINAL}")
    show("\nopening door, geometric", door, door.map.world.elements.values())
    fruit = mapped(DATA / "fruit_on_table", "keyframes.gap=1")
    moved = [e for e in fruit.map.world.elements.values() if e.intervals.size or e.motion_class is MotionClass.MOVING]
    show("\nfruit on a table, geometric, what moved", fruit, moved)


if __name__ == "__main__":
    main()
