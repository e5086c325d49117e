"""Finds frames in which a sensor has left and right swapped, and swaps them back.

A sensor takes people whom it sees from behind for people who face it. It still sees
where the limbs are, and how these bend shows which way a body faces; people also mostly
walk forward. So the sides are chosen that agree best with that, and with those of other
sensors, without joints that leap from one side to the other: the cheapest path over all
frames (Viterbi 1967), or, live, the cheapest path so far. A single sensor may have arms
and legs change sides at different times.
"""

from collections import deque
from collections.abc import Iterable
from dataclasses import replace
from itertools import combinations, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import Skeleton, State, Take
from kinefilter.characters.arrays import Array, Codes, Flags, Indices, chunks
from kinefilter.retarget import find_yaw

from .trunk import steadied

# Chosen on simulated people (seeds 40 to 51 and 140 to 145) and on p00 to p08 of
# two-kinects; what it costs to walk backward and to be swapped, and what is only for a
# single sensor, on the latter, on s02, s03 and s04 of UI-PRMD, and on simulated people
# who turn on the spot (seeds 90000 to 90020).
_CHUNK = 256  # frames at a time, to bound the memory
_FAR = 0.5  # m; joints farther apart cost no more
_LIMBS = ("Shoulder", "Elbow", "Wrist"), ("Hip", "Knee", "Ankle")
# Log odds, for each of ``facing_inputs``, that bodies face the way their sides say,
# learned by ``lab.facing_lessons`` from p00 to p08, s02 to s04 and CMU's 02 to 32.
FACING_WEIGHTS = np.array([-10.7, 44.2, 13.5, -32.1, 14.8, 29.6, -7.5, 22.6])
_DOUBT = 3.0  # log odds of a body that quite surely faces that way
_FACING = 0.1  # m of mean distance: cost of a body that bends the other way
_WALK = 0.85  # cost of walking backward, relative to that
_WALKING = 0.4  # m/s of somebody who certainly walks
_SWAPPED = 0.05  # m of mean distance: cost of each frame with swapped sides
_CHANGE = 0.02  # m that a change costs besides the distance that joints leap
_STRIDE = 1.0 / 3.0  # s before and after a frame that show how fast somebody walks
# Live, on p00 to p08 alone: joints that leap count less, swapped sides cost more, and
# less time shows how somebody walks. Otherwise sides that change late stay wrong.
_LIVE_CONTINUITY, _LIVE_SWAPPED, _LIVE_STRIDE = 1.0, 0.1, 0.4
_LEAST_WEIGHT = 1e-3  # of a joint that is not tracked
_APART = 0.1  # cost of each frame in which only arms or only legs are swapped
_CONTINUITY = 5.0  # weight of the distance that joints move from frame to frame
_LEAP = 3.0  # weight of the distance that they move between twice ``_AROUND``
_AROUND = 0.1  # s before and after a change


class CheapestPath:
    """Follows which of some choices (N, ...) holds, frame by frame (Viterbi 1967)."""

    def __init__(self, choices: NDArray[Any]) -> None:
        self._choices = choices
        self.start()

    def start(self) -> None:
        """Reset the state for a new motion."""
        self._costs_so_far = np.zeros(len(self._choices))

    def step(self, *seen: Any) -> Any:
        """Return the best choice so far, given what is seen in the next frame."""
        ((ways, costs),) = self._costs(*(np.asarray(part)[None] for part in seen))
        return self._next(ways, costs)[0]

    def whole(self, *seen: NDArray[Any]) -> NDArray[Any]:
        """Return the choice in each frame (T, ...), given what is seen (T, ...)."""
        self.start()
        some = chunks(len(seen[0]), _CHUNK)
        frames = (frame for k in some for frame in self._costs(*(x[k] for x in seen)))
        predecessors = [self._next(*frame)[1] for frame in frames]
        path = [int(self._costs_so_far.argmin())]
        for before in predecessors[:0:-1]:
            path.append(int(before[path[-1]]))
        return self._choices[path[::-1]]

    def _costs(self, *seen: Any) -> Iterable[tuple[Array, Array]]:
        """Yield the arguments of ``_next`` for frames; here they are what is seen."""
        return zip(*seen, strict=True)

    def _next(self, ways: Array, costs: Array) -> tuple[Any, NDArray[np.uint16]]:
        """Return the best choice, and each one's predecessor on its cheapest path.

        ``costs`` are those of the choices (N,), ``ways`` those of getting there (N, N).
        """
        ways = self._costs_so_far[:, None] + ways
        costs = costs + ways.min(axis=0)
        self._costs_so_far = costs - costs.min()
        return self._choices[costs.argmin()], ways.argmin(axis=0).astype(np.uint16)


