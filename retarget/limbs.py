"""Moves of limbs: bent to a goal, hands moved elsewhere, planted feet held in place."""

import numpy as np
from numpy.typing import ArrayLike

from kinefilter.characters import Body
from kinefilter.characters.arrays import Array, Flags, runs
from kinefilter.characters.rotations import between, multiply, rotate, unit

_BLEND = 0.15  # s in which a foot goes from its path to its stance, and back. A guess.
_TINY = 1e-12


def smooth_step(share: ArrayLike) -> Array:
    """Return the cubic that rises from 0 at 0 to 1 at 1, constant beyond."""
    inside = np.clip(np.asarray(share), 0.0, 1.0)
    return np.asarray(inside**2 * (3.0 - 2.0 * inside))


def near_stance(time: Array, planted: Flags) -> Array:
    """Return 1 (T,) in frames with contact, falling to 0 in 0.15 s before and after."""
    return np.asarray(np.maximum(*_nearness(time, planted)))


def _nearness(time: Array, planted: Flags) -> tuple[Array, Array]:
    """Return ``near_stance`` for the last contact alone and for the next alone."""
    last = np.maximum.accumulate(np.where(planted, time, -np.inf))
    following = np.minimum.accumulate(np.where(planted, time, np.inf)[::-1])[::-1]
    ended, begins = (time - last) / _BLEND, (following - time) / _BLEND
    return 1.0 - smooth_step(ended), 1.0 - smooth_step(begins)


def holding_moves(
    time: Array, path: Array, planted: Flags, height: float, slack: float
) -> Array:
    """Return the move [m] (T, 3) that keeps a heel or toes in place while planted.

    Steps change only where they begin and end. The path (T, 3) [m] has y up and the
    floor at 0. While planted, the part is at ``height`` [m] and may be ``slack`` [m]
    away from its path. Beyond that it is dragged along, because a body that drifts away
    would otherwise pull its leg straight.
    """
    moves, frames = np.zeros((len(time), 3)), np.arange(len(time))
    for stance in runs(planted):
        steps = -np.diff(path[stance][:, [0, 2]], axis=0)
        moves[stance, 0], moves[stance, 2] = _dragged(steps, slack).T
        moves[stance, 1] = height - path[stance, 1]
    ended, begins = _nearness(time, planted)
    # The nearer stance has the larger weight, and all of it next to itself.
    old, new = ended * (1.0 - begins), begins * (1.0 - ended)
    some = (ended + begins - ended * begins) / np.maximum(old + new, _TINY)
    last = np.maximum.accumulate(np.where(planted, frames, 0))
    following = np.minimum.accumulate(np.where(planted, frames, frames[-1])[::-1])[::-1]
    between = (some * old)[:, None] * moves[last]
    between += (some * new)[:, None] * moves[following]
    return np.where(planted[:, None], moves, between)


def _dragged(steps: Array, slack: float) -> Array:
    """Return sums (T, 2) of steps (T - 1, 2) [m], centered and kept within slack."""
    moves = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    moves[0] = _shortened(-0.5 * (moves.max(axis=0) + moves.min(axis=0)), slack)
    for k, step in enumerate(steps):
        moves[k + 1] = _shortened(moves[k] + step, slack)
    return moves


def _shortened(move: Array, most: float) -> Array:
    return np.asarray(move * (most / max(float(np.hypot(*move)), most)))


_SHORT = 1e-9  # m
_STRETCHED = 0.97  # of an arm's length: beyond, the trunk moves. A guess.
_FARTHEST = 0.5  # m by which the shoulders move at most. A guess.
_DEEPEST = 0.2  # m of it by which the hips move at most. A guess.
_ROUNDS = 4  # until both arms reach


def bent_limb(
    start: Array,
    goal: Array,
    toward: Array,
    lengths: ArrayLike,
    reach: tuple[float, float] | None = None,
) -> tuple[Array, Array]:
    """Return the middle joint and the end [m] of a limb of two bones in closed form.

    The law of cosines gives the middle's place along the line to the goal and beside
    it. If the goal is beyond the limb's reach (by default, that of its bones), the end
    stops on the way to it. ``toward`` is the direction in which the middle bends, of
    any length but not along the limb. Points are (..., 3), lengths and reach [m] (2,).
    """
    first, second = np.asarray(lengths, dtype=float)
    least, most = reach or (max(abs(first - second), _SHORT), first + second)
    line = goal - start
    distance = np.linalg.norm(line, axis=-1, keepdims=True)
    ahead = line / np.maximum(distance, _SHORT)
    reached = np.clip(distance, least, most)
    along = (first**2 - second**2 + reached**2) / (2.0 * reached)
    beside = np.sqrt(np.maximum(first**2 - along**2, 0.0))
    across = unit(toward - np.sum(toward * ahead, axis=-1, keepdims=True) * ahead)
    return start + along * ahead + beside * across, start + reached * ahead


