"""A world whose characters one can push and drag, and throw balls at."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from kinefilter.characters import Body, InputError, Prop, Tracking
from kinefilter.characters.arrays import Array, as_numbers
from kinefilter.characters.humanoid import to_mujoco
from kinefilter.retarget import HeadingFrame
from kinefilter.retarget.limbs import at_most

from .pulled_character import PulledCharacter
from .scene_props import SceneProps
from .thrown_balls import ThrownBalls
from .world import World

_PUSH, _PUSH_TIME = 300.0, 0.3  # N and s of a person who shoves
_STIFFNESS, _MAX_DRAG = 1500.0, 900.0  # N/m and N of a hand that drags. Guesses.
_HERE = HeadingFrame(np.zeros(3), np.zeros(()))  # the world is the scene's


class Playable:
    """Characters and things in one world, in the scene's frame, y up."""

    world: World
    characters: Sequence[PulledCharacter] = ()
    scene_props: SceneProps
    _dragged: tuple[int, int, Array, Array] | None = None

    def _gather(
        self, bodies: Sequence[Body], tracking: Tracking, scene: str | Path
    ) -> None:
        """Make the world of these bodies in a scene; raises InputError as ``World``."""
        balls = ThrownBalls()
        world = World(bodies, tracking, scene=scene, extend=balls.add_to)
        characters = [PulledCharacter(b, tracking, world=world) for b in bodies]
        roots = [character.root_body for character in characters]
        self.scene_props = SceneProps(world.data, roots, 1)
        self.world, self.characters, self._balls = world, tuple(characters), balls
        self._dragged = None

    @property
    def has_world(self) -> bool:
        """Whether anybody has come so far, so that there is a world."""
        return hasattr(self, "world")

    def _check_world(self) -> None:
        if not self.has_world:
            raise InputError("nobody has been in the scene yet; step an Avatar in it")

    @property
    def props(self) -> tuple[Prop, ...]:
        """All props where they are now; raises an InputError before anybody came."""
        self._check_world()
        return self.scene_props.props(_HERE)

    @property
    def doing(self) -> str:
        """What each character does, in words."""
        return ", ".join(map(_doing, self.characters))

    def hit_by(self, origin: ArrayLike, direction: ArrayLike) -> tuple[int, int] | None:
        """Return what a ray hits first if it is a character: its number and a joint.

        Raises an InputError if the ray is not valid, or before anybody came.
        """
        self._check_world()
        start = as_numbers(origin, "the origin of a ray [m]", (3,), finite=True)
        start = to_mujoco(start.astype(float))
        way = to_mujoco(_direction(direction, "the direction of a ray"))
        model, data, geom = self.world.model, self.world.data, np.zeros(1, "i4")
        hit = mujoco.mj_ray(model, data, start, way, None, True, -1, geom)
        body = model.geom_bodyid[geom[0]]
        for number, character in enumerate(self.characters):
            if hit >= 0.0 and character.joint_of[body] >= 0:
                return number, int(character.joint_of[body])
        return None

    def shove(self, joint: int, direction: ArrayLike, number: int = 0) -> None:
        """Push the part that ends at a character's joint as hard as a person shoves.

        Raises an InputError if there is no such character or joint, or no direction.
        """
        way = _direction(direction, "the direction of a shove")
        self._push(number, joint, _PUSH * way, _PUSH_TIME)

    def drag(
        self, joint: int, grabbed: ArrayLike, pointer: ArrayLike, number: int = 0
    ) -> None:
        """Pull the part that ends at a joint to a pointer [m], (3,), until ``release``.

        Only the first call of a drag uses the place where it is ``grabbed`` [m], (3,).
        """
        offset = np.asarray(grabbed) - self.characters[number].positions[joint]
        if self._dragged is not None and self._dragged[:2] == (number, joint):
            offset = self._dragged[2]
        self._dragged = number, joint, offset, np.asarray(pointer, dtype=float)

    def release(self) -> None:
        """End a drag."""
        self._dragged = None

    def throw(self, origin: ArrayLike, velocity: ArrayLike) -> None:
        """Throw the next ball from a point [m], (3,), with a velocity [m/s], (3,).

        Raises an InputError if these are not finite numbers, or before anybody came.
        """
        self._check_world()
        origin = as_numbers(origin, "the place of a throw [m]", (3,), finite=True)
        speed = as_numbers(velocity, "the velocity of a throw", (3,), finite=True)
        self._balls.throw(self.world.data, origin, speed)

    def _pull_dragged(self, dt: float) -> None:
        """Pull what is dragged for the next dt [s]."""
        if self._dragged is not None:
            number, joint, grabbed, pointer = self._dragged
            away = pointer - self.characters[number].positions[joint] - grabbed
            self._push(number, joint, at_most(_MAX_DRAG, _STIFFNESS * away), dt)

    def _push(self, number: int, joint: int, force: Array, seconds: float) -> None:
        if number not in range(count := len(self.characters)):
            raise InputError(f"there is no character {number!r}; {count} in the scene")
        character = self.characters[number]
        if joint not in range(count := len(joints := character.body.skeleton.joints)):
            last = count - 1
            raise InputError(f"joint {joint!r}: give its number, 0 to {last}")
        character.push(joints[joint], force, seconds)


def _direction(value: ArrayLike, what: str) -> Array:
    """Return a direction as a unit vector; raises an InputError if it has none."""
    way = as_numbers(value, what, (3,), finite=True).astype(float)
    if not (length := np.linalg.norm(way)) > 0.0:
        raise InputError(f"{what} is zero; give one that is not")
    return np.asarray(way / length)


def _doing(character: PulledCharacter) -> str:
    gives = character.compliance
    if character.limp and not (gives and gives.fallen):
        return "hangs limp"
    return "follows" if gives is None else gives.doing
