"""The physics filter: capsule humanoids pulled through the motions of a recording."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Body
from kinefilter.characters.anthropometry import positions_from_rotations, within_ranges
from kinefilter.characters.arrays import Array, Flags, Indices, chunks
from kinefilter.characters.gaps import LONG_GAP
from kinefilter.characters.humanoid import to_mujoco
from kinefilter.characters.rotations import continuous, slerp
from kinefilter.pipeline.target.feet import ankles_and_toes
from kinefilter.pipeline.target.floor import clearances, floor_penetration

from .moves import Move, check_target
from .pulled_character import PulledCharacter
from .scene_props import SceneProps

_SETTLING = 10  # frames of 1/30 s: longer than a foot takes to bear the body
_UNSEEN = 0.2  # s between two frames of a person who is then out of view. A guess.
_PLACE = 0.03  # m that toes move in a step, and not at rest. A guess.
_SUNK = 0.004  # m that soles sink at most. Few do, as contact is firm. A guess.
_CHUNK = 4096  # frames at a time, to bound the memory
# Of resets. Guesses.
_FOLLOWED = 0.1  # m of a joint from its target, up to which it follows
_LONGEST_LOST = 1.0  # s
_BLENDING_TIME = 0.2  # s in which the pose goes to its target, and leaves it


@dataclass(frozen=True, eq=False)
class PhysicsTrace:
    """Record of a simulation, frame by frame; arrays of shape (T,)."""

    tracking_error: Array  # mean distance of the joints from their targets [m]
    external_force: Array  # mean over the frame, that only the pulls explain [weights]
    contacts: NDArray[np.int64]  # points in which it touches itself or anything else
    reset: Flags
    """True where the character was reset onto its target: the simulation had diverged,
    or a limb was stuck at the end of its joint's range (``stuck_limbs``). Before
    and after, ``bridge_resets`` changes the motion; forces are the simulation's."""

    @property
    def status(self) -> str:
        """``ok``, or the number of frames with a reset."""
        resets = int(self.reset.sum())
        frames = f"{resets} frame{'s' * (resets != 1)}"
        return f"character reset onto its target in {frames}" if resets else "ok"


@dataclass(frozen=True, eq=False)
class PhysicsResult:
    """The simulated motion."""

    rotations: Array  # world segment rotations, wxyz, shape (T, J, 4)
    positions: Array  # joint positions [m], world frame, shape (T, J, 3)
    trace: PhysicsTrace
    scene_props: SceneProps  # the props of the scene, in the frame of the targets


@dataclass(frozen=True, eq=False)
class Targets:
    """A person's targets, as for ``PulledCharacter.step``, with a leading axis T."""

    time: Array  # time stamps [s], strictly increasing, shape (T,)
    positions: Array
    rotations: Array
    stands: Flags | None = None  # which feet bear weight, (T, 2); None if none does
    seen: Flags | None = None  # which hands the sensor saw, (T, 2); None if always both


