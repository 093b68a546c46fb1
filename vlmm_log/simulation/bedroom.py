"""A bedroom: a desk before a bed; a closet and a drawer that open, a chair that is pushed, a ball."""

from __future__ import annotations

import numpy as np

from vlmm_log.simulation import building, furniture
from vlmm_log.simulation import materials as m
from vlmm_log.simulation.appliances import MACHINES
from vlmm_log.simulation.household import SMALL
from vlmm_log.simulation.layout import Surface, spread, standing
from vlmm_log.simulation.movers import ALONG, FORWARD, course, hinged, slid
from vlmm_log.simulation.shapes import shift, turn
from vlmm_log.simulation.tabletop import basketball, pushed, raised, rolling
from vlmm_log.simulation.things import Scene, Thing, hand_held

Rng = np.random.Generator
BACK = 4.6  # m


def bedroom(rng: Rng, duration_s: float) -> Scene:
    """The scene of a seed; some of its movers start or stop within ``duration_s``."""
    looks = {"floor": m.fabric(rng), "wall": m.wallpaper(rng, 0.1), "ceiling": m.plaster(rng, 0.15)}
    things = building.shell(4.5, -1.2, BACK, 2.5, looks)
    things += _bed(rng) + _walls(rng) + _dresser(rng, duration_s) + _closet(rng, duration_s)
    things += _desk(rng, duration_s) + _floor(rng, duration_s)
    return Scene("bedroom", tuple(things), hand_held(rng, (0.0, 0.0, 1.48), 0.2), (0.0, 2.0, 2.4))


def _bed(rng: Rng) -> list[Thing]:
    things = [building.still("bed", furniture.bed(rng, 1.45, 1.95), standing(-1.25, 3.55))]
    for x in (-1.6, -0.9):
        T = standing(x, 4.22, 0.5, float(rng.uniform(-0.1, 0.1))) @ turn("x", 0.35)
        things.append(building.still("pillow", SMALL["pillow"](rng), T))
    cover = Surface((-1.25, 3.25), 1.25, 1.0, 0.516)
    pool = ["cloth", "book", "laptop", "box", "tissue box"]
    names = ["teddy bear", *(str(n) for n in rng.choice(pool, 2, replace=False))]
    return things + spread(cover, names, SMALL | MACHINES, rng)


def _walls(rng: Rng) -> list[Thing]:
    things = [
        building.still("window", building.window(rng, 0.95, 0.95), standing(-1.45, BACK, 1.25)),
        building.still("blinds", building.blinds(rng, 0.9, 0.35), standing(-1.45, BACK, 1.83)),
        building.still("mirror", building.mirror(rng, 0.55, 0.75), standing(0.55, BACK, 1.15)),
        building.still("poster", building.poster(rng, 0.4, 0.55), standing(-0.62, BACK, 1.35)),
        building.still("light switch", building.light_switch(rng), standing(0.07, BACK, 1.2)),
    ]
    board = building.board(0.62, 0.24, m.wood(rng))
    things.append(building.still("shelf", board, standing(-0.2, BACK, 1.72)))
    place = Surface((-0.2, BACK - 0.12), 0.58, 0.2, 1.72)
    names = [str(n) for n in rng.choice(["statue", "vase", "speaker"], 2, replace=False)]
    return things + spread(place, names, SMALL | MACHINES, rng)


def _dresser(rng: Rng, duration_s: float) -> list[Thing]:
    """Three drawers, one of which is pulled; a bedside table beside it."""
    timber, handle = m.wood(rng, 0.5), m.metal(rng)
    face, x, width = 4.1, 0.55, 0.8
    case = furniture.carcass(width, 0.48, 0.86, timber, ())
    things = [building.still("dresser", case, standing(x, face + 0.24))]
    pulled = int(rng.integers(1, 3))
    for k in range(3):
        height = 0.255
        tray = furniture.drawer(width - 0.045, 0.38, height, m.lacquer(rng) if k == 1 else timber, handle)
        T = standing(x, face, 0.035 + k * (height + 0.012))
        way = course(rng, 0.28, 0.22, duration_s)
        things.append(slid("drawer", tray, T, FORWARD, way) if k == pulled else building.still("drawer", tray, T))
    things += spread(Surface((x, face + 0.24), 0.75, 0.42, 0.86), ["vase", "box"], SMALL, rng)
    small = furniture.table(0.42, 0.4, 0.55, m.wood(rng))
    things.append(building.still("side table", small, standing(-0.2, 4.32)))
    return things + spread(Surface((-0.2, 4.32), 0.38, 0.36, 0.55), ["desk lamp"], MACHINES, rng)


def _closet(rng: Rng, duration_s: float) -> list[Thing]:
    """Two leaves, the left one swings."""
    timber, handle = m.lacquer(rng, 0.72), m.metal(rng)
    face, left, width, height = 4.02, 1.08, 1.0, 1.95
    things = [
        building.still("closet", furniture.carcass(width, 0.55, height, timber), standing(left + 0.5, face + 0.276))
    ]
    leaf = furniture.leaf(0.496, height, timber, handle)
    motion = course(rng, 1.3, 0.8, duration_s)
    things.append(hinged("closet", leaf, standing(left, face - 0.03), motion, -1.0))
    closed = standing(left + width, face - 0.03) @ turn("z", np.pi)
    return [*things, building.still("closet", leaf, closed)]


def _desk(rng: Rng, duration_s: float) -> list[Thing]:
    """A desk near the camera; a toy car drives on it, a book is lifted."""
    things = [building.still("desk", furniture.table(1.25, 0.7, 0.74, m.wood(rng, 0.6)), standing(0.42, 1.6))]
    top = Surface((0.42, 1.6), 1.2, 0.66, 0.74)
    things.append(pushed(top, "toy car", SMALL["toy car"](rng), 1.36, 0.4, 0.2, rng, duration_s))
    name = str(rng.choice(["mug", "cup", "candle"]))
    things.append(raised(top, name, SMALL[name](rng), rng, duration_s))
    pool = ["book", "cell phone", "mug", "remote control", "tissue box", "candle", "bottle", "bowl"]
    names = ["laptop", "alarm clock", *(str(n) for n in rng.choice(pool, 5, replace=False))]
    return things + spread(top, names, SMALL | MACHINES, rng)


def _floor(rng: Rng, duration_s: float) -> list[Thing]:
    ground = Surface((-0.75, 2.3), 1.0, 0.3, 0.0)
    things = [rolling(ground, "basket ball", basketball(rng), 2.3, 0.6, 0.35, rng, duration_s)]
    way = course(rng, 0.75, 0.35, duration_s)
    things.append(slid("chair", furniture.chair(rng), standing(0.35, 2.9) @ shift(0, 0), ALONG, way))
    things.append(building.still("laundry hamper", SMALL["laundry hamper"](rng), standing(1.85, 3.4)))
    things.append(building.still("garbage can", SMALL["garbage can"](rng), standing(-0.2, 3.75)))
    things.append(building.still("boots", SMALL["boots"](rng), standing(-0.28, 3.0, 0, 0.3)))
    things.append(building.still("vacuum cleaner", MACHINES["vacuum cleaner"](rng), standing(1.75, 2.85, 0, 0.5)))
    return things
