"""A character that follows a Kinect frame by frame, for games.

``tests/hostile.py`` lets one follow a million frames that no sensor should give.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path

from numpy.typing import ArrayLike

from kinefilter.characters import Body, Tracking, TrackingName
from kinefilter.characters.arrays import Array, Flags

from .cleaner import Cleaner
from .config import CleanConfig
from .correct import Corrector
from .stages import Physics
from .target.upright import Turn


@dataclass(frozen=True, eq=False)
class Pose:
    """The character after a frame."""

    positions: Array
    """Joint positions [m], y up, floor at 0, shape (J, 3)."""
    rotations: Array
    """World segment rotations, wxyz, shape (J, 4)."""
    stands: Flags
    """Whether each foot (left, right) stands, shape (2,)."""
    external_force: float
    """Force on the body that no muscle and no floor gives [body weights]."""
    reset: bool
    """The character was put back onto its target; see ``PhysicsTrace.reset``."""
    impossible: bool = False
    """The frame has a body of a size that is not its own, or where nobody gets so fast:
    the pose goes on without it."""


class Avatar:
    """A character in a MuJoCo scene that a person in front of a Kinect moves.

    Frames pass the same stages as in ``clean``, but without looking ahead: a joint in
    steady motion trails its measurement by less than a centimeter, and the pose is that
    of the frame that was given.

    Args:
        body: The person; ``standard_body(KINECT_V2, height=1.8)`` will do.
        scene: One of the scenes, or an MJCF file. The person begins at its origin,
            facing +z (MuJoCo's +x); without one, where the sensor sees them.
        floor: Its height in the sensor's frame [m]; by default followed under the feet.
        tracking: How hard the character is pulled, or one of TRACKINGS by name: game
            gives way to pushes and gets up again.
        corrector: What corrects frames; by default as ``clean``.
    """

    def __init__(
        self,
        body: Body,
        scene: str | Path | None = None,
        *,
        floor: float | None = None,
        tracking: Tracking | TrackingName | None = None,
        corrector: Corrector | None = None,
    ) -> None:
        self.body = body
        room = str(scene) if isinstance(scene, Path) else scene
        config = CleanConfig(scene=room, floor="auto" if floor is None else floor)
        if isinstance(tracking, str):
            config, tracking = replace(config, tracking=tracking), None
        self.cleaner = Cleaner(config, tracking=tracking, corrector=corrector)
        self.start()

    def start(self) -> None:
        """Begin anew: the next frame is where the character appears."""
        self.cleaner.start(self.body)
        self.turn = Turn()
        physics = self.cleaner.stages[-1]
        assert isinstance(physics, Physics)
        self.physics = physics.character

    def step(
        self, positions: ArrayLike, time: float, state: ArrayLike | None = None
    ) -> Pose:
        """Follow the next frame, with a time stamp [s] later than the last.

        Joint positions [m] are as the sensor gives them, y up, NaN where missing, shape
        (J, 3); states (State), shape (J,), by default tracked where there is a joint.
        Raises an InputError for a wrong shape, or a time that does not go on.
        """
        found = self.cleaner.step(positions, time, state)
        self.turn = found.turn
        return Pose(**{f.name: getattr(found, f.name) for f in fields(Pose)})

    @property
    def notes(self) -> tuple[str, ...]:
        """What the user should know: that the sensor was turned, or may have been."""
        return self.turn.told()

    def push(self, part: str, force: ArrayLike, seconds: float) -> None:
        """Push a part of the body for some time; see ``PulledCharacter.push``."""
        self.physics.push(part, force, seconds)

    def let_go(self) -> None:
        """Stop pulling the character: it falls, until ``take_hold``."""
        self.physics.limp = True

    def take_hold(self) -> None:
        """Pull the character again."""
        self.physics.limp = False
