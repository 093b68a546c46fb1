"""Someone who walks: ten rigid parts on an ellipse, arms and legs swinging."""

from __future__ import annotations

import numpy as np

from vlmm_log.simulation import materials as m
from vlmm_log.simulation.materials import Material
from vlmm_log.simulation.meshes import cushion, lathe, sphere
from vlmm_log.simulation.motions import Motion, Swing, Walk
from vlmm_log.simulation.shapes import Shape, assembled, solid
from vlmm_log.simulation.things import Body, Thing

HIP, KNEE, SHOULDER, ELBOW = 0.88, 0.43, 1.4, 0.29  # m: heights of hip and shoulder; lengths of thigh and upper arm
STRIDE_S = 1.5  # two steps
LEG, ARM = 0.21, 0.26  # rad of swing


def walker(rng: np.random.Generator, walk: Walk) -> Thing:
    """Torso, head, arms and legs of two parts each; trousers and jumper by chance."""
    top, trousers, skin, hair = m.fabric(rng), m.fabric(rng), m.plain(rng, 0.06, 0.4, 0.75), m.wood(rng, 0.25)
    rate = 2 * np.pi / STRIDE_S
    p = float(rng.uniform(0, 2 * np.pi))
    chest = solid(cushion(0.24, 0.4, 0.62, 0.55), top, 0, 0, 0.84) + solid(
        cushion(0.22, 0.33, 0.26, 0.6), trousers, 0, 0, 0.76
    )
    head = assembled(
        solid(sphere(0.105, 24), skin, 0, 0, 0.06),
        solid(cushion(0.22, 0.22, 0.14, 0.9), hair, -0.02, 0, 0.16),
        solid(lathe([(0.05, 0), (0.045, 0.1)], 16), skin, 0, 0, 0),
    )
    torso = Swing(walk, np.zeros(3), 0.02, 2 * rate, p)
    bodies = [
        _body(chest, torso),
        _body(head, Swing(torso, np.array([0.0, 0, SHOULDER + 0.02]), 0.05, 2 * rate, p + 1.0)),
    ]
    for side, phase in ((1, p), (-1, p + np.pi)):
        hip = Swing(walk, np.array([0.0, 0.1 * side, HIP]), LEG, rate, phase)
        knee = Swing(hip, np.array([0.0, 0, -KNEE]), 0.15, rate, phase + 1.4, 0.2)
        shoulder = Swing(torso, np.array([0.0, 0.235 * side, SHOULDER]), ARM, rate, phase + np.pi)
        elbow = Swing(shoulder, np.array([0.0, 0, -ELBOW]), 0.15, rate, phase + np.pi, -0.35)
        bodies += [_body(_limb(0.085, 0.062, KNEE, trousers), hip), _body(_shank(trousers, hair), knee)]
        bodies += [_body(_limb(0.06, 0.048, ELBOW, top), shoulder), _body(_forearm(top, skin), elbow)]
    return Thing("person", tuple(bodies), "walk", (0.0, 0.0, 1.1))


def _body(shape: Shape, motion: Motion) -> Body:
    return Body(shape, np.eye(4), motion)


def _limb(upper: float, lower: float, length: float, material: Material) -> Shape:
    """Hangs from the origin."""
    line = [
        (0.0, 0.05),
        (0.8 * upper, 0.04),
        (upper, 0.0),
        (lower, -length),
        (0.7 * lower, -length - 0.04),
        (0.0, -length - 0.045),
    ]
    return solid(lathe(line, 20), material)


def _shank(trousers: Material, shoe: Material) -> Shape:
    return _limb(0.06, 0.045, 0.36, trousers) + solid(cushion(0.27, 0.1, 0.09, 0.7), shoe, 0.06, 0, -0.45)


def _forearm(sleeve: Material, skin: Material) -> Shape:
    return _limb(0.048, 0.036, 0.22, sleeve) + solid(sphere(0.048, 16), skin, 0, 0, -0.34)
