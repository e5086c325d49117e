"""Feet that bear the body: they press the floor with what the pulls carry of it."""

from __future__ import annotations

import mujoco

from kinefilter.characters.arrays import Flags, Indices

from .moves import Move

_LOADING_TIME = 0.2  # s from a foot's first contact to its bearing the body
_REACTION_TIME = 0.02  # s in which feet press as hard as the pulls carry. A guess.
_HARDEST_STEP = 2.0  # body weights that feet press with. A guess: running, landing


class StandingFeet:
    """Presses planted feet, bodies ``soles`` (2,) of the model, on the floor.

    Muscles act between body and feet, so that only the floor carries a ``weight`` [N].
    ``lifting`` is the upward force of all pulls in a substep [N], to be set after each.
    """

    def __init__(self, data: mujoco.MjData, soles: Indices, weight: float) -> None:
        self._upward, self._soles = data.xfrc_applied[:, 2], soles.tolist()
        self._weight = weight
        self.start()

    def start(self) -> None:
        """Reset the state to feet that bear nothing yet."""
        self._load = [0.0, 0.0]
        self.settle()

    def take_over(self, other: StandingFeet) -> None:
        """Bear what those of the same body bear in another world."""
        self._load = other._load
        self._carried: float = other._carried
        self.lifting: float = other.lifting

    def settle(self) -> None:
        """Assume that the pulls carry the body at rest."""
        self._carried = self.lifting = self._weight

    def begin(self, move: Move, stands: Flags | None) -> None:
        """Shift the weight toward the feet that stand (2,); none if that is None.

        All other forces on the feet have been applied.
        """
        wanted = [0.0, 0.0] if stands is None else stands.astype(float).tolist()
        if all(wanted):
            wanted = [move.left_share, 1.0 - move.left_share]
        most = move.duration / _LOADING_TIME
        self._load = [
            load + min(max(share - load, -most), most) if share > 0.0 else 0.0
            for load, share in zip(self._load, wanted, strict=True)
        ]
        forces = self._upward[self._soles].tolist()
        self._presses = list(zip(self._soles, self._load, forces, strict=True))
        self._began = self._carried, self.lifting

    def begin_again(self) -> None:
        """Return to the state after ``begin``, because the step is taken again."""
        self._carried, self.lifting = self._began

    def press(self, dt: float) -> None:
        """Apply the forces of the next substep of ``dt`` [s]."""
        share = min(dt / _REACTION_TIME, 1.0)
        self._carried += share * (self.lifting - self._carried)
        carried = min(max(self._carried, 0.0), _HARDEST_STEP * self._weight)
        for sole, load, force in self._presses:
            self._upward[sole] = force - load * carried
