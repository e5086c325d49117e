"""A character that repeats a motion in a scene, and that one can push and throw at."""

from __future__ import annotations

from collections import deque
from itertools import cycle
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from kinefilter.characters import TRACKINGS, Clip, InputError, Motion, Prop
from kinefilter.characters.arrays import Array, Flags
from kinefilter.characters.humanoid import to_mujoco
from kinefilter.characters.motion import positions_from_rotations
from kinefilter.characters.rotations import slerp
from kinefilter.characters.tracking import TrackingName
from kinefilter.pipeline.formats.export import resampled
from kinefilter.pipeline.target.feet import planted_feet
from kinefilter.pipeline.target.floor import find_placement
from kinefilter.retarget import HeadingFrame
from kinefilter.retarget.stance import smooth_step

from .filter import SceneProps
from .grasp import seen_hands
from .pulled_character import PulledCharacter

RATE = 30.0
"""Frame rate [1/s] of the motion and of recordings."""
_BALL_MASS, _BALL_SPEED = 5.0, 10.0  # kg, m/s
_BALLS, _BALL_RADIUS = 6, 0.13  # m: a medicine ball
_BALL = "thrown ball"
_BALL_COLOR = (0.75, 0.22, 0.17, 1.0)
_PARKED = (-300.0, 0.0)  # m: where balls wait on the floor, too far away to be seen
_PUSH, _PUSH_TIME = 300.0, 0.3  # N and s of a person who shoves
_STIFFNESS, _MAX_DRAG = 1500.0, 900.0  # N/m and N of a hand that drags. Guesses.
_BACK, _SLOWEST = 0.6, 1.5  # s at least, and m/s, from a motion's end to its beginning
_HERE = HeadingFrame(np.zeros(3), np.zeros(()))  # the world is the scene's
_LONGEST = 10 * 60 * int(RATE)  # frames of a recording