class Sides(CheapestPath):
    """Follows which of some sensors have left and right swapped, flags (S,)."""

    _continuity, _swapped = _CONTINUITY, _SWAPPED

    def __init__(self, skeleton: Skeleton, sensors: int) -> None:
        self._skeleton, self._mirror = skeleton, skeleton.mirror
        self._paired = np.flatnonzero(self._mirror != np.arange(len(skeleton)))
        choices = np.array(list(product((False, True), repeat=sensors)))
        self._changes = choices[:, None] != choices
        super().__init__(choices)

    def start(self) -> None:
        """Reset the state for a new motion."""
        super().start()
        shape = self._choices.shape[1], len(self._paired)
        self._last = np.full((*shape, 3), np.nan), np.zeros(shape)

    def _costs(self, seen: Array, weights: Array) -> Iterable[tuple[Array, Array]]:
        """Yield what sides cost in frames; see ``CheapestPath``.

        ``seen`` are the joints of each sensor [m], NaN where missing, (T, S, J, 3), and
        ``weights`` tell how much each counts, (T, S, J).
        """
        paired, choices, (count, sensors) = self._paired, self._choices, seen.shape[:2]
        as_given, mirrored = seen[:, :, paired], seen[:, :, self._mirror[paired]]
        sure = _weights_of_pairs(seen, weights, self._mirror)[:, :, paired]
        # When each sensor saw anybody last: 0 is before the first of these frames.
        there = ~np.isnan(as_given).all(axis=(2, 3))
        when = np.where(there, np.arange(1, count + 1)[:, None], 0)
        when = np.maximum.accumulate(np.concatenate([0 * when[:1], when]))
        pairs = zip(self._last, (as_given, sure), strict=True)
        past = [np.concatenate([last[None], now]) for last, now in pairs]
        each = np.arange(sensors)
        before, trust = (values[when[:-1], each] for values in past)
        self._last = past[0][when[-1], each], past[1][when[-1], each]
        both, known = sure * trust, ~np.isnan(before).all(axis=(2, 3))
        same = np.where(known, _distance(as_given, before, both), 0.0)
        other = np.where(known, _distance(mirrored, before, both) + _CHANGE, 0.0)
        ways = np.zeros((count, *self._changes.shape[:2]))
        for s, changes in enumerate(np.moveaxis(self._changes, -1, 0)):
            moved = np.where(changes, other[:, s, None, None], same[:, s, None, None])
            ways += self._continuity * moved
        facing = self._facing(seen.reshape(-1, *seen.shape[2:]))
        costs = (self._swapped + _FACING * facing.reshape(count, -1)) @ choices.T
        for s, k in combinations(range(sensors), 2):
            both, alike = sure[:, s] * sure[:, k], choices[:, s] == choices[:, k]
            same = _distance(as_given[:, s], as_given[:, k], both)
            other = _distance(as_given[:, s], mirrored[:, k], both)
            costs += np.where(alike, same[:, None], other[:, None])
        return zip(ways, costs, strict=True)

    def _facing(self, seen: Array) -> Array:
        """Return how surely bodies (N, J, 3) face as given, negative if not, (N,)."""
        return _facing(seen, self._skeleton)[1]


class LiveSides(Sides):
    """Follows whether the only sensor has left and right swapped, frame by frame."""

    _continuity, _swapped = _LIVE_CONTINUITY, _LIVE_SWAPPED

    def __init__(self, skeleton: Skeleton) -> None:
        super().__init__(skeleton, 1)

    def start(self) -> None:
        """Reset the state for a new motion."""
        super().start()
        self._places: deque[tuple[float, Array]] = deque()
        self._velocity = np.zeros(3)

    def swapped(self, seen: Array, state: Codes, time: float) -> bool:
        """Return whether the sides of a frame are swapped, as far as can be said.

        Joints [m] (J, 3) are NaN where missing, states (State) (J,); time stamp [s].
        """
        places, root = self._places, seen[self._skeleton.root]
        if np.isfinite(root).all():
            places.append((time, root))
        while len(places) > 2 and places[1][0] <= time - _LIVE_STRIDE:
            places.popleft()
        if len(places) > 1:
            (then, there), (now, here) = places[0], places[-1]
            self._velocity = (here - there) / max(now - then, 0.5 * _LIVE_STRIDE)
        weights = np.where(state == State.TRACKED, 1.0, _LEAST_WEIGHT)
        seen = _without_guessed_knees(seen[None], state[None], self._skeleton)[0]
        return bool(self.step(seen[None], weights[None])[0])

    def _facing(self, seen: Array) -> Array:
        """Return how surely the body faces as given, also by how it walks, (1,)."""
        forward, facing = _facing(seen, self._skeleton)
        return facing + _walking(self._velocity, forward)


