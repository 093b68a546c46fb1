"""A kitchen: a laid table before a row of cabinets, someone walking between."""

from __future__ import annotations

import numpy as np

from vlmm_log.simulation import building, furniture
from vlmm_log.simulation import materials as m
from vlmm_log.simulation.appliances import MACHINES
from vlmm_log.simulation.household import SMALL
from vlmm_log.simulation.layout import Surface, spread, standing
from vlmm_log.simulation.materials import Material
from vlmm_log.simulation.meshes import box, joined, moved
from vlmm_log.simulation.motions import Walk
from vlmm_log.simulation.movers import FORWARD, course, hinged, slid
from vlmm_log.simulation.person import walker
from vlmm_log.simulation.shapes import Shape, assembled, shift, solid
from vlmm_log.simulation.tabletop import pushed, raised, rolling
from vlmm_log.simulation.things import Scene, Thing, hand_held

Rng = np.random.Generator
BACK, FACE = 4.1, 3.5  # m: wall, fronts of the lower cabinets
TOP = 0.92  # m
UNIT = 0.6  # m


def kitchen(rng: Rng, duration_s: float) -> Scene:
    """The scene of a seed; some of its movers start or stop within ``duration_s``."""
    looks = {"floor": m.tiles(rng, 0.08, 0.33), "wall": m.plaster(rng, 0.12), "ceiling": m.plaster(rng, 0.1)}
    wood, handle = (m.wood(rng) if rng.uniform() < 0.5 else m.lacquer(rng)), m.metal(rng)
    things = building.shell(4.3, -1.2, BACK, 2.5, looks)
    things += _lower(rng, wood, handle, duration_s) + _upper(rng, wood, handle, duration_s) + _wall(rng)
    things += _counter(rng) + _table(rng, duration_s) + _floor(rng)
    walk = Walk(np.array([0.15, 2.88]), (0.9, 0.24), float(rng.choice([-1, 1])) * 0.55, float(rng.uniform(0, 6.28)))
    things.append(walker(rng, walk))
    return Scene("kitchen", tuple(things), hand_held(rng, (0.0, 0.0, 1.5), 0.2), (0.3, 1.6, 2.4))


def _lower(rng: Rng, wood: Material, handle: Material, duration_s: float) -> list[Thing]:
    """Five units under the counter, one of drawers, of which the upper one is pulled."""
    things = []
    pulled = course(rng, 0.3, 0.22, duration_s)
    for k in range(5):
        x, T = -2.15 + UNIT * (k + 0.5), standing(-2.15 + UNIT * (k + 0.5), FACE)
        if k != 1:
            whole = furniture.front(UNIT - 0.012, 0.72, wood, handle) + solid(
                box(UNIT, 0.5, 0.78), wood, 0, 0.28, -0.08
            )
            things.append(building.still("cabinet", whole, T @ shift(0, 0, 0.1)))
            continue
        things.append(
            building.still("cabinet", furniture.carcass(UNIT, 0.55, 0.86, wood, ()), T @ shift(0, 0.275, 0.02))
        )
        for z, height in ((0.12, 0.36), (0.5, 0.35)):
            tray = furniture.drawer(UNIT - 0.045, 0.4, height, wood, handle)
            at = standing(x, FACE, z)
            things.append(slid("drawer", tray, at, FORWARD, pulled) if z > 0.4 else building.still("drawer", tray, at))
    top = m.tiles(rng, 0.6, 0.6)
    things.append(building.still("counter top", solid(box(3.02, 0.64, 0.04), top), standing(-0.65, 3.79, 0.88)))
    return things


def _upper(rng: Rng, wood: Material, handle: Material, duration_s: float) -> list[Thing]:
    """Cabinets on the wall, one with a door that swings."""
    w, d, h, z = 0.52, 0.32, 0.68, 1.42
    things = []
    for k, x in enumerate((-1.75, -1.22, 0.63)):
        T = standing(x, BACK - d, z)
        things.append(building.still("cabinet", furniture.carcass(w, d, h, wood), T @ shift(0, d / 2 + 0.001)))
        leaf = furniture.front(w - 0.01, h, wood, handle)
        if k == 0:
            hung = assembled(*(solid(moved(p.mesh, shift(w / 2, 0)), p.material) for p in leaf.pieces))
            motion = course(rng, 1.35, 0.9, duration_s)
            things.append(hinged("cabinet door", hung, T @ shift(-w / 2, -0.002), motion, -1.0))
        else:
            things.append(building.still("cabinet door", leaf, T))
    return things


