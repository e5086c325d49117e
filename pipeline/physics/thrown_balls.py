"""Balls to throw into a scene, which wait far away until then."""

from __future__ import annotations

from itertools import cycle

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from kinefilter.characters import Prop
from kinefilter.characters.humanoid import to_mujoco

_MASS, _COUNT, _RADIUS = 5.0, 6, 0.13  # kg, and m: medicine balls
_NAME = "thrown ball"
_COLOR = (0.75, 0.22, 0.17, 1.0)
_PARKED = (-300.0, 0.0)  # m: where they wait on the floor, too far away to be seen


class ThrownBalls:
    """The balls of a world; the one thrown longest ago is the next."""

    def __init__(self) -> None:
        self._names = cycle([f"{_NAME} {k + 1}" for k in range(_COUNT)])

    @staticmethod
    def add_to(spec: mujoco.MjSpec) -> None:
        """Add the balls to a scene that is to be compiled."""
        x, y = _PARKED
        for k in range(_COUNT):
            name, place = f"{_NAME} {k + 1}", [x, y + 3.0 * k * _RADIUS, _RADIUS]
            ball = spec.worldbody.add_body(name=name, pos=place)
            ball.add_freejoint(name=name)
            ball.add_geom(
                name=name,
                type=mujoco.mjtGeom.mjGEOM_SPHERE,
                size=[_RADIUS, 0.0, 0.0],
                mass=_MASS,
                condim=6,
                friction=[0.8, 0.005, 0.01],
                rgba=_COLOR,
            )

    def throw(
        self, data: mujoco.MjData, origin: ArrayLike, velocity: ArrayLike
    ) -> None:
        """Throw the next ball from a point [m], (3,), with a velocity [m/s], (3,)."""
        joint = data.joint(next(self._names))
        joint.qvel[:] = 0.0
        joint.qpos[:3] = to_mujoco(np.asarray(origin, dtype=float))
        joint.qvel[:3] = to_mujoco(np.asarray(velocity, dtype=float))


def is_parked(prop: Prop) -> bool:
    """Return True for a ball that has not been thrown."""
    far = to_mujoco(prop.positions)[:, 0] < 0.9 * _PARKED[0]
    return prop.name.startswith(_NAME) and bool(far.all())
