"""A scene that people share frame by frame: they come and go, and push each other."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np

from kinefilter.characters import Body, InputError, Prop, Tracking
from kinefilter.characters.arrays import Array, Flags
from kinefilter.characters.humanoid import from_mujoco, to_mujoco
from kinefilter.pipeline.draft import Draft
from kinefilter.pipeline.stages import Stage
from kinefilter.pipeline.target.floor import find_placement
from kinefilter.retarget import HeadingFrame

from .grasp import seen_hands
from .pulled_character import PulledCharacter, check_target
from .scene_props import SceneProps
from .thrown_balls import ThrownBalls
from .world import World

HERE = HeadingFrame(np.zeros(3), np.zeros(()))  # the world is the scene's
_SHORTEST = 1e-3  # s: shorter steps wait for the next frame
_MOVED = 1e-4  # m, or of a quaternion: props that moved less are still


class Contact(NamedTuple):
    """Where a person's segment touches something that is not their own body."""

    joint: int  # at the end of the segment
    other: str  # a person, a prop, or the floor, by name
    position: Array  # mean of the points of contact [m], shape (3,)
    force: float  # sum of the forces there [N]


class SharedPhysics(Stage):
    """Takes the place of ``Physics`` for one of the people in a shared scene.

    A frame only sets the target, and is completed when the scene advances.
    """

    name = "physics"
    continues = True

    def __init__(self, scene: SharedScene, person: str) -> None:
        self._scene, self.person = scene, person

    def start(self, body: Body) -> None:
        """Reset for a new motion, which begins where the person appears."""
        self.body, self.appears = body, True
        self.ahead = 0.0  # time of the last frame after that of the scene [s]
        self.waiting: Draft | None = None  # the last frame, until the scene advances

    def step(self, draft: Draft) -> None:
        """Set the target; raises InputError if it is not finite, or as ``World``."""
        self.target = self._scene.placed(draft)
        check_target(*self.target)
        self.stands = draft.stands
        self.seen = seen_hands(draft.reliability, draft.skeleton)
        self.appears |= draft.appears
        self.ahead += draft.elapsed
        self._scene.join(self)
        self.waiting = draft

    def leave(self) -> None:
        """Leave the scene, until the next frame."""
        self._scene.leave(self)
        self.appears = True

    @property
    def contacts(self) -> tuple[Contact, ...]:
        """Where the person touches the floor, props and other people."""
        return self._scene.contacts(self)

    @property
    def character(self) -> PulledCharacter:
        """The person's character, another one whenever somebody comes or goes.

        Raises an InputError if the person is not in the scene.
        """
        if self not in self._scene.characters:
            raise InputError("nobody is in the scene yet; call step() first")
        return self._scene.characters[self]