def shortage(leg: Array, reach: ArrayLike, most: float = np.inf) -> Array:
    """Return how far hips are too high above ankles [m], at most ``most``, shape (...).

    ``leg`` (..., 3) is from ankle to hip [m], y up; a straight one is ``reach`` long.
    """
    level = np.sum(leg[..., [0, 2]] ** 2, axis=-1)
    height = np.sqrt(np.maximum(np.square(reach) - level, 0.0))
    return np.asarray(np.clip(leg[..., 1] - height, 0.0, most))


def rejection(bone: Array, line: Array) -> Array:
    """Return the part of vectors (..., 3) that is perpendicular to lines (..., 3)."""
    share = np.sum(bone * line, axis=-1) / np.maximum(np.sum(line**2, axis=-1), 1e-12)
    return np.asarray(bone - share[..., None] * line)


class Reach:
    """Moves the hands of postures of one body."""

    def __init__(self, body: Body) -> None:
        skeleton = self._skeleton = body.skeleton
        arms = [skeleton.sides(part) for part in ("Shoulder", "Elbow", "Wrist")]
        legs = [skeleton.sides(part) for part in ("Hip", "Knee", "Ankle")]
        self._arms, self._legs = np.transpose(arms), np.transpose(legs)
        self._beyond = [[j, *skeleton.descendants(j)] for j in self._arms[:, 2]]
        self.upper = np.setdiff1d(np.arange(len(skeleton)), skeleton.legs)
        self._trunk = np.setdiff1d(self.upper, [skeleton.root, *skeleton.hips])

    def __call__(
        self, positions: Array, rotations: Array, moves: Array
    ) -> tuple[Array, Array]:
        """Return positions (J, 3) and rotations, wxyz, (J, 4) with the hands moved.

        ``moves`` are those of the left and the right hand [m], shape (2, 3). Where the
        arms are too short, the trunk bends, and then the knees; the feet stay.
        """
        moved = positions.copy()
        wrists = positions[self._arms[:, 2]] + moves
        self._bow(moved, self._lean(positions, wrists))
        self._sink(moved, positions)
        for arm, hand, wrist in zip(self._arms, self._beyond, wrists, strict=True):
            _bend(moved, positions, arm, wrist)
            moved[hand] = positions[hand] + moved[arm[2]] - positions[arm[2]]
        return moved, self._turned(moved, positions, rotations)

    def _sink(self, moved: Array, positions: Array) -> None:
        """Bend the legs, and lower the hips where the feet could not stay."""
        bones = np.linalg.norm(np.diff(positions[self._legs], axis=1), axis=-1)
        legs = moved[self._legs[:, 0]] - positions[self._legs[:, 2]]
        moved[self.upper, 1] -= shortage(legs, bones.sum(axis=-1)).max()
        for leg in self._legs:
            _bend(moved, positions, leg, positions[leg[2]])

    def _turned(self, moved: Array, positions: Array, rotations: Array) -> Array:
        turned = rotations.copy()
        ends, starts = self._skeleton.segments, self._skeleton.segment_parents
        before, after = (p[ends] - p[starts] for p in (positions, moved))
        turned[ends] = multiply(between(before, after), rotations[ends])
        return turned

    def shifted(
        self, positions: Array, rotations: Array, shift: Array
    ) -> tuple[Array, Array]:
        """Return the same with the body shifted [m], (3,), but for the feet."""
        moved = positions.copy()
        moved[self.upper] += shift
        self._sink(moved, positions)
        return moved, self._turned(moved, positions, rotations)

    def _bow(self, moved: Array, lean: Array) -> None:
        """Move the shoulders: the trunk turns about the hips, which do the rest."""
        root = moved[self._skeleton.root].copy()
        spine = moved[self._arms[:, 0]].mean(axis=0) - root
        turn = between(spine, spine + lean)
        moved[self._trunk] = root + rotate(turn, moved[self._trunk] - root)
        moved[self.upper] += at_most(_DEEPEST, spine + lean - rotate(turn, spine))

    def _lean(self, positions: Array, wrists: Array) -> Array:
        """Return the move of the shoulders [m] that lets the arms reach, (3,)."""
        lean, shoulders = np.zeros(3), positions[self._arms[:, 0]]
        bones = np.diff(positions[self._arms], axis=1)
        longest = _STRETCHED * np.linalg.norm(bones, axis=-1).sum(axis=-1)
        for _ in range(_ROUNDS):
            lines = wrists - shoulders - lean
            far = np.maximum(np.linalg.norm(lines, axis=-1), 1e-9)
            share = np.maximum(1.0 - longest / far, 0.0)
            lean += (share[:, None] * lines).mean(axis=0)
        return at_most(_FARTHEST, lean)


def at_most(most: float, vector: Array) -> Array:
    """Return a vector, shortened if it is longer than ``most``."""
    return np.asarray(vector * (most / max(float(np.linalg.norm(vector)), most)))


def _bend(moved: Array, positions: Array, limb: Array, goal: Array) -> None:
    """Put the end of a limb at its goal; its middle bends as before."""
    start, middle, end = positions[limb]
    lengths = np.linalg.norm([middle - start, end - middle], axis=-1)
    toward = middle - 0.5 * (start + end)
    moved[limb[1]], moved[limb[2]] = bent_limb(moved[limb[0]], goal, toward, lengths)
