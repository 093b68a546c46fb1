"""Entries read back, as a recording to look at: with the shapes and names that recordings do not give back."""

from __future__ import annotations

from vlmm_log.entries import Arrows, Boxes, Entry, LabelNames, StateNames, States, Table, Value
from vlmm_log.sinks.content import VALIDITY_NAMES
from vlmm_log.sinks.map_entries import CLEAR, MAP, element_ellipsoids, id_color, mask_classes
from vlmm_log.sinks.pair_entries import IMAGE, JUDGED_NAMES, MOVED, VECTORS
from vlmm_log.sinks.recorder import Container
from vlmm_log.sinks.rerun_values import RerunValues

ELEMENTS = f"{MAP}/elements"


class Redrawn:
    """Puts entries, and draws again what only decides how they look."""

    def __init__(self, to: RerunValues | Container) -> None:
        self._to = to
        self._names: dict[int, str] = {}  # of elements in the masks
        self._labels: dict[str, str] = {}  # of elements, by their entity
        self._lanes: set[str] = set()  # entities with states
        self._judged: set[str] = set()  # of the truth and the outcome, those that were named
        to.put(Entry(f"{IMAGE}/validity", VALIDITY_NAMES, None, None))

    def put(self, entry: Entry) -> None:
        """One entry."""
        if isinstance(entry.value, Boxes):
            boxes = entry.value
            named = zip(mask_classes(boxes.ids), boxes.ids, boxes.names, strict=True)
            self._names |= {int(c): f"{i} {name}" for c, i, name in named if name}
        if isinstance(entry.value, Table) and entry.entity == ELEMENTS:
            columns = entry.value.columns
            told = zip(columns.get("element_id", ()), columns.get("label", ()), strict=True)
            self._labels |= {f"{ELEMENTS}/{i}": str(label) for i, label in told}
        if isinstance(entry.value, States):
            self._lanes.add(entry.entity)
        if entry.entity in JUDGED_NAMES and entry.entity not in self._judged:
            self._judged.add(entry.entity)
            self._to.put(Entry(entry.entity, JUDGED_NAMES[entry.entity], None, None))
        self._to.put(Entry(entry.entity, _shown(entry.entity, entry.value), entry.stamp_ns, entry.index))

    def rest(self) -> None:
        """What is known once all entries were put."""
        classes = tuple((c, name, id_color(c)) for c, name in sorted(self._names.items()))
        self._to.put(Entry(f"{IMAGE}/instances", LabelNames(((0, "", CLEAR), *classes)), None, None))
        for entity in sorted(self._lanes):
            self._to.put(Entry(entity, StateNames(self._labels.get(entity, "")), None, None))


def _shown(entity: str, value: Value) -> Value:
    match value:
        case Table(columns) if entity == ELEMENTS and len(value):
            return Table(columns, element_ellipsoids(columns))
        case Arrows(origins, vectors) if entity == VECTORS:
            return Arrows(origins, vectors, MOVED)
        case _:
            return value
