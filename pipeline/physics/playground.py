"""A character in a scene that performs a motion again and again, to be played with."""

from __future__ import annotations

from collections import deque
from itertools import cycle
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from kinefilter.characters import (
    TRACKINGS,
    Clip,
    InputError,
    Motion,
    Prop,
    TrackingName,
    positions_from_rotations,
)
from kinefilter.characters.arrays import Array, Flags
from kinefilter.characters.humanoid import to_mujoco
from kinefilter.characters.rotations import slerp
from kinefilter.pipeline.formats.export import resampled
from kinefilter.pipeline.target.floor import place_of
from kinefilter.retarget import HeadingFrame
from kinefilter.retarget.stance import smooth_step

from .filter import Things
from .pulled_character import PulledCharacter

RATE = 30.0
"""Frames a second of the motion, and of what is recorded."""
BALL_MASS, BALL_SPEED = 5.0, 10.0
"""Of the balls that are thrown [kg, m/s]."""
_BALLS, _BALL_RADIUS = 6, 0.13  # m: a medicine ball
_BALL = "thrown ball"
_BALL_COLOR = (0.75, 0.22, 0.17, 1.0)
_PARKED = (-300.0, 0.0)  # m, where balls wait on the floor, too far away to be seen
_PUSH, _PUSH_TIME = 300.0, 0.3  # N and s, of somebody who shoves
_FIRMNESS, _STRONGEST = 1500.0, 900.0  # N/m and N, of a hand that drags. Guesses.
_BACK, _SLOWEST = 0.6, 1.5  # s and m/s, from the end of a motion to its beginning
_HERE = HeadingFrame(np.zeros(3), np.zeros(()))  # the world is the scene's
_LONGEST = 10 * 60 * int(RATE)  # frames of a recording


class Playground:
    """What a page or a game plays with; the world frame is the scene's, y up.

    Args:
        motion: What the character performs; it begins at the origin and faces +z.
        scene: What is around it, one of SCENES or an MJCF file.
        tracking: How it follows, one of TRACKINGS.

    Raises:
        InputError: As ``load_scene``, or the motion is empty.
    """

    def __init__(
        self, motion: Clip, scene: str | Path, tracking: TrackingName = "game"
    ) -> None:
        self.motion = _closed(motion)
        self.scene, self.tracking = scene, tracking
        self.time = 0.0
        self._frames: deque[tuple[Array, ...]] | None = None
        self._set_up()

    def _set_up(self) -> None:
        body = self.motion.body
        self.character = PulledCharacter(
            body, TRACKINGS[self.tracking], scene=self.scene, more=_add_balls
        )
        model = self.character.model
        root = model.body(body.skeleton.joints[body.skeleton.root]).id
        self.things = Things(model, self.character.data, root, 1)
        self._balls = cycle([model.joint(f"{_BALL} {k + 1}") for k in range(_BALLS)])
        self._dragged: tuple[int, Array, Array] | None = None
        self.resets = 0
        self.restart()

    def restart(self) -> None:
        """Begin again, with everything where the scene has it."""
        self.time = 0.0
        self.character.start(*self._target()[:2])
        self.things.record(0)

    def change(
        self, *, scene: str | Path | None = None, tracking: TrackingName | None = None
    ) -> None:
        """Go on in another scene, or follow in another way; errors as the class."""
        before = self.scene, self.tracking
        self.scene = self.scene if scene is None else scene
        self.tracking = self.tracking if tracking is None else tracking
        try:
            self._set_up()
        except InputError:
            self.scene, self.tracking = before
            raise

    def step(self, dt: float) -> None:
        """Let time pass [s]."""
        self.time += dt
        if self._dragged is not None:
            joint, grabbed, pointer = self._dragged
            pull = _FIRMNESS * (pointer - self.character.positions[joint] - grabbed)
            size = float(np.linalg.norm(pull))
            self._push(joint, pull * min(1.0, _STRONGEST / max(size, 1e-9)), dt)
        positions, rotations, stands = self._target()
        good = self.character.step(positions, rotations, dt, stands=stands)
        self.resets += not good
        self.things.record(0)
        if self._frames is not None:
            self._frames.append(self._state(dt))

    def _target(self) -> tuple[Array, Array, Flags]:
        """Return positions, rotations and standing feet of the motion at present."""
        motion, at = self.motion, self.time * RATE
        first = int(at) % len(motion)
        second, share = (first + 1) % len(motion), at - int(at)
        turns = slerp(motion.rotations[first], motion.rotations[second], share)
        root = motion.root[first] + share * (motion.root[second] - motion.root[first])
        stands = motion.contacts[first].reshape(2, 2).any(axis=1)
        return positions_from_rotations(turns, root, motion.body), turns, stands

    def hit_by(self, origin: ArrayLike, direction: ArrayLike) -> int | None:
        """Return the joint at the end of the part that a ray meets first, if any."""
        there = to_mujoco(np.asarray(origin, dtype=float))
        way, geom = to_mujoco(np.asarray(direction, dtype=float)), np.zeros(1, np.int32)
        model, data = self.character.model, self.character.data
        if mujoco.mj_ray(model, data, there, way, None, True, -1, geom) < 0.0:
            return None
        joint = int(self.character.parts[model.geom_bodyid[geom[0]]])
        return None if joint < 0 else joint

    def shove(self, joint: int, direction: ArrayLike) -> None:
        """Push the part that ends at a joint, as hard as somebody shoves."""
        way = np.asarray(direction, dtype=float)
        self._push(joint, _PUSH * way / np.linalg.norm(way), _PUSH_TIME)

    def _push(self, joint: int, force: Array, seconds: float) -> None:
        self.character.push(self.motion.skeleton.joints[joint], force, seconds)

    def drag(self, joint: int, grabbed: ArrayLike, pointer: ArrayLike) -> None:
        """Pull a part to a pointer until ``release``.

        Args:
            joint: The joint that the part ends at.
            grabbed: Where it was grabbed [m], (3,), as long as it is not yet dragged.
            pointer: Where it is to go [m], (3,).
        """
        if self._dragged is None or self._dragged[0] != joint:
            offset = np.asarray(grabbed) - self.character.positions[joint]
        else:
            offset = self._dragged[1]
        self._dragged = joint, offset, np.asarray(pointer, dtype=float)

    def release(self) -> None:
        """End a drag."""
        self._dragged = None

    def throw(self, origin: ArrayLike, direction: ArrayLike) -> None:
        """Throw the next ball from a point [m], (3,), along a direction, (3,)."""
        ball, way = next(self._balls), to_mujoco(np.asarray(direction, dtype=float))
        way /= np.linalg.norm(way)
        data, place, speed = self.character.data, ball.qposadr[0], ball.dofadr[0]
        data.qpos[place : place + 3] = to_mujoco(np.asarray(origin, dtype=float))
        data.qvel[speed : speed + 6] = 0.0
        data.qvel[speed : speed + 3] = BALL_SPEED * way

    @property
    def props(self) -> tuple[Prop, ...]:
        """Everything around the character, where it is now."""
        return self.things.props(_HERE)

    @property
    def doing(self) -> str:
        """What the character does, in words."""
        gives = self.character.compliance
        if self.limp and not (gives and gives.felled):
            return "is let go"
        return "follows" if gives is None else gives.doing

    @property
    def limp(self) -> bool:
        """Whether nothing pulls the character; can be set."""
        return self.character.limp

    @limp.setter
    def limp(self, value: bool) -> None:
        self.character.limp = value

    @property
    def recording(self) -> int | None:
        """How many frames are recorded; None: nothing is being recorded."""
        return None if self._frames is None else len(self._frames)

    def record(self) -> None:
        """Begin a recording; it keeps the last ten minutes."""
        self._frames = deque(maxlen=_LONGEST)

    def recorded(self) -> Clip:
        """End the recording and return it; raises InputError if it is too short."""
        frames, self._frames = self._frames or deque(), None
        if len(frames) < 2:
            raise InputError("nothing was recorded; let it play for a moment first")
        steps, root, rotations, contacts, force, poses = map(
            np.array, zip(*frames, strict=True)
        )
        time, now = np.cumsum(steps) - steps[0], self.things.poses
        self.things.poses = poses
        props = self.props
        self.things.poses = now
        motion = Motion(
            time=time,
            body=self.motion.body,
            root=root,
            rotations=rotations,
            source="kinefilter play",
        )
        return Clip.of(
            motion,
            contacts=contacts,
            external_force=force,
            props=tuple(prop for prop in props if not _is_parked(prop)),
        )

    def _state(self, dt: float) -> tuple[Array, ...]:
        character, frame = self.character, int(self.time * RATE) % len(self.motion)
        return (
            np.array(dt),
            character.root,
            character.rotations,
            self.motion.contacts[frame],
            np.array(character.external_force),
            self.things.poses[0].copy(),
        )


