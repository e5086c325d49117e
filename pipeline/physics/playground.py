"""Characters that repeat motions in a scene, and that one can push and throw at."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from kinefilter.characters import TRACKINGS, Clip, InputError, Motion
from kinefilter.characters.anthropometry import positions_from_rotations
from kinefilter.characters.arrays import Array, Flags
from kinefilter.characters.rotations import slerp
from kinefilter.characters.tracking import TrackingName
from kinefilter.pipeline.formats.export import resampled
from kinefilter.pipeline.target.feet import planted_feet
from kinefilter.pipeline.target.floor import find_placement
from kinefilter.retarget import HeadingFrame
from kinefilter.retarget.limbs import smooth_step

from .grasp import seen_hands
from .playable import Playable
from .pulled_character import PulledCharacter
from .thrown_balls import is_parked

RATE = 30.0  # frame rate [1/s] of the motion and of recordings
_BACK, _SLOWEST = 0.6, 1.5  # s at least, and m/s, from a motion's end to its beginning
_BESIDE = 0.6  # m between the reach of characters who start beside each other
_UNEVEN = 1e-6  # s by which steps may differ; those in slow motion are shorter
_LONGEST = 10 * 60 * int(RATE)  # frames of a recording


class Playground(Playable):
    """An interactive simulation for a page or a game, in the scene's frame, y up.

    Each motion is moved so that it begins facing +z, the first at the origin and the
    others beside it, unless ``placed``: then they are where their clips have them, seen
    from the first. They are repeated in a scene, one of SCENES or an MJCF file. Raises
    InputError as ``World``, or if a motion is too short.
    """

    def __init__(
        self,
        motions: Clip | Sequence[Clip],
        scene: str | Path,
        tracking: TrackingName = "game",
        *,
        placed: bool = False,
    ) -> None:
        clips = [motions] if isinstance(motions, Clip) else motions
        if placed:
            place = _beginning(clips[0])
            self.motions = [_closed(clip, place) for clip in clips]
        else:
            self.motions = _beside(clips)
        self.motion = self.motions[0]
        self.scene, self.tracking = scene, tracking
        self._frames: deque[list[tuple[Any, ...]]] | None = None
        self._set_up()

    def _set_up(self) -> None:
        bodies = [motion.body for motion in self.motions]
        tracking = TRACKINGS[self.tracking]
        self._gather(bodies, tracking, self.scene)
        self.character = self.characters[0]
        self._pairs = list(zip(self.characters, self.motions, strict=True))
        self.resets = 0
        self.restart()

    def restart(self) -> None:
        """Restart the motions, with every prop where the scene has it.

        Characters that were let go are pulled again.
        """
        self.time = 0.0
        for character, motion in self._pairs:
            character.limp = self.tracking == "ragdoll"
            character.start(*self._target(motion)[:2])
        self.scene_props.record(0)

    def change(
        self, *, scene: str | Path | None = None, tracking: TrackingName | None = None
    ) -> None:
        """Restart in another scene or with another tracking; raises as the class.

        A recording has to end before the scene changes, or an InputError is raised.
        """
        if scene is not None and self._frames is not None:
            raise InputError(
                "a clip is being recorded; end that before changing the scene"
            )
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
        before, self.time = self.time, self.time + dt
        for character, motion in self._pairs:
            began, now = (int(t * RATE) // len(motion) for t in (before, self.time))
            if now > began:
                self._put_back(character)
        self._pull_dragged(dt)
        moves, feet = [], []
        for character, motion in self._pairs:
            positions, rotations, stands = self._target(motion)
            reliability = motion.reliability[self._frame(motion)]
            seen = seen_hands(reliability, motion.skeleton)
            moves.append(character.plan(positions, rotations, dt, seen=seen))
            feet.append(stands)
        self.resets += int(np.sum(~self.world.follow(moves, feet)))
        self.scene_props.record(0)
        if self._frames is not None:
            props, rows = self.scene_props.poses[0].copy(), []
            for character, motion in self._pairs:
                contacts = motion.contacts[self._frame(motion)]
                pose = character.root, character.rotations, contacts
                rows.append((dt, *pose, character.external_force, props))
            self._frames.append(rows)

    @staticmethod
    def _put_back(character: PulledCharacter) -> None:
        """Put props that hands can hold where a motion, which repeats, begins.

        What another character holds stays in their hands.
        """
        others = [other for other in character.world.characters if other != character]
        held = {prop.name for other in others if (prop := other.grasp.held) is not None}
        character.grasp.start()
        for prop in character.grasp.props:
            if prop.name not in held:
                prop.put_back()

    def _frame(self, motion: Clip) -> int:
        """Return the frame of a motion at this time."""
        return int(self.time * RATE) % len(motion)

    def _target(self, motion: Clip) -> tuple[Array, Array, Flags]:
        """Return a motion's positions, rotations and planted feet at this time."""
        at, first = self.time * RATE, self._frame(motion)
        second, share = (first + 1) % len(motion), at - int(at)
        turns = slerp(motion.rotations[first], motion.rotations[second], share)
        root = motion.root[first] + share * (motion.root[second] - motion.root[first])
        stands = planted_feet(motion.contacts[[first]])[0]
        return positions_from_rotations(turns, root, motion.body), turns, stands

    @property
    def recording(self) -> int | None:
        """Number of frames recorded so far; None if nothing is being recorded."""
        return None if self._frames is None else len(self._frames)

    @property
    def recorded_time(self) -> float:
        """Time recorded so far [s], of the motion and not of the clock."""
        return float(sum(rows[0][0] for rows in self._frames or ()))

    def record(self) -> None:
        """Start a recording; it keeps the last ten minutes."""
        self._frames = deque(maxlen=_LONGEST)

    def recorded(self) -> list[Clip]:
        """Return each character's clip so far. InputError if it is too short."""
        frames = self._frames or ()
        if len(frames) < 2:
            raise InputError("nothing was recorded; play for a moment before stopping")
        return list(map(self._clip, self.motions, zip(*frames, strict=True)))

    def stop_recording(self) -> None:
        """Discard what was recorded; recording may start again."""
        self._frames = None

    def _clip(self, played: Clip, frames: tuple[tuple[Any, ...], ...]) -> Clip:
        columns = map(np.array, zip(*frames, strict=True))
        steps, root, rotations, contacts, force, poses = columns
        current, self.scene_props.poses = self.scene_props.poses, poses
        props = tuple(prop for prop in self.props if not is_parked(prop))
        self.scene_props.poses = current
        time, body = np.cumsum(steps) - steps[0], played.body
        moved = {"time": time, "root": root, "rotations": rotations}
        motion = Motion(body=body, source="kinefilter play", **moved)
        what = {"contacts": contacts, "external_force": force, "props": props}
        clip = Clip.of(motion, **what)
        return clip if np.ptp(steps) < _UNEVEN else resampled(clip, RATE)


def _beside(clips: Sequence[Clip]) -> list[Clip]:
    """Return closed motions that begin side by side, odd ones left of the first."""
    motions = [_closed(clip, _beginning(clip)) for clip in clips]
    right, left, moved = 0.0, 0.0, []
    for number, motion in enumerate(motions):
        across = motion.positions[0, :, 0]
        least, most = float(across.min()), float(across.max())
        place = 0.0
        if number:
            place = left + (_BESIDE - least) if number % 2 else right - (_BESIDE + most)
        right, left = min(right, place + least), max(left, place + most)
        moved.append(replace(motion, root=motion.root + np.array([place, 0.0, 0.0])))
    return moved


def _beginning(clip: Clip) -> HeadingFrame:
    if len(clip) < 2:
        raise InputError(f"{clip.source} has {len(clip)} frames; expected 2 or more")
    return find_placement(resampled(clip, RATE).positions, clip.skeleton)


def _closed(clip: Clip, place: HeadingFrame) -> Clip:
    """Return a clip as seen from a place, with a transition back to its beginning."""
    clip = resampled(clip, RATE)
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
