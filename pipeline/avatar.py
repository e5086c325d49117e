"""A character that follows a Kinect frame by frame, for games."""

from dataclasses import dataclass, fields, replace
from pathlib import Path

from numpy.typing import ArrayLike

from kinefilter.characters import Body, Tracking, TrackingName
from kinefilter.characters.arrays import Array, Flags

from .cleaner import Cleaner
from .config import CleanConfig
from .correct import Corrector
from .physics.stage import Physics
from .upright import Turn


@dataclass(frozen=True, eq=False)
class Pose:
    """The character after a frame."""

    positions: Array  # joint positions [m], y up, floor at 0, shape (J, 3)
    rotations: Array  # world segment rotations, wxyz, shape (J, 4)
    stands: Flags  # whether each foot (left, right) is planted, shape (2,)
    external_force: float  # force on the body beyond muscles and floor [body weights]
    reset: bool  # whether it was reset onto its target; see ``PhysicsTrace.reset``
    impossible: bool = False  # whether the body's size or place made it be ignored


class Avatar:
    """A character in a MuJoCo scene, moved by a person in front of a Kinect.

    Frames pass the same stages as in ``clean``, but without looking ahead: the pose is
    that of the given frame, and a joint in steady motion trails its measurement by less
    than 1.5 centimeters.

    The person's ``body`` may be ``standard_body(KINECT_V2, height=1.8)``. The person
    starts at the origin of the ``scene``, a name or an MJCF file, facing +z (MuJoCo's
    +x); without one, where the sensor sees them. The height of the ``floor`` in the
    sensor's frame [m] is by default tracked under the feet. ``tracking`` has the gains
    that pull the character, or is one of TRACKINGS by name: game yields to pushes and
    gets up again. The ``corrector`` is by default that of ``clean``, and ``measured``,
    the person's segment lengths as the sensor shows them, those of the body;
    ``Cleaner.measure`` finds both in a second of frames, which is more accurate.
    """

    def __init__(
        self,
        body: Body,
        scene: str | Path | None = None,
        *,
        floor: float | None = None,
        tracking: Tracking | TrackingName | None = None,
        corrector: Corrector | None = None,
        measured: Body | None = None,
    ) -> None:
        self.body, self.measured = body, measured or body
        room = str(scene) if isinstance(scene, Path) else scene
        config = CleanConfig(scene=room, floor="auto" if floor is None else floor)
        if isinstance(tracking, str):
            config, tracking = replace(config, tracking=tracking), None
        self.cleaner = Cleaner(config, tracking=tracking, corrector=corrector)
        self.start()

    def start(self) -> None:
        """Reset: the character appears where the next frame is."""
        self.cleaner.start(self.body, self.measured)
        self.turn = Turn()
        physics = self.cleaner.stages[-1]
        assert isinstance(physics, Physics)
        self.physics = physics.character

    def step(
        self, positions: ArrayLike, time: float, state: ArrayLike | None = None
    ) -> Pose:
        """Follow the next frame, with a time stamp [s] later than the last.

        Joint positions [m] (J, 3) are in the sensor's frame, y up, NaN where missing;
        states (State) (J,) are by default tracked wherever there is a position. Raises
        an InputError for a wrong shape or a time that does not increase.
        """
        found = self.cleaner.step(positions, time, state)
        self.turn = found.turn
        return Pose(**{f.name: getattr(found, f.name) for f in fields(Pose)})

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user on how the sensor is turned."""
        return self.turn.notes()

    def push(self, part: str, force: ArrayLike, seconds: float) -> None:
        """Push a part of the body for a time; see ``PulledCharacter.push``."""
        self.physics.push(part, force, seconds)

    def let_go(self) -> None:
        """Stop pulling the character, so that it falls, until ``take_hold``."""
        self.physics.limp = True

    def take_hold(self) -> None:
        """Pull the character again."""
        self.physics.limp = False