def _closed(clip: Clip) -> Clip:
    """Return a motion at the origin of a scene, with a way back to its beginning."""
    if len(clip) < 2:
        raise InputError(f"{clip.source}: {len(clip)} frames; expected 2 or more")
    clip = resampled(clip, RATE)
    place = place_of(clip.positions, clip.skeleton)
    root = place.remove(clip.root[:, None])[:, 0]
    turns = place.remove_rotations(clip.rotations)
    seconds = max(_BACK, float(np.linalg.norm(root[-1] - root[0])) / _SLOWEST)
    count = int(np.ceil(seconds * RATE))
    share = smooth_step(np.arange(1, count) / count)[:, None]
    back = slerp(turns[-1], turns[0], share)
    contacts = np.repeat(clip.contacts[-1:] & clip.contacts[:1], count - 1, axis=0)
    motion = Motion(
        time=np.arange(len(clip) + count - 1) / RATE,
        body=clip.body,
        root=np.concatenate([root, root[-1] + share * (root[0] - root[-1])]),
        rotations=np.concatenate([turns, back]),
        source=clip.source,
    )
    return Clip.of(motion, contacts=np.concatenate([clip.contacts, contacts]))


def _add_balls(spec: mujoco.MjSpec) -> None:
    """Add balls to a scene that wait far away to be thrown."""
    x, y = _PARKED
    for k in range(_BALLS):
        name = f"{_BALL} {k + 1}"
        ball = spec.worldbody.add_body(
            name=name, pos=[x, y + 3.0 * k * _BALL_RADIUS, _BALL_RADIUS]
        )
        ball.add_freejoint(name=name)
        ball.add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=[_BALL_RADIUS, 0.0, 0.0],
            mass=BALL_MASS,
            condim=6,
            friction=[0.8, 0.005, 0.01],
            rgba=_BALL_COLOR,
        )


def _is_parked(prop: Prop) -> bool:
    """Tell whether a thing is a ball that was not thrown."""
    return prop.name.startswith(_BALL) and bool(
        (to_mujoco(prop.positions)[:, 0] < 0.9 * _PARKED[0]).all()
    )
