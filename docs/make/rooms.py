"""The house by its imports: docs/rooms.svg, and the table of docs/architecture.md. python docs/make/rooms.py

A room is a folder of modules. Single files that import no room are the ground; the others, and what imports them,
are the roof.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping
from functools import cache
from html import escape
from itertools import pairwise
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PICTURE, PAGE = ROOT / "docs/rooms.svg", ROOT / "docs/architecture.md"
BEGIN, END = "<!-- rooms: made by docs/make/rooms.py -->", "<!-- end of rooms -->"
MOVED = ("readers", "pipeline")  # they stand at the top
GROUND, ROOF = "ground", "roof"
WIDTH, HEIGHT, GAP_X, GAP_Y, MARGIN, PASSAGE = 104, 34, 20, 60, 12, 24  # px

Graph = Mapping[str, frozenset[str]]


@cache
def imports() -> dict[str, frozenset[str]]:
    """File or folder below vlmm_log -> those that it imports."""
    found: dict[str, set[str]] = {}
    for top in ("vlmm_log", *MOVED):
        for path in sorted((ROOT / top).rglob("*.py")):
            parts = path.relative_to(ROOT / "vlmm_log" if top == "vlmm_log" else ROOT).with_suffix("").parts
            if parts[0] != "__init__":
                found.setdefault(parts[0], set()).update(_imported(path))
    return {name: frozenset(of & found.keys()) - {name} for name, of in found.items()}


def _imported(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        else:
            continue
        yield from (name.split(".")[1] for name in names if name.startswith("vlmm_log."))


def house() -> tuple[Graph, dict[str, list[str]]]:
    """What each room imports, ground and roof among them; and the files of these two."""
    of = imports()
    rooms = {name for name in of if (ROOT / name).is_dir() or (ROOT / "vlmm_log" / name).is_dir()}
    files = of.keys() - rooms
    ground = set(files)
    while above := {name for name in ground if of[name] - ground}:
        ground -= above
    roof = files - ground
    while joining := {name for name in rooms - roof if of[name] & roof}:
        roof |= joining
    place = {name: GROUND if name in ground else ROOF if name in roof else name for name in of}
    graph: dict[str, set[str]] = {}
    for name, imported in of.items():
        graph.setdefault(place[name], set()).update({place[other] for other in imported} - {place[name]})
    listed = {GROUND: sorted(ground), ROOF: sorted(f"{name}/" if name in rooms else name for name in roof)}
    return {name: frozenset(others) for name, others in graph.items()}, listed


def floors(graph: Graph) -> dict[str, int]:
    """How high a room stands: above all that it imports. Raises ValueError where imports run in a circle."""
    height: dict[str, int] = {}
    left = set(graph)
    while left:
        ready = {name for name in left if graph[name] <= height.keys()}
        if not ready:
            raise ValueError(f"imports run in a circle among {', '.join(sorted(left))}")
        height |= {name: 1 + max((height[other] for other in graph[name]), default=-1) for name in ready}
        left -= ready
    return height


def direct(graph: Graph) -> list[tuple[str, str]]:
    """The imports without those that another one implies: what is drawn."""
    below: dict[str, frozenset[str]] = {}
    for name, _ in sorted(floors(graph).items(), key=lambda item: item[1]):
        below[name] = frozenset().union(graph[name], *(below[other] for other in graph[name]))
    kept = (
        (name, other)
        for name, imported in graph.items()
        for other in imported
        if not any(other in below[between] for between in imported - {other})
    )
    return sorted(kept)


def picture() -> str:
    """The rooms as SVG: importers above what they import; roof and ground reach over all."""
    graph, _ = house()
    height, ways = floors(graph), {}
    rows: list[list[str]] = [[] for _ in range(max(height.values()) + 1)]
    for name in sorted(graph):
        rows[-1 - height[name]].append(name)
    for name, other in direct(graph):  # a line that passes a floor has a place of its own there
        between = [f"{name} > {other} {k}" for k in range(height[name] - 1, height[other], -1)]
        ways[name, other] = [name, *between, other]
        for k, place in enumerate(between):
            rows[-height[name] + k].append(place)
    _untangle(rows, [step for way in ways.values() for step in pairwise(way)])
    wide = max(sum(_width(name) for name in row) for row in rows)
    middle = {}
    for row in rows:
        left = MARGIN + (wide - sum(_width(name) for name in row)) / 2
        for name in row:
            middle[name] = left + _width(name) / 2
            left += _width(name)
    top = {name: MARGIN + k * (HEIGHT + GAP_Y) for k, row in enumerate(rows) for name in row}
    size = wide + 2 * MARGIN, max(top.values()) + HEIGHT + MARGIN
    drawn = [_line(way, middle, top) for way in ways.values()]
    drawn += [_room(name, middle[name], top[name], wide if name in (ROOF, GROUND) else WIDTH) for name in graph]
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {size[0]:g} {size[1]:g}" font-family="sans-serif"'
    title = "<title>Rooms of vlmm-log, and what imports what</title>"
    return "\n".join([f'{head} font-size="14">', title, *drawn, "</svg>\n"])


def _width(name: str) -> int:
    return PASSAGE if ">" in name else WIDTH + GAP_X


def _untangle(rows: list[list[str]], steps: list[tuple[str, str]]) -> None:
    """Order each floor by the mean place of what its rooms are joined to, a few times down and up."""
    for turn in range(12):
        for row in rows if turn % 2 else rows[::-1]:
            place = {name: (i + 0.5) / len(row) for row in rows for i, name in enumerate(row)}
            mean = {}
            for name in row:
                joined = [place[b if a == name else a] for a, b in steps if name in (a, b)]
                mean[name] = sum(joined) / len(joined)
            row.sort(key=lambda name: (mean[name], name))


def _line(way: list[str], middle: Mapping[str, float], top: Mapping[str, float]) -> str:
    """From room to room, straight through the floors between; roof and ground are met straight below or above."""
    x = [middle[name] for name in way]
    x[0] = x[1] if way[0] == ROOF else x[0]
    x[-1] = x[-2] if way[-1] == GROUND else x[-1]
    path = f"M{x[0]:g},{top[way[0]] + HEIGHT:g}"
    for (x0, x1), name, other in zip(pairwise(x), way, way[1:], strict=False):
        y0, y1 = top[name] + HEIGHT, top[other]
        path += f" C{x0:g},{(y0 + y1) / 2:g} {x1:g},{(y0 + y1) / 2:g} {x1:g},{y1:g} v{HEIGHT if '>' in other else 0}"
    return f'<path d="{path}" fill="none" stroke="#8a93a3" stroke-width="1.4"/>'


def _room(name: str, x: float, y: float, width: float) -> str:
    fill = {GROUND: "#e8dcc0", ROOF: "#e5cfcf"}.get(name, "#d9e6f2")
    place = f'x="{x - width / 2:g}" y="{y:g}" width="{width:g}" height="{HEIGHT}"'
    text = f'<text x="{x:g}" y="{y + HEIGHT / 2 + 5:g}" text-anchor="middle" fill="#111">{escape(name)}</text>'
    return f'<rect {place} rx="5" fill="{fill}" stroke="#44546a"/>{text}'


def table() -> str:
    """The rooms, and all that each imports, as Markdown."""
    graph, listed = house()
    height = floors(graph)
    rows = ["| room | imports |", "|---|---|"]
    for name in sorted(graph, key=lambda n: (-height[n], n)):
        imported = ", ".join(sorted(graph[name])) or "nothing of the project"
        rows.append(f"| `{name}` | {imported} |")
    told = [f"- *{name}*: {', '.join(f'`{file}`' for file in listed[name])}" for name in (ROOF, GROUND)]
    return "\n".join([*rows, "", "Roof and ground:", "", *told])


def page(text: str) -> str:
    """The architecture page with its table made again."""
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    return f"{before}{BEGIN}\n\n{table()}\n\n{END}{after}"


if __name__ == "__main__":
    PICTURE.write_text(picture(), "utf-8")
    PAGE.write_text(page(PAGE.read_text("utf-8")), "utf-8")
