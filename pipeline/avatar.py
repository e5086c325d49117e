"""A character that follows a Kinect frame by frame, for games.

``tests/hostile.py`` lets one follow a million frames that no sensor should give.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kinefilter.characters import Body, InputError, State, Take, Tracking
from kinefilter.characters.arrays import Array
from kinefilter.retarget import (
    BoneLengths,
    Hands,
    HeadingFrame,
    Standardizer,
    rotations_from_positions,
)

from .correct import Corrector, Observation
from .correct.filters import OneEuro
from .database import builtin_database
from .default import default_corrector
from .physics.pulled_character import PulledCharacter
from .reliability import ReliabilityScorer, measure_reference
from .target.contacts import StanceTracker, ankles_and_toes
from .target.floor import put_on_floor
from .target.placement import place_of
from .target.planting import PLANTED, flat_height

_LONGEST_STEP = 0.5  # s: a pause in the stream is no time in which to move
_LET_GO = 0.05  # s in which a foot that steps joins its measured path
_FLOOR_FALLS, _FLOOR_RISES = 0.2, 0.01  # share a frame: feet sink rarely, lift often


@dataclass(frozen=True, eq=False)
class Pose:
    """The character after a frame."""

    positions: Array
    """Joint positions [m], y up, floor at 0, shape (J, 3)."""
    rotations: Array
    """World segment rotations, wxyz, shape (J, 4)."""
    stands: NDArray[np.bool_]
    """Whether each foot (left, right) stands, shape (2,)."""
    external_force: float
    """Force on the body that no muscle and no floor gives [body weights]."""
    reset: bool
    """The simulation diverged and was put back onto its target."""


class Avatar:
    """A character in a MuJoCo scene that a person in front of a Kinect moves.

    Frames are scored, corrected and followed by bounded forces as ``clean`` does it,
    but without looking ahead: a joint in steady motion trails its measurement by less
    than a centimeter, and the pose is that of the frame that was given.

    Args:
        body: The person; ``standard_body(KINECT_V2, height=1.8)`` will do.
        scene: One of the scenes, or an MJCF file, that the character is in. The person
            begins at its origin, facing +z (MuJoCo's +x); without one, the character
            stays where the sensor sees the person.
        floor: Height of the floor in the sensor's frame [m]; by default it is followed
            under the feet.
        tracking: How hard the character is pulled. Softer (15 rad/s) gives way when it
            is pushed.
        corrector: What corrects frames; by default as ``clean``.
    """

    def __init__(
        self,
        body: Body,
        scene: str | Path | None = None,
        *,
        floor: float | None = None,
        tracking: Tracking | None = None,
        corrector: Corrector | None = None,
    ) -> None:
        skeleton = body.skeleton
        self.body, self.floor = body, floor
        self._in_scene = scene is not None
        self.physics = PulledCharacter(body, tracking, scene=scene)
        self._corrector = corrector or default_corrector(builtin_database(skeleton))
        self._scorer = ReliabilityScorer(skeleton, measure_reference(_at_rest(body)))
        self._standardizer = Standardizer(body)
        self._smoother = OneEuro(skeleton)
        self._bones, self._hands = BoneLengths(body), Hands(skeleton)
        self._stance = StanceTracker()
        self._ankles, self._toes = ankles_and_toes(skeleton)
        self._flat = flat_height(body, self._toes[0])
        self.start()

    def start(self) -> None:
        """Begin anew: the next frame is where the character appears."""
        for part in (self._corrector, self._scorer, self._standardizer):
            part.start()
        self._smoother.start()
        self._stance.start()
        self._time: float | None = None
        self._height = self.floor
        self._place = (
            None if self._in_scene else HeadingFrame(np.zeros(3), np.zeros(()))
        )
        self._moved = np.zeros((2, 2, 3))
        self._anchors = np.zeros((2, 2, 3))
        self._stood = np.zeros(2, dtype=np.bool_)

    def step(
        self,
        positions: ArrayLike,
        time: float,
        state: ArrayLike | None = None,
    ) -> Pose:
        """Follow the next frame.

        Args:
            positions: Joint positions [m] as the sensor gives them, y up, NaN where
                missing, shape (J, 3).
            time: Time stamp [s], later than the last.
            state: Tracking state of each joint (State), shape (J,); by default what is
                there is tracked.

        Raises:
            InputError: Wrong shape, or time does not go on.
        """
        seen = np.asarray(positions, dtype=float)
        skeleton = self.body.skeleton
        if seen.shape != (len(skeleton), 3):
            raise InputError(
                f"a frame of {skeleton.name} has shape ({len(skeleton)}, 3), not "
                f"{seen.shape}; give the joints in the SDK's order"
            )
        if not np.isfinite(time):
            raise InputError(f"a frame at {time:g} s; give its stamp in seconds")
        if self._time is not None and time <= self._time:
            raise InputError(
                f"time {time:g} s comes after {self._time} s; give each frame the "
                "sensor's own stamp, in seconds, or call start()"
            )
        seen = np.where(np.isfinite(seen).all(axis=1, keepdims=True), seen, np.nan)
        missing = np.isnan(seen[:, 0])
        states = np.full(len(seen), State.TRACKED, dtype=np.uint8)
        if state is not None:
            states = np.asarray(state, dtype=np.uint8)
        states = np.where(missing, State.NOT_TRACKED, states).astype(np.uint8)
        first = self._time is None
        step = 1 / 30 if self._time is None else min(time - self._time, _LONGEST_STEP)
        self._time = time
        target, rotations = self._target(seen, states, time, step)
        if first:
            self.physics.start(target, rotations)
            held = True
        else:
            held = self.physics.step(target, rotations, step, stands=self._stood)
        return Pose(
            self.physics.positions,
            self.physics.rotations,
            self._stood.copy(),
            self.physics.external_force,
            not held,
        )

    def push(self, part: str, force: ArrayLike, seconds: float) -> None:
        """Push a part of the body for some time; see ``PulledCharacter.push``."""
        self.physics.push(part, np.asarray(force, dtype=float), seconds)

    def let_go(self) -> None:
        """Stop pulling the character: it falls, until ``take_hold``."""
        self.physics.limp = True

    def take_hold(self) -> None:
        """Pull the character again."""
        self.physics.limp = False

    def _target(
        self, seen: Array, states: NDArray[np.uint8], time: float, step: float
    ) -> tuple[Array, Array]:
        """Return where the frame says that the character should be."""
        rate, _, geometry = self._scorer.step(seen, states, time)
        standard, view = self._standardizer.step(seen, rate)
        observation = Observation(standard, rate, geometry, time, self.body.lengths)
        found = self._corrector.step(observation)
        there = self._standardizer.undo(found.positions, view)
        there = self._smoother.step(replace(observation, positions=there)).positions
        there = self._on_floor(there)
        if self._place is None:
            self._place = place_of(there[None], self.body.skeleton)
        there = self._place.remove(there)
        there, firmness = self._planted(there, found.trust, step)
        on_bones = self._bones.project(there[None], firmness[None])[0]
        there = self._hands.carried(there, on_bones, found.trust, self.body)
        there = put_on_floor(there[None], self.body)[0]
        prior = found.rotations
        if prior is not None:
            prior = self._place.remove_rotations(view.restore_rotations(prior))
        return there, rotations_from_positions(there, self.body, prior)

    def _on_floor(self, positions: Array) -> Array:
        """Return positions with the floor at 0."""
        if self.floor is None:
            sole = float(positions[self._ankles, 1].min() - self._flat)
            if self._height is None:
                self._height = sole
            away = sole - self._height
            self._height += away * (_FLOOR_FALLS if away < 0.0 else _FLOOR_RISES)
        return np.asarray(positions - [0.0, self._height, 0.0])

    def _planted(
        self, positions: Array, trust: Array, step: float
    ) -> tuple[Array, Array]:
        """Return positions whose standing feet stay, and how firm each joint is."""
        stands = self._stance.step(positions[self._ankles], float(self._flat), step)
        planted, firmness = positions.copy(), trust.copy()
        for foot in range(2):
            parts = [self._ankles[foot], self._toes[foot]]
            if stands[foot]:
                if not self._stood[foot]:
                    place = positions[parts] + self._moved[foot]
                    place[:, 1] = [self._flat, self.body.radii[parts[1]]]
                    self._anchors[foot] = place
                self._moved[foot] = self._anchors[foot] - positions[parts]
                firmness[parts] = PLANTED
            else:
                self._moved[foot] *= np.exp(-step / _LET_GO)
            planted[parts] += self._moved[foot]
        self._stood = stands.copy()
        return planted, firmness


def _at_rest(body: Body) -> Take:
    """Return the body in T-pose as a take, to measure its segments."""
    joints = (2, len(body.skeleton))
    return Take(
        np.array([0.0, 1.0]),
        np.broadcast_to(body.rest_positions, (*joints, 3)).copy(),
        np.full(joints, State.TRACKED, dtype=np.uint8),
        body.skeleton,
    )
