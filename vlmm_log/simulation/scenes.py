"""The scenes by name."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from vlmm_log.simulation.bedroom import bedroom
from vlmm_log.simulation.kitchen import kitchen
from vlmm_log.simulation.living_room import living_room
from vlmm_log.simulation.things import Scene
from vlmm_log.types import InputError

SCENES: dict[str, Callable[[np.random.Generator, float], Scene]] = {
    "kitchen": kitchen,
    "living_room": living_room,
    "bedroom": bedroom,
}


def drawn(name: str, seed: int, duration_s: float) -> Scene:
    """The scene of a name and a seed. Raises InputError for an unknown name."""
    if name not in SCENES:
        raise InputError(f"scene {name!r}: there are {', '.join(SCENES)}")
    return SCENES[name](np.random.default_rng([seed, *name.encode()]), duration_s)