class SharedScene:
    """A scene, one of SCENES or an MJCF file, with everyone whose frames come in.

    ``advance`` pulls all people to their targets at once; those without a new frame
    stay at their last. The first person appears at the origin, and all others where
    they are for the sensor, seen from there.
    """

    def __init__(self, scene: str | Path, tracking: Tracking) -> None:
        self.scene, self._tracking = scene, tracking
        self._place: HeadingFrame | None = None
        self.characters: dict[SharedPhysics, PulledCharacter] = {}
        self.world: World | None = None  # from the first person on
        self._things: SceneProps | None = None
        self._told = dict[str, Array]()

    def placed(self, draft: Draft) -> tuple[Array, Array]:
        """Return a person's positions and rotations in the frame of the scene."""
        if self._place is None:
            self._place = find_placement(draft.positions[None], draft.skeleton)
        turned = self._place.remove_rotations(draft.rotations)
        return self._place.remove(draft.positions), turned

    def join(self, person: SharedPhysics) -> None:
        """Let a person in, unless they are there with this body already."""
        there = self.characters.get(person)
        if there is None or there.body is not person.body:
            self._gather([p for p in self.characters if p is not person] + [person])

    def leave(self, person: SharedPhysics) -> None:
        """Take a person out of the scene, if they are in it."""
        if person in self.characters:
            self._gather([p for p in self.characters if p is not person])

    def _gather(self, people: list[SharedPhysics]) -> None:
        """Make a world with these people, in which everything goes on as before."""
        before, others = self.world, self.characters
        if not people:
            self.characters = {}  # props wait for whoever comes next
            return
        bodies, balls = [person.body for person in people], ThrownBalls()
        extend = balls.add_to
        world = World(bodies, self._tracking, scene=self.scene, extend=extend)
        self.characters = {
            p: PulledCharacter(p.body, self._tracking, world=world) for p in people
        }
        if before is not None:
            world.take_props(before)
        for person, character in self.characters.items():
            known = others.get(person)
            if known is not None and known.body is person.body:
                character.take_over(known)
        self.world, self._balls = world, balls
        roots = [character.root_body for character in self.characters.values()]
        self._things = SceneProps(world.data, roots, 1)
        self._things.record(0)

    def advance(self) -> None:
        """Move everyone up to the newest frame, and complete the frames' drafts."""
        people = list(self.characters)
        new = [person for person in people if person.waiting is not None]
        dt = max((p.ahead for p in new if not p.appears), default=0.0)
        for person in new:
            if person.appears:
                self.characters[person].start(*person.target, reset_props=False)
                person.appears, person.ahead = False, dt
        good = np.ones(len(people), dtype=bool)
        if dt >= _SHORTEST and self.world is not None and self._things is not None:
            moves, feet = [], list[Flags | None]()
            for person, character in self.characters.items():
                moves.append(character.plan(*person.target, dt, seen=person.seen))
                feet.append(person.stands)
                # By other clocks their frames may come later, but not by much.
                person.ahead = max(person.ahead - dt, -dt)
            good = self.world.follow(moves, feet)
            self._things.record(0)
        for person, fine in zip(people, good, strict=True):
            if (draft := person.waiting) is not None:
                character, person.waiting = self.characters[person], None
                draft.positions = character.positions
                draft.rotations = character.rotations
                draft.external_force = character.external_force
                draft.reset = not fine

    @property
    def props(self) -> tuple[Prop, ...]:
        """All props where they are now, in the frame of the scene."""
        return () if self._things is None else self._things.props(HERE)

    def moved(self) -> dict[str, Array]:
        """Return where props are that moved since the last call.

        Positions [m] and rotations, wxyz, (7,), by name.
        """
        if self._things is None:
            return {}
        poses = np.concatenate(self._things.now, axis=1)
        named = zip(self._things.moving, poses, strict=True)
        moved = {
            name: pose
            for name, pose in named
            if name not in self._told or np.abs(pose - self._told[name]).max() > _MOVED
        }
        self._told |= moved
        return moved

    def throw(self, position: Array, velocity: Array) -> bool:
        """Throw a ball from a point [m] with a velocity [m/s]; False if nobody came."""
        if self.world is None:
            return False
        self._balls.throw(self.world.data, position, velocity)
        return True

    def place(self, prop: str, position: Array, rotation: Array) -> bool:
        """Put a prop at a position [m] and rotation, wxyz; False if none can be."""
        if self._things is None:
            return False
        if (joint := self._things.free_joint(prop)) is None:
            return False
        joint.qpos[:3], joint.qpos[3:] = to_mujoco(position), to_mujoco(rotation)
        joint.qvel[:] = 0.0
        return True

    def contacts(self, person: SharedPhysics) -> tuple[Contact, ...]:
        """Return where a person touches the floor, props and other people."""
        character, found = person.character, dict[tuple[int, str], list[Array]]()
        model, data = character.model, character.data
        wrench = np.zeros(6)
        for k, geoms in enumerate(data.contact.geom):
            joints = character.joint_of[model.geom_bodyid[geoms]]
            if (joints < 0).sum() != 1:  # its own body, or nothing of it
                continue
            mujoco.mj_contactForce(model, data, k, wrench)
            if (force := float(np.linalg.norm(wrench[:3]))) > 0.0:
                name = self._name(int(geoms[joints.argmin()]))
                point = np.append(data.contact.pos[k], force)
                found.setdefault((int(joints.max()), name), []).append(point)
        return tuple(
            Contact(
                joint,
                other,
                from_mujoco(np.mean(points, axis=0)[:3]),
                float(np.sum(points, axis=0)[3]),
            )
            for (joint, other), points in found.items()
        )

    def _name(self, geom: int) -> str:
        """Return what a geom belongs to: a person, a prop or the floor."""
        assert self._things is not None
        for person, character in self.characters.items():
            if character.is_part[geom]:
                return person.person
        return self._things.name_of(geom)
