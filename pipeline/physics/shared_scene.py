"""A scene that people share frame by frame: they come and go, and push each other."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from kinefilter.characters import TRACKINGS, Body, InputError, Tracking, TrackingName
from kinefilter.characters.arrays import Array, Flags, as_numbers, check_choice
from kinefilter.characters.humanoid import from_mujoco
from kinefilter.characters.tracking import RagdollTracking
from kinefilter.pipeline.draft import Draft
from kinefilter.pipeline.stages import Stage
from kinefilter.pipeline.target.floor import find_placement
from kinefilter.retarget import HeadingFrame

from .grasp import seen_hands
from .moves import check_target
from .playable import Playable
from .pulled_character import PulledCharacter

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
        self._scene.take_hold(self)

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
        if self not in self._scene.people:
            raise InputError("the person is not in the scene yet; call step() first")
        return self._scene.characters[self._scene.people.index(self)]


class SharedScene(Playable):
    """A scene, one of SCENES or an MJCF file, with everyone whose frames come in.

    ``advance`` pulls all people to their targets at once; those without a new frame
    stay at their last. The first person appears at the origin, and all others where
    they are for the sensor, seen from there. ``tracking`` has the gains that pull
    everyone, or is one of TRACKINGS by name.
    """

    def __init__(self, scene: str | Path, tracking: Tracking | TrackingName) -> None:
        if not isinstance(tracking, Tracking):
            check_choice(tracking, TRACKINGS, "tracking")
            tracking = TRACKINGS[tracking]
        self.scene, self._tracking = scene, tracking
        self._place: HeadingFrame | None = None
        self.people: list[SharedPhysics] = []  # who the characters belong to
        self._told = dict[str, Array]()

    def placed(self, draft: Draft) -> tuple[Array, Array]:
        """Return a person's positions and rotations in the frame of the scene."""
        if self._place is None:
            self._place = find_placement(draft.positions[None], draft.skeleton)
        turned = self._place.remove_rotations(draft.rotations)
        return self._place.remove(draft.positions), turned

    def join(self, person: SharedPhysics) -> None:
        """Let a person in, unless they are there with this body already."""
        if person not in self.people or person.character.body is not person.body:
            others = [other for other in self.people if other is not person]
            self._go_on_with([*others, person])

    def leave(self, person: SharedPhysics) -> None:
        """Take a person out of the scene, if they are in it."""
        if person in self.people:
            self._go_on_with([other for other in self.people if other is not person])

    def take_hold(self, person: SharedPhysics) -> None:
        """Pull a person who was let go again; those who fell get up by themselves."""
        if person in self.people:
            gives = person.character.compliance
            if gives is None or not gives.fallen:
                hangs = isinstance(self._tracking, RagdollTracking)
                person.character.limp = hangs

    def _go_on_with(self, people: list[SharedPhysics]) -> None:
        """Make a world with these people, in which everything goes on as before."""
        known = dict(zip(self.people, self.characters, strict=True))
        before = self.world if self.has_world else None
        if not people:  # props wait for whoever comes next
            self.people, self.characters = people, ()
            return
        self._gather([person.body for person in people], self._tracking, self.scene)
        self.people = people
        if before is not None:
            self.world.take_props(before)
        for person, character in zip(people, self.characters, strict=True):
            last = known.get(person)
            if last is not None and last.body is person.body:
                character.take_over(last)
        self.scene_props.record(0)

    def advance(self) -> None:
        """Move everyone up to the newest frame, and complete the frames' drafts."""
        pairs = list(zip(self.people, self.characters, strict=True))
        new = [person for person in self.people if person.waiting is not None]
        dt = max((p.ahead for p in new if not p.appears), default=0.0)
        for person, character in pairs:
            if person.waiting is not None and person.appears:
                character.start(*person.target, reset_props=False)
                person.appears, person.ahead = False, dt
        good = np.ones(len(pairs), dtype=bool)
        if dt >= _SHORTEST:
            self._pull_dragged(dt)
            moves, feet = [], list[Flags | None]()
            for person, character in pairs:
                moves.append(character.plan(*person.target, dt, seen=person.seen))
                feet.append(person.stands)
                # By other clocks their frames may come later, but not by much.
                person.ahead = max(person.ahead - dt, -dt)
            good = self.world.follow(moves, feet)
            self.scene_props.record(0)
        for (person, character), fine in zip(pairs, good, strict=True):
            if (draft := person.waiting) is not None:
                person.waiting = None
                draft.positions = character.positions
                draft.rotations = character.rotations
                draft.external_force = character.external_force
                draft.reset = not fine

    def moved(self) -> dict[str, Array]:
        """Return where props are that moved since the last call.

        Positions [m] and rotations, wxyz, (7,), by name.
        """
        if not self.has_world:
            return {}
        poses = np.concatenate(self.scene_props.now, axis=1)
        named = zip(self.scene_props.moving, poses, strict=True)
        moved = {
            name: pose
            for name, pose in named
            if name not in self._told or np.abs(pose - self._told[name]).max() > _MOVED
        }
        self._told |= moved
        return moved

    def place(self, prop: str, position: ArrayLike, rotation: ArrayLike) -> bool:
        """Put a prop at a position [m] and rotation, wxyz; False if none can be.

        In the floor, a person or another prop, it is put above them.
        Raises an InputError if these are not three and four finite numbers.
        """
        position = as_numbers(position, "the position of a prop [m]", (3,), finite=True)
        rotation = as_numbers(rotation, "the rotation of a prop", (4,), finite=True)
        if not rotation.any():
            raise InputError("the rotation of a prop is zero; give w, x, y, z")
        return self.has_world and self.scene_props.put(prop, position, rotation)

    def contacts(self, person: SharedPhysics) -> tuple[Contact, ...]:
        """Return where a person touches the floor, props and other people."""
        character, found = person.character, dict[tuple[int, str], list[Array]]()
        model, data = character.model, character.data
        wrench, geoms = np.zeros(6), data.contact.geom
        joints = character.joint_of[model.geom_bodyid[geoms]]
        own = joints >= 0
        for k in np.flatnonzero(own.sum(axis=1) == 1).tolist():
            mujoco.mj_contactForce(model, data, k, wrench)
            if (force := float(np.linalg.norm(wrench[:3]))) > 0.0:
                name = self._name(int(geoms[k][~own[k]][0]))
                point = np.append(data.contact.pos[k], force)
                found.setdefault((int(joints[k].max()), name), []).append(point)
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
        for person, character in zip(self.people, self.characters, strict=True):
            if character.is_part[geom]:
                return person.person
        return self.scene_props.name_of(geom)