def facing_inputs(seen: Array, skeleton: Skeleton) -> tuple[Array, Array]:
    """Return which way bodies face by their sides, and how they bend that way.

    Horizontal unit vectors (N, 3), and numbers that change their sign with the sides,
    (N, 8): for each kind of limb segment, of left and right together, how far its end
    is in front of the hips (if missing, of the shoulders) [m], and how far in front of
    its start times how far above it [m²]. Limbs of which a joint is missing do not
    count.
    """
    forward, inputs = _direction(find_yaw(seen, skeleton)), []
    limbs = [
        np.stack([seen[:, skeleton.sides(part)] for part in limb], axis=2)
        for limb in _LIMBS  # (N, sides, joints, 3)
    ]
    shoulders, hips = (limb[:, :, 0].mean(axis=1) for limb in limbs)
    middle = np.where(np.isnan(hips), shoulders, hips)[:, None]
    for limb in limbs:
        missing = np.asarray(np.isnan(limb).any(axis=(2, 3)))[..., None]
        for start, end in ((0, 1), (1, 2)):
            along = limb[:, :, end] - limb[:, :, start]
            for each in (limb[:, :, end] - middle, along * along[..., [1]]):
                total = np.where(missing, 0.0, each).sum(axis=1)
                inputs.append(np.vecdot(total, forward))
    return forward, np.nan_to_num(np.stack(inputs, axis=1))


def _facing(seen: Array, skeleton: Skeleton) -> tuple[Array, Array]:
    """Return which way bodies face by their sides, and how surely by how they bend.

    Horizontal unit vectors (N, 3), and numbers in [-1, 1] (N,), negative if they bend
    the other way.
    """
    forward, inputs = facing_inputs(seen, skeleton)
    trunk = seen[:, skeleton.girdle] - seen[:, skeleton.root]
    upright = trunk[:, 1] / (np.linalg.norm(trunk, axis=1) + 1e-9)
    sure = np.tanh(inputs @ FACING_WEIGHTS / _DOUBT)
    return forward, np.asarray(sure * np.clip(np.nan_to_num(upright), 0.0, 1.0))


def _walking(velocity: Array, forward: Array) -> Array:
    """Return how surely bodies walk forward, negative if backward, (N,).

    Velocities [m/s] and directions are (N, 3).
    """
    along = np.nan_to_num(np.vecdot(velocity / _WALKING, forward))
    return np.asarray(_WALK * along.clip(-1.0, 1.0))


def _without_guessed_knees(seen: Array, state: Codes, skeleton: Skeleton) -> Array:
    """Return joints (T, J, 3) without knees that a sensor guesses behind a desk.

    They bend backward there.
    """
    seen, knees = seen.copy(), skeleton.sides("Knee")
    guessed = (state[:, knees] != State.TRACKED).all(axis=1)
    seen[np.ix_(guessed, knees)] = np.nan
    return seen


def _direction(yaw: Array) -> Array:
    """Return the horizontal unit vectors of headings (...), shape (..., 3)."""
    return np.stack([np.sin(yaw), np.zeros_like(yaw), np.cos(yaw)], axis=-1)


def _distance(points: Array, others: Array, weights: Array) -> Array:
    """Return the mean distance between joints [m] (..., K, 3), 0 if none is known."""
    apart = np.minimum(np.linalg.norm(points - others, axis=-1), _FAR)
    weights = np.where(np.isnan(apart), 0.0, weights)
    total = weights.sum(axis=-1)
    away = (weights * np.nan_to_num(apart)).sum(axis=-1)
    return np.asarray(away / np.where(total > 0.0, total, 1.0))


def _weights_of_pairs(seen: Array, weights: Array, mirror: Indices) -> Array:
    """Return how much joints count (..., J), 0 unless both sides of a pair are seen."""
    weights = np.where(np.isnan(seen[..., 0]), 0.0, weights)
    return np.asarray(np.minimum(weights, weights[..., mirror]))


