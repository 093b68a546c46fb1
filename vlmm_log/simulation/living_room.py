"""A living room: a coffee table, seats, a television; a door that swings, a ball, someone walking by."""

from __future__ import annotations

import numpy as np

from vlmm_log.simulation import building, furniture
from vlmm_log.simulation import materials as m
from vlmm_log.simulation.appliances import MACHINES
from vlmm_log.simulation.household import SMALL, plant
from vlmm_log.simulation.layout import Surface, spread, standing
from vlmm_log.simulation.meshes import box
from vlmm_log.simulation.motions import Walk
from vlmm_log.simulation.movers import course, hinged
from vlmm_log.simulation.person import walker
from vlmm_log.simulation.shapes import shift, solid, turn
from vlmm_log.simulation.tabletop import basketball, pushed, raised, rolling
from vlmm_log.simulation.things import Scene, Thing, hand_held

Rng = np.random.Generator
BACK, HALF = 5.0, 2.4  # m


def living_room(rng: Rng, duration_s: float) -> Scene:
    """The scene of a seed; some of its movers start or stop within ``duration_s``."""
    looks = {"floor": m.wood(rng, 0.5), "wall": m.wallpaper(rng, 0.55), "ceiling": m.plaster(rng, 0.12)}
    things = building.shell(2 * HALF, -1.2, BACK, 2.55, looks)
    things += _back(rng) + _seats(rng) + _table(rng, duration_s) + _door(rng, duration_s)
    ground = Surface((0.1, 2.75), 1.5, 0.3, 0.0)
    things.append(rolling(ground, "basket ball", basketball(rng), 2.75, 1.1, 0.45, rng, duration_s))
    walk = Walk(np.array([-0.1, 3.62]), (0.82, 0.28), float(rng.choice([-1, 1])) * 0.6, float(rng.uniform(0, 6.28)))
    things.append(walker(rng, walk))
    return Scene("living_room", tuple(things), hand_held(rng, (0.0, 0.0, 1.42), 0.21), (-0.2, 2.2, 2.45))


def _back(rng: Rng) -> list[Thing]:
    """Along the far wall: window, television, shelves with things on them."""
    timber = m.wood(rng, 0.4)
    things = [building.still("window", building.window(rng, 0.62, 1.15), standing(-1.85, BACK, 0.95))]
    wings = [(x, building.curtain(rng, 0.24, 1.75)) for x in (-2.22, -1.48)]
    things += [building.still("curtains", wing, standing(x, BACK - 0.02, 0.5)) for x, wing in wings]
    things.append(building.still("tv stand", furniture.carcass(1.3, 0.42, 0.48, timber), standing(-0.62, 4.72)))
    things.append(building.still("television", MACHINES["television"](rng), standing(-0.62, 4.74, 0.48)))
    things.append(building.still("painting", building.picture(rng, 0.7, 0.5), standing(-0.62, BACK, 1.55)))
    unit = furniture.shelves(0.8, 0.34, 1.75, 4, timber, m.lacquer(rng, 0.8))
    things.append(building.still("shelving unit", unit, standing(0.62, 4.8)))
    levels = furniture.board_heights(1.75, 4)
    pool = ["statue", "vase", "box", "teddy bear", "tissue box", "speaker", "kettle", "alarm clock"]
    names = [str(n) for n in rng.choice(pool, 4, replace=False)]
    for k, z in enumerate([*levels[2:], 1.75]):
        place = Surface((0.62, 4.78), 0.72, 0.28, z + 0.001)
        things += spread(place, names[k : k + 2] if k == 0 else [names[k + 1]], SMALL | MACHINES, rng)
    things.append(building.still("light switch", building.light_switch(rng), standing(1.2, BACK, 1.25)))
    return things


def _seats(rng: Rng) -> list[Thing]:
    jitter = [float(x) for x in rng.uniform(-0.06, 0.06, 6)]
    sofa = furniture.sofa(rng, 1.75)
    things = [building.still("sofa", sofa, standing(-1.93, 3.5 + jitter[0], 0, np.pi / 2))]
    for y in (3.1, 3.85):
        T = standing(-1.92, y + jitter[0], 0.45) @ turn("z", np.pi / 2) @ shift(0, -0.02, 0.0) @ turn("x", 1.15)
        things.append(building.still("pillow", SMALL["pillow"](rng), T))
    chair = furniture.sofa(rng, 0.9)
    things.append(building.still("arm chair", chair, standing(1.78, 3.3 + jitter[1], 0, -1.2 + jitter[2])))
    things.append(building.still("floor lamp", MACHINES["floor lamp"](rng), standing(-1.4, 4.62)))
    things.append(building.still("house plant", plant(rng, 0.85), standing(1.06, 4.2 + jitter[3])))
    things.append(building.still("ottoman", furniture.ottoman(rng), standing(-1.1, 2.3, 0, jitter[4])))
    small = furniture.table(0.46, 0.46, 0.5, m.wood(rng))
    things.append(building.still("side table", small, standing(1.2, 2.28, 0, jitter[5])))
    place = Surface((1.2, 2.28), 0.42, 0.42, 0.5)
    lying = str(rng.choice(["book", "tissue box"]))
    return things + spread(place, ["desk lamp", lying], SMALL | MACHINES, rng)


def _table(rng: Rng, duration_s: float) -> list[Thing]:
    """A coffee table; a toy car drives on it, something is lifted, something pushed."""
    things = [
        building.still("coffee table", furniture.table(1.25, 0.7, 0.45, m.wood(rng, 0.6)), standing(0, 1.72)),
        building.still("carpet", solid(box(1.9, 1.25, 0.012), m.fabric(rng)), standing(0.05, 1.85)),
    ]
    top = Surface((0.0, 1.72), 1.2, 0.66, 0.45)
    things.append(pushed(top, "toy car", SMALL["toy car"](rng), 1.47, 0.45, 0.22, rng, duration_s))
    name = str(rng.choice(["book", "box"]))
    things.append(pushed(top, name, SMALL[name](rng), 1.88, 0.3, 0.2, rng, duration_s))
    name = str(rng.choice(["mug", "candle", "cup"]))
    things.append(raised(top, name, SMALL[name](rng), rng, duration_s))
    pool = ["remote control", "cell phone", "bowl", "mug", "candle", "apple", "plate", "wine bottle"]
    names = [str(n) for n in rng.choice(pool, 6, replace=False)]
    return things + spread(top, ["laptop", *names], SMALL | MACHINES, rng)


def _door(rng: Rng, duration_s: float) -> list[Thing]:
    """A door at the right of the far wall; behind it, it is dim."""
    width, height = 0.8, 1.98
    frame = building.door_frame(width, height, m.lacquer(rng, 0.8))
    dim = solid(box(width, 0.01, height), m.plain(rng, 0.08, 0.3, 0.22), width / 2, 0.045, 0)
    leaf = furniture.leaf(width, height, m.lacquer(rng, 0.7), m.metal(rng))
    T = standing(1.42, BACK - 0.06)
    things = [building.still("door frame", frame + dim, T)]
    return [*things, hinged("door", leaf, T @ shift(0.0, -0.06, 0.008), course(rng, 1.2, 0.7, duration_s), -1.0)]
