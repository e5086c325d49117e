"""Pushes from outside, on parts of one character's body."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from kinefilter.characters import InputError
from kinefilter.characters.arrays import Array, Indices, as_number, as_numbers
from kinefilter.characters.humanoid import to_mujoco


class Pushes:
    """The pushes that last, each on the part that ends at a joint."""

    def __init__(self) -> None:
        self._lasting: list[tuple[int, Array, float]] = []

    def __bool__(self) -> bool:
        return bool(self._lasting)

    def add(self, joint: int, force: ArrayLike, seconds: float) -> None:
        """Add a push with a force [N], y up, (3,); InputError if it is not valid."""
        pushed = as_numbers(force, "the force of a push [N]", (3,), finite=True)
        lasting = as_number(seconds, "the duration of a push [s]")
        if not 0.0 <= lasting < np.inf:
            raise InputError(f"a push lasts {lasting:g} s; give 0 or more, and finite")
        self._lasting.append((joint, to_mujoco(pushed.astype(float)), lasting))

    def impulses(self, dt: float) -> Iterator[tuple[int, Array]]:
        """Yield each joint and its impulse [N s] in the next ``dt`` [s], z up."""
        for joint, force, left in self._lasting:
            yield joint, force * min(left, dt)

    def apply(self, data: mujoco.MjData, bodies: Indices, dt: float) -> Array:
        """Apply them for ``dt`` [s] to the bodies that end at joints; return the sum.

        A push that ends within that time is scaled to the impulse that is left.
        """
        total = np.zeros(3)
        for joint, impulse in self.impulses(dt):
            data.xfrc_applied[bodies[joint], :3] += impulse / dt
            total += impulse / dt
        self._lasting = [(j, f, left - dt) for j, f, left in self._lasting if left > dt]
        return total