class Playground:
    """An interactive simulation for a page or a game, in the scene's frame, y up.

    The motion is moved to the origin, facing +z, and repeated in a scene, one of SCENES
    or an MJCF file. Raises InputError as ``load_scene``, or if the motion is too short.
    """

    def __init__(
        self, motion: Clip, scene: str | Path, tracking: TrackingName = "game"
    ) -> None:
        self.motion = _closed(motion)
        self.scene, self.tracking = scene, tracking
        self._frames: deque[tuple[Any, ...]] | None = None
        self._set_up()

    def _set_up(self) -> None:
        body = self.motion.body
        self.character = PulledCharacter(
            body, TRACKINGS[self.tracking], scene=self.scene, extend=_add_balls
        )
        model = self.character.model
        root = model.body(body.skeleton.joints[body.skeleton.root]).id
        self.scene_props = SceneProps(model, self.character.data, root, 1)
        self._balls = cycle([model.joint(f"{_BALL} {k + 1}") for k in range(_BALLS)])
        self._dragged: tuple[int, Array, Array] | None = None
        self.resets = 0
        self.restart()

    def restart(self) -> None:
        """Restart the motion, with every prop where the scene has it."""
        self.time = 0.0
        self.character.start(*self._target()[:2])
        self.scene_props.record(0)

    def change(
        self, *, scene: str | Path | None = None, tracking: TrackingName | None = None
    ) -> None:
        """Restart in another scene or with another tracking; raises as the class."""
        before = self.scene, self.tracking
        self.scene = self.scene if scene is None else scene
        self.tracking = self.tracking if tracking is None else tracking
        try:
            self._set_up()
        except InputError:
            self.scene, self.tracking = before
            raise

    def step(self, dt: float) -> None:
        """Advance the simulation by dt [s]."""
        rounds = int(self.time * RATE) // len(self.motion)
        self.time += dt
        if int(self.time * RATE) // len(self.motion) > rounds:
            self._put_back()
        if self._dragged is not None:
            joint, grabbed, pointer = self._dragged
            force = _STIFFNESS * (pointer - self.character.positions[joint] - grabbed)
            size = float(np.linalg.norm(force))
            self._push(joint, force * min(1.0, _MAX_DRAG / max(size, 1e-9)), dt)
        positions, rotations, stands = self._target()
        self.resets += not self.character.step(
            positions, rotations, dt, stands=stands, seen=self._seen()
        )
        self.scene_props.record(0)
        if self._frames is not None:
            contacts = self.motion.contacts[int(self.time * RATE) % len(self.motion)]
            pose = self.character.root, self.character.rotations
            force, props = (
                self.character.external_force,
                self.scene_props.poses[0].copy(),
            )
            self._frames.append((dt, *pose, contacts, force, props))

    def _put_back(self) -> None:
        """Put props that hands can hold where the motion, which repeats, begins."""
        self.character.grasp.start()
        for prop in self.character.grasp.props:
            prop.put_back()

    def _seen(self) -> Flags:
        """Return which hands the sensor saw."""
        frame = int(self.time * RATE) % len(self.motion)
        return seen_hands(self.motion.reliability[frame], self.motion.skeleton)

    def _target(self) -> tuple[Array, Array, Flags]:
        """Return the motion's positions, rotations and planted feet at this time."""
        motion, at = self.motion, self.time * RATE
        first = int(at) % len(motion)
        second, share = (first + 1) % len(motion), at - int(at)
        turns = slerp(motion.rotations[first], motion.rotations[second], share)
        root = motion.root[first] + share * (motion.root[second] - motion.root[first])
        stands = planted_feet(motion.contacts[[first]])[0]
        return positions_from_rotations(turns, root, motion.body), turns, stands

    def hit_by(self, origin: ArrayLike, direction: ArrayLike) -> int | None:
        """Return the joint that ends the part that a ray hits first, None if none."""
        start, way = (to_mujoco(np.asarray(v, float)) for v in (origin, direction))
        model, data, geom = self.character.model, self.character.data, np.zeros(1, "i4")
        hit = mujoco.mj_ray(model, data, start, way, None, True, -1, geom)
        joint = int(self.character.joint_of[model.geom_bodyid[geom[0]]])
        return None if hit < 0.0 or joint < 0 else joint

    def shove(self, joint: int, direction: ArrayLike) -> None:
        """Push the part that ends at a joint as hard as a person shoves."""
        way = np.asarray(direction, dtype=float)
        self._push(joint, _PUSH * way / np.linalg.norm(way), _PUSH_TIME)

    def _push(self, joint: int, force: Array, seconds: float) -> None:
        self.character.push(self.motion.skeleton.joints[joint], force, seconds)

    def drag(self, joint: int, grabbed: ArrayLike, pointer: ArrayLike) -> None:
        """Pull the part that ends at a joint to a pointer [m], (3,), until ``release``.

        Only the first call of a drag uses the place where it is ``grabbed`` [m], (3,).
        """
        offset = np.asarray(grabbed) - self.character.positions[joint]
        if self._dragged is not None and self._dragged[0] == joint:
            offset = self._dragged[1]
        self._dragged = joint, offset, np.asarray(pointer, dtype=float)

    def release(self) -> None:
        """End a drag."""
        self._dragged = None

    def throw(self, origin: ArrayLike, direction: ArrayLike) -> None:
        """Throw the next ball from a point [m], (3,), along a direction, (3,)."""
        ball = next(self._balls)
        start, way = (to_mujoco(np.asarray(v, float)) for v in (origin, direction))
        data, place, speed = self.character.data, ball.qposadr[0], ball.dofadr[0]
        data.qpos[place : place + 3] = start
        data.qvel[speed : speed + 6] = 0.0
        data.qvel[speed : speed + 3] = _BALL_SPEED * (way / np.linalg.norm(way))

    @property
    def props(self) -> tuple[Prop, ...]:
        """All props where they are now."""
        return self.scene_props.props(_HERE)

    @property
    def doing(self) -> str:
        """What the character does, in words."""
        gives = self.character.compliance
        if self.limp and not (gives and gives.fallen):
            return "hangs limp"
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
        """Number of frames recorded so far; None if nothing is being recorded."""
        return None if self._frames is None else len(self._frames)

    def record(self) -> None:
        """Start a recording; it keeps the last ten minutes."""
        self._frames = deque(maxlen=_LONGEST)

    def recorded(self) -> Clip:
        """Stop the recording and return it; raises InputError if it is too short."""
        frames, self._frames = self._frames or deque(), None
        if len(frames) < 2:
            raise InputError("nothing was recorded; play for a moment before stopping")
        columns = map(np.array, zip(*frames, strict=True))
        steps, root, rotations, contacts, force, poses = columns
        current, self.scene_props.poses = self.scene_props.poses, poses
        props = tuple(prop for prop in self.props if not _is_parked(prop))
        self.scene_props.poses = current
        motion = Motion(
            time=np.cumsum(steps) - steps[0],
            body=self.motion.body,
            root=root,
            rotations=rotations,
            source="kinefilter play",
        )
        return Clip.of(motion, contacts=contacts, external_force=force, props=props)


def _closed(clip: Clip) -> Clip:
    """Return a clip moved to the origin, with a transition back to its beginning."""
    if len(clip) < 2:
        raise InputError(f"{clip.source} has {len(clip)} frames; expected 2 or more")
    clip = resampled(clip, RATE)
    place = find_placement(clip.positions, clip.skeleton)
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
    x, y = _PARKED
    for k in range(_BALLS):
        name, place = f"{_BALL} {k + 1}", [x, y + 3.0 * k * _BALL_RADIUS, _BALL_RADIUS]
        ball = spec.worldbody.add_body(name=name, pos=place)
        ball.add_freejoint(name=name)
        ball.add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=[_BALL_RADIUS, 0.0, 0.0],
            mass=_BALL_MASS,
            condim=6,
            friction=[0.8, 0.005, 0.01],
            rgba=_BALL_COLOR,
        )


def _is_parked(prop: Prop) -> bool:
    far = to_mujoco(prop.positions)[:, 0] < 0.9 * _PARKED[0]
    return prop.name.startswith(_BALL) and bool(far.all())
