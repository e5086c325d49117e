"""Gains and bounds of the forces that pull the humanoid to its target."""

from dataclasses import dataclass, fields
from typing import Literal

import numpy as np

from .arrays import as_number
from .errors import InputError


@dataclass(frozen=True)
class Tracking:
    """Gains and bounds of the pull. Raises InputError unless all are above 0."""

    natural_frequency: float = 60.0
    """Natural frequency of the pull [rad/s]. With critical damping, it and the mass m
    of each part give the gains: kp = m w^2, kv = 2 m w. 60 follows a clean motion
    within 3 mm on average and filters out what is faster than 10 Hz."""
    twist_frequency: float = 40.0
    """Natural frequency of the torque about the segment axis [rad/s]. A guess."""
    largest_acceleration: float = 200.0
    """Bound on the force on a part, divided by its mass [m/s^2]. About twice the peak
    acceleration of a boxer's fist."""
    largest_angular_acceleration: float = 4000.0
    """Bound on the torque on a part, divided by the inertia that its gains are based on
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
    """Tracking of a character that yields to hits, then returns to the performer.

    See ``kinefilter.pipeline.physics.compliance``. Guesses, tuned on recorded takes.
    """

    sway_frequency: float = 9.0
    """Natural frequency [rad/s] of the body's critically damped sway about its feet
    after a blow: like a standing person, it recovers within a second."""
    hit_frequency: float = 30.0
    """Natural frequency [rad/s] of the pull where the body is hit, until it is back."""
    felling_speed: float = 2.5
    """A blow that would give the whole body this speed [m/s] knocks it down."""
    lying: float = 1.0
    """Time for which nothing pulls a character that was knocked down [s]."""
    rising: float = 1.5
    """Time over which the pull then returns [s]."""
    return_speed: float = 2.5
    """Speed at which the character, once upright, returns to the performer [m/s]."""


@dataclass(frozen=True)
class RagdollTracking(Tracking):
    """Tracking of a character that nothing pulls until it is grabbed."""


TRACKINGS = {
    "faithful": Tracking(),
    "game": GameTracking(),
    "ragdoll": RagdollTracking(),
}
"""Ways to follow the performer, by name."""
TrackingName = Literal["faithful", "game", "ragdoll"]