class _Cue:
    """What one character does at the time stamps of everyone, and how it went."""

    def __init__(
        self, character: PulledCharacter, person: Targets, stamps: Array
    ) -> None:
        check_target(person.positions, person.rotations)
        own, count = person.time, len(person.time)
        self.character, self._person = character, person
        self._accelerations = _accelerations(own, person.positions)
        self._planned: tuple[int, Move] | None = None
        self._toes = ankles_and_toes(character.body.skeleton)[1]
        last, stop = count - 1, np.searchsorted(own, stamps)
        self._after = np.minimum(stop, last)  # the next own frame, or the last
        self._before = np.maximum(self._after - 1, 0)
        gap = own[self._after] - own[self._before]
        inside = (stamps >= own[0]) & (stamps <= own[-1])
        self._is_own = inside & (own[self._after] == stamps)
        away = inside & ~self._is_own
        self.solid = self._is_own | (away & (gap <= _UNSEEN))
        # Whoever is away for long waits where they will appear.
        held = ~inside | (gap > LONG_GAP) | self._is_own | (gap <= 0.0)
        share = (stamps - own[self._before]) / np.where(gap > 0.0, gap, 1.0)
        self._share = np.where(held, 1.0, share)
        self.appears = np.zeros(len(stamps), dtype=bool)
        self.appears[1:] = (np.diff(self._after) != 0) & (gap[1:] > LONG_GAP)
        types = (float, float, np.int64, np.bool_)
        self._trace = PhysicsTrace(*(np.zeros(count, dtype) for dtype in types))
        self._turns, self._roots = np.empty_like(person.rotations), np.empty((count, 3))
        roots = [other.root_body for other in character.world.characters]
        self._props = SceneProps(character.data, roots, count)

    def target(self, k: int) -> tuple[Array, Array]:
        """Return positions (J, 3) and rotations (J, 4) at a time stamp."""
        share, p, q = self._share[k], self._person.positions, self._person.rotations
        one, two = self._before[k], self._after[k]
        if share == 1.0:
            return p[two], q[two]
        return p[one] + share * (p[two] - p[one]), slerp(q[one], q[two], share)

    def stands(self, k: int) -> Flags | None:
        """Return which feet bear weight, up to a time stamp.

        A foot that lands or steps while nobody sees it does not until it is there.
        """
        person, after, before = self._person, self._after[k], self._before[k]
        if person.stands is None:
            return None
        stands = person.stands[after]
        if _UNSEEN < person.time[after] - person.time[before] <= LONG_GAP:
            moved = person.positions[after] - person.positions[before]
            away = np.linalg.norm(moved[self._toes], axis=1)
            stands = stands & person.stands[before] & (away < _PLACE)
        return np.asarray(stands)

    def move(self, k: int, dt: float) -> Move:
        """Return the move to a time stamp that comes ``dt`` [s] after the last."""
        character, after = self.character, int(self._after[k])
        if character.keeps_target and self._is_own[k] and self._is_own[k - 1]:
            return self._own_move(after)
        gained = np.where(self._is_own[k], self._accelerations[after], 0.0)
        seen = None if self._person.seen is None else self._person.seen[after]
        return character.plan(*self.target(k), dt, acceleration=gained, seen=seen)

    def _own_move(self, frame: int) -> Move:
        """Return the move to one of the person's frames, planned many at a time."""
        chunk, row = divmod(frame, _CHUNK)
        if self._planned is None or self._planned[0] != chunk:
            person = self._person
            there = np.arange(len(person.time))[chunk * _CHUNK :][:_CHUNK]
            back = np.maximum(there - 1, 0)
            before, after = (
                (to_mujoco(person.positions[k]), to_mujoco(person.rotations[k]))
                for k in (back, there)
            )
            dt = person.time[there] - person.time[back]
            dt = np.where(dt > 0.0, dt, 1.0)  # the very first is not used
            gained = to_mujoco(self._accelerations[there])
            self._planned = chunk, self.character.planner(before, after, gained, dt)
        return self._planned[1][row]

    def record(self, k: int, *, reset: bool) -> None:
        """Record the pose at a time stamp, if it is the person's own."""
        if not self._is_own[k]:
            return
        own, character, trace = self._after[k], self.character, self._trace
        data = character.data
        trace.contacts[own] = character.is_part[data.contact.geom].any(axis=1).sum()
        trace.external_force[own], trace.reset[own] = character.external_force, reset
        self._turns[own], self._roots[own] = character.rotations, character.root
        self._props.record(own)

    def result(self) -> PhysicsResult:
        """Return what was recorded, without thrashing or joints beyond their range."""
        person, body = self._person, self.character.body
        target = person.rotations, person.positions[:, body.skeleton.root]
        resets = np.flatnonzero(self._trace.reset)
        bridge_resets(person.time, (self._turns, self._roots), target, resets, body)
        joints = np.empty_like(person.positions)
        for some in chunks(len(joints), _CHUNK):
            # Ranges are soft in the engine, and the target may ignore them. Keeping
            # them may move feet into the floor.
            turns = self._turns[some] = within_ranges(self._turns[some], body.skeleton)
            joints[some] = positions_from_rotations(turns, self._roots[some], body)
            deep = floor_penetration(joints[some, :, 1], clearances(body), _SUNK)
            joints[some, :, 1] += deep[:, None]
            away = np.linalg.norm(joints[some] - person.positions[some], axis=-1)
            self._trace.tracking_error[some] = away.mean(axis=-1)
        return PhysicsResult(continuous(self._turns), joints, self._trace, self._props)