def _wall(rng: Rng) -> list[Thing]:
    things = [building.still("window", building.window(rng, 0.95, 0.85), standing(-0.3, BACK, 1.2))]
    things.append(building.still("wall clock", building.wall_clock(rng), standing(1.55, BACK, 1.95)))
    things += [
        building.still("curtains", building.curtain(rng, 0.24, 1.0), standing(x, BACK, 1.1)) for x in (-0.84, 0.24)
    ]
    return things


def _counter(rng: Rng) -> list[Thing]:
    """Sink and stove let in, machines and vessels between."""
    metal = m.metal(rng, 0.7)
    things = [building.still("sink", _basin(metal), standing(-0.3, 3.76, TOP))]
    things.append(building.still("faucet", MACHINES["faucet"](rng), standing(-0.3, 3.99, TOP)))
    burners = [(x, y) for x in (0.38, 0.68) for y in (3.62, 3.9)]
    things += [building.still("stove burner", MACHINES["stove burner"](rng), standing(x, y, TOP)) for x, y in burners]
    for name, at in zip(("pot", "pan"), rng.permutation(np.array([burners[1], burners[3]])), strict=True):
        things.append(building.still(name, SMALL[name](rng), standing(at[0], at[1], TOP + 0.02, 2.6)))
    left = Surface((-1.4, 3.76), 1.45, 0.5, TOP)
    pool = ["toaster", "coffee machine", "kettle", "bread", "wine bottle", "vase"]
    names = ["microwave", *rng.choice(pool, 4, replace=False)]
    things += spread(left, [str(n) for n in names], SMALL | MACHINES, rng)
    return things + spread(Surface((0.05, 3.68), 0.24, 0.4, TOP), ["soap bottle", "dish sponge"], SMALL, rng)


def _basin(material: Material) -> Shape:
    walls = [moved(box(0.5, 0.02, 0.045), shift(0, y)) for y in (-0.17, 0.17)]
    walls += [moved(box(0.02, 0.36, 0.045), shift(x, 0)) for x in (-0.25, 0.25)]
    return solid(joined(*walls, box(0.5, 0.34, 0.006)), material)


def _table(rng: Rng, duration_s: float) -> list[Thing]:
    """A laid table; an apple rolls along its near edge, something is pushed, something lifted."""
    timber = m.wood(rng, 0.5)
    things = [building.still("dining table", furniture.table(1.5, 0.8, 0.74, timber), standing(0, 1.6))]
    top = Surface((0.0, 1.6), 1.4, 0.74, 0.74)
    things.append(rolling(top, "apple", SMALL["apple"](rng), 1.3, 0.4, 0.2, rng, duration_s))
    name = str(rng.choice(["bowl", "box", "plate"]))
    things.append(pushed(top, name, SMALL[name](rng), 1.55, 0.4, 0.25, rng, duration_s))
    name = str(rng.choice(["mug", "cup", "bottle"]))
    things.append(raised(top, name, SMALL[name](rng), rng, duration_s))
    pool = [
        "mug",
        "cup",
        "bottle",
        "wine bottle",
        "lettuce",
        "tomato",
        "potato",
        "book",
        "vase",
        "paper towel roll",
        "bowl",
    ]
    return things + spread(top, ["plate", *(str(n) for n in rng.choice(pool, 7, replace=False))], SMALL, rng)


def _floor(rng: Rng) -> list[Thing]:
    steel = m.metal(rng, 0.68)
    parts = [solid(box(0.72, 0.62, 1.75), steel), solid(box(0.7, 0.05, 1.1), steel, 0, -0.335, 0.02)]
    parts += [solid(box(0.7, 0.05, 0.6), steel, 0, -0.335, 1.14)]
    parts += [solid(box(0.03, 0.05, 0.4), m.plastic(rng), -0.28, -0.38, z) for z in (0.65, 1.2)]
    things = [building.still("fridge", assembled(*parts), standing(1.37, 3.75))]
    yaw = [float(a) for a in rng.uniform(-0.2, 0.2, 4)]
    things.append(building.still("chair", furniture.chair(rng), standing(-0.45, 2.02, 0, yaw[0] / 3)))
    things.append(building.still("chair", furniture.chair(rng), standing(0.5, 2.02, 0, yaw[1] / 3)))
    things.append(building.still("stool", furniture.stool(rng), standing(-1.42, 2.75, 0, yaw[2])))
    things.append(building.still("garbage can", SMALL["garbage can"](rng), standing(1.75, 3.1, 0, yaw[3])))
    return things
