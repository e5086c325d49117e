"""A character that follows a Kinect frame by frame, for games."""

from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from kinefilter.characters import Body, InputError, Tracking, TrackingName
from kinefilter.characters.arrays import Array, Flags

from .cleaner import Cleaner
from .config import CleanConfig
from .correct import Corrector
from .draft import Draft
from .physics.pulled_character import PulledCharacter
from .physics.shared_scene import Contact, SharedPhysics, SharedScene
from .physics.stage import Physics
from .upright import Turn

_FARTHEST = 100.0  # m: no sensor that tracks people sees that far


@dataclass(frozen=True, eq=False)
class Pose:
    """The character after a frame.

    Attributes:
        positions: Joint positions [m], y up, floor at 0, shape (J, 3).
        rotations: World segment rotations, wxyz, shape (J, 4).
        stands: Whether each foot (left, right) is planted, shape (2,).
        external_force: Force on the body beyond muscles and floor [body weights].
        reset: Whether it was reset onto its target; see ``PhysicsTrace.reset``.
        impossible: Whether the body's size or place made the frame be ignored.
    """

    positions: Array
    rotations: Array
    stands: Flags
    external_force: float
    reset: bool
    impossible: bool = False


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
    gets up again. The ``corrector`` is by default that of ``clean`` for a Kinect; for
    joints of another tracker, which it would move by centimeters, give
    ``LocalPCA(builtin_database(KINECT_V2))``. ``measured``, the person's segment
    lengths as the sensor shows them, are by default those of the body;
    ``Cleaner.measure`` finds both in a second of frames, which is more accurate.

    Avatars with the same ``SharedScene`` push each other and the same props. ``step``
    then only sets the target; once everyone's frame has been stepped, ``advance`` of
    the scene moves them, and ``pose`` is the result. Its tracking is everyone's, and
    ``name`` is how contacts of others name the person.
    """

    def __init__(
        self,
        body: Body,
        scene: str | Path | SharedScene | None = None,
        *,
        floor: float | None = None,
        tracking: Tracking | TrackingName | None = None,
        corrector: Corrector | None = None,
        measured: Body | None = None,
        name: str = "",
    ) -> None:
        self.body, self.measured = body, measured or body
        self.shared = scene if isinstance(scene, SharedScene) else None
        room = None if isinstance(scene, SharedScene) else scene
        room = str(room) if isinstance(room, Path) else room
        config = CleanConfig(scene=room, floor="auto" if floor is None else floor)
        if isinstance(tracking, str):
            config, tracking = replace(config, tracking=tracking), None
        self.cleaner = Cleaner(config, tracking=tracking, corrector=corrector)
        if self.shared is not None:
            self.cleaner = self.cleaner.replaced(SharedPhysics(self.shared, name))
        self.start()

    def start(self) -> None:
        """Reset: the character appears where the next frame is, and is not let go."""
        self.cleaner.start(self.body, self.measured)
        self._found: Draft | None = None
        self._farthest = 0.0  # from the sensor, so far [m]
        physics = self.cleaner.stages[-1]
        assert isinstance(physics, Physics | SharedPhysics)
        self._stage = physics

    def step(
        self, positions: ArrayLike, time: float, state: ArrayLike | None = None
    ) -> Pose:
        """Follow the next frame, with a time stamp [s] later than the last.

        Joint positions [m] (J, 3) are in the sensor's frame, y up, NaN where missing;
        states (State) (J,) are by default tracked wherever there is a position. Raises
        an InputError for a wrong shape or a time that does not increase.
        """
        self._found = self.cleaner.step(positions, time, state)
        far = np.abs(np.asarray(positions, dtype=float))
        far = far[np.isfinite(far)]
        self._farthest = float(np.max(far, initial=self._farthest))
        return self.pose

    @property
    def pose(self) -> Pose:
        """The character after the last frame; raises an InputError before the first."""
        if self._found is None:
            raise InputError("there is no pose yet; call step() first")
        return Pose(**{f.name: getattr(self._found, f.name) for f in fields(Pose)})

    @property
    def physics(self) -> PulledCharacter:
        """The simulated character; raises an InputError if it is in no scene yet."""
        return self._stage.character

    @property
    def turn(self) -> Turn:
        """How the sensor's frame was set upright."""
        return Turn() if self._found is None else self._found.turn

    @property
    def contacts(self) -> tuple[Contact, ...]:
        """Where the character touches anything in a shared scene; empty in others."""
        stage = self._stage
        return stage.contacts if isinstance(stage, SharedPhysics) else ()

    @property
    def holds(self) -> str | None:
        """The prop in the character's hands, by name."""
        held = self.physics.grasp.held
        return None if held is None else held.name

    def leave(self) -> None:
        """Leave the shared scene, until the next step."""
        if isinstance(self._stage, SharedPhysics):
            self._stage.leave()

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user: how the sensor is turned, and wrong units."""
        notes = self.turn.notes()
        if self._farthest > _FARTHEST:
            far = f"a joint was {self._farthest:.0f} m away from the sensor"
            notes += (f"{far}; give positions in meters",)
        return notes

    def push(self, part: str, force: ArrayLike, seconds: float) -> None:
        """Push the part of the body that ends at a joint for the next seconds.

        The force [N], shape (3,), y up as in poses, acts on the part's center of mass.
        Raises InputError if there is no such joint, or force or time is not valid.
        """
        self.physics.push(part, force, seconds)

    def let_go(self) -> None:
        """Stop pulling the character, so that it falls, until ``take_hold``."""
        self.physics.limp = True

    def take_hold(self) -> None:
        """Pull the character again."""
        self.physics.limp = False