def pull_through(
    characters: Sequence[PulledCharacter],
    people: Sequence[Targets],
    frames: Callable[[int], Iterable[int]] = range,
) -> list[PhysicsResult]:
    """Pull all characters of a world through their motions, at the same time.

    They restart after long gaps. A person who is out of view stands on the floor but
    touches nobody and nothing else. Results have each person's own time stamps.
    ``frames`` yields the indices of that many frames, for example for a progress bar.
    """
    stamps = np.unique(np.concatenate([person.time for person in people]))
    world = characters[0].world
    pairs = zip(characters, people, strict=True)
    cues = [_Cue(character, person, stamps) for character, person in pairs]
    for k in frames(len(stamps)):
        dt = float(stamps[k] - stamps[k - 1])
        restarts = k == 0 or dt > LONG_GAP
        for cue in cues:
            cue.character.set_solid(bool(cue.solid[k]))
            if restarts or cue.appears[k]:
                cue.character.start(*cue.target(k), reset_props=k == 0)
        stands = [cue.stands(k) for cue in cues]
        if restarts:
            # Hold the first target until the initial transient is gone.
            for _ in range(_SETTLING):
                held = [cue.character.plan(*cue.target(k), 1 / 30) for cue in cues]
                world.follow(held, stands)
            for cue in cues:
                cue.character.fastest_start = np.inf  # as its target was smoothed
            good = np.ones(len(cues), dtype=bool)
        else:
            good = world.follow([cue.move(k, dt) for cue in cues], stands)
        for cue, fine in zip(cues, good, strict=True):
            cue.record(k, reset=not fine)
    return [cue.result() for cue in cues]


def _accelerations(time: Array, positions: Array) -> Array:
    """Return central second differences [m/s^2], 0 at the ends of each part."""
    accelerations, steps = np.zeros_like(positions), np.diff(time)[:, None, None]
    velocities = np.diff(positions, axis=0) / steps
    inner = (velocities[1:] - velocities[:-1]) / (0.5 * (steps[1:] + steps[:-1]))
    longest = np.maximum(steps[1:], steps[:-1])
    accelerations[1:-1] = np.where(longest > LONG_GAP, 0.0, inner)
    return accelerations


def bridge_resets(
    time: Array,
    pose: tuple[Array, Array],
    target: tuple[Array, Array],
    resets: Indices,
    body: Body,
) -> None:
    """Blend the pose into the target about each reset, so that nothing jumps.

    Lost limbs thrash before it, and after it those whose target is inside another part
    of the body; the target may be a posture that no body can take, but it moves as the
    sensor saw it.

    Pose, which is changed, and target are rotations, wxyz, (T, J, 4), and positions of
    the root [m], (T, 3), at each time stamp [s]. ``resets`` are frames of resets.
    """
    # Between resets in a row there is nothing to blend.
    first = resets[np.diff(resets, prepend=-2) > 1].tolist()
    last = resets[np.diff(resets, append=len(time) + 1) > 1].tolist()
    reach = _LONGEST_LOST + _BLENDING_TIME
    for reset, after in [(k, False) for k in first] + [(k, True) for k in last]:
        edge = time[reset] + (reach if after else -reach)
        near = slice(*sorted([reset, int(np.searchsorted(time, edge))]))
        # Toward the reset.
        way = slice(None, None, -1 if after else 1)
        now = -np.abs(time[near] - time[reset])[way]
        turns, roots, wanted, there = (x[near][way] for x in (*pose, *target))
        away = positions_from_rotations(turns, roots, body)
        away -= positions_from_rotations(wanted, there, body)
        follows = (np.linalg.norm(away, axis=-1) < _FOLLOWED).all(axis=-1)
        # A limb that comes back only for a moment does not follow.
        left = np.maximum.accumulate(np.where(follows, -np.inf, now))
        lost = max([-_LONGEST_LOST, *now[now - left > _BLENDING_TIME][-1:]])
        share = np.clip(1.0 + (now - lost) / _BLENDING_TIME, 0.0, 1.0)
        turns[:] = slerp(turns, wanted, share[:, None])
        roots += share[:, None] * (there - roots)
        heights = positions_from_rotations(turns, roots, body)[..., 1]
        roots[:, 1] += floor_penetration(heights, clearances(body))
