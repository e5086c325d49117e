"""The stage that pulls a simulated character through the motion."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from kinefilter.characters import Body, Skeleton, Tracking
from kinefilter.characters.arrays import Array
from kinefilter.characters.tracking import RagdollTracking
from kinefilter.pipeline.config import CleanConfig
from kinefilter.pipeline.draft import Draft
from kinefilter.pipeline.progress import Progress
from kinefilter.pipeline.stages import SharedStage
from kinefilter.pipeline.target.floor import find_placement
from kinefilter.retarget import HeadingFrame

from .filter import Targets, pull_through
from .grasp import seen_hands
from .pulled_character import PulledCharacter
from .world import World


class Physics(SharedStage):
    """Pulls a simulated character through the motion with bounded forces."""

    name = "physics"
    continues = True

    def __init__(self, config: CleanConfig, tracking: Tracking | None = None) -> None:
        self._scene, self._tracking = config.scene, tracking
        self.shared = config.scene is not None
        self.local = not self.shared  # props stay where the motion left them
        self._body: Body | None = None

    def start(self, body: Body) -> None:
        """Reset for a new motion, whose first frame is placed at the scene's origin."""
        if self._body is not body:
            self._body = body
            self.character = PulledCharacter(body, self._tracking, scene=self._scene)
        self.character.limp = isinstance(self._tracking, RagdollTracking)
        self._started = False

    def step(self, draft: Draft) -> None:
        """Pull the character to the next frame, in the frame of the scene if any."""
        first, self._started = not self._started, True
        if first:
            self._place = self._placement(draft.positions[None], draft.skeleton)
        positions, rotations = _placed(draft, self._place)
        if first or draft.appears:
            # Props stay where they are, except for the first frame.
            self.character.start(positions, rotations, reset_props=first)
        else:
            seen = seen_hands(draft.reliability, draft.skeleton)
            draft.reset = not self.character.step(
                positions, rotations, draft.elapsed, stands=draft.stands, seen=seen
            )
        draft.positions = self.character.positions
        draft.rotations = self.character.rotations
        draft.external_force = self.character.external_force

    def together(self, drafts: Sequence[Draft], progress: Progress) -> None:
        """Pull the characters of people of one recording through it in one world.

        The scene is where it is for the person who is seen in most frames.
        """
        main = max(drafts, key=lambda draft: len(draft.time))
        place = self._placement(main.positions, main.skeleton)
        bodies = [draft.body for draft in drafts]
        world = World(bodies, self._tracking, scene=self._scene)
        characters = [PulledCharacter(b, self._tracking, world=world) for b in bodies]
        people = []
        for draft in drafts:
            seen = seen_hands(draft.reliability, draft.skeleton)
            target = _placed(draft, place)
            people.append(Targets(draft.time, *target, draft.stands, seen))
        results = pull_through(characters, people, partial(progress, self.name))
        for draft, result in zip(drafts, results, strict=True):
            draft.positions, draft.rotations = result.positions, result.rotations
            if place is not None:
                draft.positions = place.restore(result.positions)
                draft.rotations = place.restore_rotations(result.rotations)
                draft.props = result.scene_props.props(place)
            draft.trace = result.trace

    def _placement(self, positions: Array, skeleton: Skeleton) -> HeadingFrame | None:
        return None if self._scene is None else find_placement(positions, skeleton)


def _placed(draft: Draft, place: HeadingFrame | None) -> tuple[Array, Array]:
    """Return positions and rotations in the scene's frame."""
    if place is None:
        return draft.positions, draft.rotations
    return place.remove(draft.positions), place.remove_rotations(draft.rotations)