def swapped_frames(take: Take) -> Flags:
    """Return where a take has left and right swapped: trunk and arms, and legs, (T, 2).

    Both face the same way, but may change sides at different times.
    """
    choices = np.array(list(product((False, True), repeat=2)))
    seen = _without_guessed_knees(take.positions, take.state, take.skeleton)
    forward, facing = _facing(seen, take.skeleton)
    root = take.positions[:, take.skeleton.root]
    facing += _walking(root_velocity(take.time, root), forward)
    costs = np.outer(_SWAPPED + _FACING * facing, choices.mean(axis=1))
    costs += _APART * (choices[:, 0] != choices[:, 1])
    ways = np.zeros((len(take), 4, 4))
    legs = take.skeleton.legs
    paired = take.skeleton.mirror != np.arange(len(take.skeleton))
    rest = np.setdiff1d(np.flatnonzero(paired), legs)
    for k, joints in enumerate((rest, legs)):
        same, other = _costs_of_moving(take, joints)
        changes = choices[:, None, k] != choices[:, k]
        ways += np.where(changes, other[:, None, None], same[:, None, None])
    return CheapestPath(choices).whole(ways, costs)


def _costs_of_moving(take: Take, joints: Indices) -> tuple[Array, Array]:
    """Return what it costs that joints keep or change sides, as they move, (T,).

    Limbs may change over some frames: what was 0.1 s before and after counts as well.
    """
    seen, time, count = take.positions, take.time, len(take)
    mirror = take.skeleton.mirror
    weights = np.where(take.state == State.TRACKED, 1.0, _LEAST_WEIGHT)
    sure = _weights_of_pairs(seen, weights, mirror)[:, joints]
    now, known = np.arange(count), ~np.isnan(seen).all(axis=(1, 2))
    last = np.maximum.accumulate(np.where(known, now, 0))
    last = np.concatenate([[0], last[:-1]])
    middle = 0.5 * (time + np.concatenate([time[:1], time[:-1]]))
    before = (np.searchsorted(time, middle - _AROUND, "right") - 1).clip(min=0)
    after = np.searchsorted(time, middle + _AROUND).clip(max=count - 1)

    def cost(others: Indices, change: float) -> Array:
        step, leap = (
            _distance(seen[b][:, others], seen[a][:, joints], sure[a] * sure[b])
            for a, b in ((last, now), (before, after))
        )
        return np.asarray(0.5 * (_CONTINUITY * (step + change) + _LEAP * leap))

    return cost(joints, 0.0), cost(mirror[joints], _CHANGE)


def root_velocity(time: Array, root: Array) -> Array:
    """Return how fast the root (T, 3) moves, over two thirds of a second [m/s]."""
    known = np.isfinite(root[:, 0])
    if not known.any():
        return np.zeros_like(root)
    ends = np.array([time - _STRIDE, time + _STRIDE])
    places = [np.interp(ends, time[known], column[known]) for column in root.T]
    return np.asarray(np.diff(places, axis=1)[:, 0].T / (2.0 * _STRIDE))


def swapped_back(take: Take, swapped: Flags) -> Take:
    """Return a take with sides swapped back, as from ``swapped_frames`` (T, 2).

    Toes that point at the sensor, as if people faced it, are mirrored in the frontal
    plane, also while only trunk and arms, or only legs, are swapped. Hips and shoulders
    turn evenly where sides change or they show nothing.
    """
    if not swapped.any():
        return steadied(take, [])
    skeleton, (frames, legs) = take.skeleton, swapped.T
    behind = np.repeat(frames[:, None], len(skeleton), axis=1)
    behind[:, skeleton.legs] = legs[:, None]
    mended = with_joints(take, take.swapped(), behind)
    if take.face is not None:  # nobody has one who is seen from behind
        mended = replace(mended, face=np.where(frames[:, None], np.nan, take.face))
    changes = np.flatnonzero(np.diff(frames)) + 1
    positions = steadied(mended, changes.tolist()).positions.copy()
    some = frames | legs
    positions[some] = with_toes_ahead(positions[some], skeleton)
    return replace(mended, positions=positions)


def with_toes_ahead(positions: Array, skeleton: Skeleton) -> Array:
    """Return joints [m] (T, J, 3) with toes that point backward mirrored forward."""
    forward, turned = _direction(find_yaw(positions, skeleton)), positions.copy()
    for foot in skeleton.sides("Foot"):
        toes, ankle = positions[:, foot], positions[:, skeleton.parents[foot]]
        back = np.fmin(np.vecdot(toes - ankle, forward), 0.0)
        turned[:, foot] = toes - 2.0 * back[:, None] * np.nan_to_num(forward)
    return turned


def with_joints(take: Take, other: Take, joints: Flags) -> Take:
    """Return a take with flagged joints, (J,) or (T, J), from another one."""
    positions = np.where(joints[..., None], other.positions, take.positions)
    state = np.where(joints, other.state, take.state)
    return replace(take, positions=positions, state=state)
