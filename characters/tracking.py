"""How hard a target pulls the humanoid."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Literal

import numpy as np

from .arrays import as_number
from .errors import InputError


@dataclass(frozen=True)
class Tracking:
    """Gains and bounds of the pull; every one above 0, or InputError is raised."""

    natural_frequency: float = 60.0
    """Natural frequency of the pull [rad/s]. The gains follow, critically damped, from
    it and the mass of each part: kp = m w^2, kv = 2 m w. 60 follows a clean
    motion within 3 mm on average and filters what is faster than 10 Hz."""
    twist_frequency: float = 40.0
    """Natural frequency of the torque about the segment axis [rad/s]. A guess."""
    largest_acceleration: float = 200.0
    """Bound of the force on a part: its mass times this [m/s^2]. About twice the
    peak acceleration of a boxer's fist."""
    largest_angular_acceleration: float = 4000.0
    """Bound of the torque on a part: the inertia its gains are made for times this
    [rad/s^2]. A guess."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = as_number(getattr(self, field.name), field.name)
            if not 0.0 < value < np.inf:
                raise InputError(
                    f"{field.name} of the tracking is {value:g}; give a finite number "
                    "above 0"
                )


@dataclass(frozen=True)
class GameTracking(Tracking):
    """A character that gives way where it is hit, and comes back to the performer.

    ``kinefilter.pipeline.physics.compliance`` says how. All constants are guesses,
    tried on recorded takes.
    """

    sway_frequency: float = 9.0
    """Natural frequency of the body's sway on its feet after a blow, critically damped
    [rad/s]: as that of somebody who stands, and is back after a second."""
    hit_frequency: float = 30.0
    """Natural frequency of the pull where the body is hit [rad/s], until it is back."""
    felling_speed: float = 2.5
    """A blow that would make the whole body this fast [m/s] fells it."""
    lying: float = 1.0
    """How long nothing pulls a felled body [s]."""
    rising: float = 1.5
    """How long the pull takes to come back then [s]."""
    return_speed: float = 2.5
    """How fast the body comes back to where the performer is, once it stands [m/s]."""


@dataclass(frozen=True)
class RagdollTracking(Tracking):
    """A character that nothing pulls, until somebody takes hold of it."""


TRACKINGS = {
    "faithful": Tracking(),
    "game": GameTracking(),
    "ragdoll": RagdollTracking(),
}
"""Ways to follow the performer, by name."""
TrackingName = Literal["faithful", "game", "ragdoll"]
