"""The stages that orient the segments: limbs, then head and hands.

Relative to the segments they hang on, limbs and hands turn slowly and little. So they
are smoothed there, and more strongly than joints are in the room.
"""

from abc import abstractmethod
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, ClassVar

import numpy as np

from kinefilter.characters import Body
from kinefilter.characters.arrays import Array, chunks
from kinefilter.characters.gaps import parts_of
from kinefilter.characters.rotations import continuous, inverse, rotate, slerp
from kinefilter.pipeline.draft import Draft
from kinefilter.pipeline.progress import Progress
from kinefilter.pipeline.stages import CHUNK, Stage
from kinefilter.retarget import Hinges, Neck, Palms

from .planting import PLANTED
from .smooth import smooth
from .target_stages import posed

_LEAST_WEIGHT = 0.05  # of an unreliable joint; a reliable one has 1
_BENDS, _LIVE_BENDS = 1.5, 3.0  # Hz: cutoffs of how limbs bend, in whole takes and live
_STANCES = 3.0  # Hz: cutoff of whether a foot stands
_Filter = Callable[[Array, Array], tuple[Array, Array]]
"""Smooths values (..., K, C) by their weights (..., K); returns both smoothed."""


class Orient(Stage):
    """Stage that gives every segment an orientation: elbows and knees are hinges."""

    name = "orientation"
    local = True
    in_parts = False  # rotations keep their sign across gaps

    def start(self, body: Body) -> None:
        """Reset the state for a new motion."""
        self._hinges = Hinges(body)
        self._bends, self._stands = _Mean(_LIVE_BENDS), _Mean(_STANCES)

    def step(self, draft: Draft) -> None:
        """Orient the segments of the next frame."""
        joints, elapsed = draft.positions, draft.elapsed
        turns = self._hinges.untwisted(joints)
        bends = self._hinges.bends(joints, turns)
        bends, _ = self._bends(elapsed, bends, np.ones(len(bends)))
        stands = draft.stands[:, None].astype(float)
        level, _ = self._stands(elapsed, stands, np.ones(2))
        draft.rotations = self._hinges.twisted(joints, turns, bends, level[:, 0])

    def whole(self, draft: Draft, progress: Progress) -> None:
        """Orient the segments of a take, continuously over time."""
        joints, hinges, time = draft.positions, Hinges(draft.body), draft.time
        rows, turns = chunks(len(joints), CHUNK), np.empty((*joints.shape[:2], 4))
        for k in rows:
            turns[k] = hinges.untwisted(joints[k])
        bends = np.concatenate([hinges.bends(joints[k], turns[k]) for k in rows])
        bends, _ = _smoothed(time, _BENDS, bends, np.ones(bends.shape[:2]))
        stands = draft.stands[..., None].astype(float)
        level = _smoothed(time, _STANCES, stands, np.ones(stands.shape[:2]))[0][..., 0]
        for k in rows:
            turns[k] = hinges.twisted(joints[k], turns[k], bends[k], level[k])
        draft.rotations = continuous(turns)
        draft.posed = posed(draft)


class _Aim(Stage):
    """Stage that turns chains of short bones relative to the segments before them."""

    local = True
    in_parts = False  # rotations keep their sign across gaps
    cutoffs: ClassVar[tuple[float, ...]]  # of each of the filters [Hz]
    chains: ClassVar[type[Neck | Palms]]  # what to aim

    def start(self, body: Body) -> None:
        """Reset the state for a new motion."""
        self._chains = self.chains(body)
        self._means = [_Mean(cutoff) for cutoff in self.cutoffs]

    def step(self, draft: Draft) -> None:
        """Aim in the next frame."""
        filters = [partial(mean, draft.elapsed) for mean in self._means]
        self._aim_unpinned(draft, self._chains, filters)

    def whole(self, draft: Draft, progress: Progress) -> None:
        """Aim in a take."""
        filters = [partial(_smoothed, draft.time, cutoff) for cutoff in self.cutoffs]
        self._aim_unpinned(draft, self.chains(draft.body), filters)
        draft.rotations = continuous(draft.rotations)
        draft.posed = posed(draft)

    def _aim_unpinned(
        self, draft: Draft, chains: Neck | Palms, filters: Sequence[_Filter]
    ) -> None:
        """Aim, but leave what was pinned by hand where it is."""
        before, turns = draft.positions, draft.rotations
        self._aim(draft, chains, filters)
        firm = draft.bone_weights[..., chains.joints].max(axis=-2) - 1.0
        for k, start in enumerate(chains.starts.tolist() if firm.max() > 0.0 else ()):
            share = (firm[..., k, None] / (PLANTED - 1.0)).clip(0.0, 1.0)
            moved = np.s_[..., [start, *draft.skeleton.descendants(start)], :]
            here, there = draft.positions[moved], before[moved]
            draft.positions[moved] = here + share[..., None] * (there - here)
            draft.rotations[moved] = slerp(draft.rotations[moved], turns[moved], share)

    @staticmethod
    @abstractmethod
    def _aim(draft: Draft, chains: Any, filters: Sequence[_Filter]) -> None:
        """Replace the positions and rotations of a frame or a take."""


class AimHead(_Aim):
    """Stage that bends the head by all joints above the shoulders.

    People keep their heads steady in the room, not on their chests, so the head is
    smoothed there. It turns with the face, if the sensor sees that.
    """

    name = "head"
    cutoffs, chains = (2.0, 1.2), Neck

    @staticmethod
    def _aim(draft: Draft, chains: Neck, filters: Sequence[_Filter]) -> None:
        joints, (aim, look) = (draft.positions, draft.rotations), filters
        chest = joints[1].take(chains.starts, -2)
        ways, weights = chains.aims(*joints, _weights(draft))
        ways, weights = aim(rotate(chest, ways), weights)
        head = chains.straightened(rotate(inverse(chest), ways), weights)
        turn = None
        if draft.face is not None:
            seen = np.isfinite(draft.face).all(axis=-1, keepdims=True)
            faces = chains.faces(np.where(seen, draft.face, 0.0), joints[1], head)
            turn = chains.turn(*look(faces, np.where(seen, 1.0, _LEAST_WEIGHT)))
        draft.positions, draft.rotations = chains.posed(*joints, head, turn)


class AimHands(_Aim):
    """Stage that turns hands by all of their joints, and forearms by the thumbs."""

    name = "hands"
    cutoffs, chains = (1.2, 1.0), Palms

    @staticmethod
    def _aim(draft: Draft, chains: Palms, filters: Sequence[_Filter]) -> None:
        joints, (aim, turn) = (draft.positions, draft.rotations), filters
        weights = _weights(draft)
        hands = chains.straightened(*aim(*chains.aims(*joints, weights)))
        twist = np.zeros(hands.shape[:-1])
        if chains.has_thumbs:
            twist = chains.twist(*turn(*chains.thumbs(*joints, weights, hands)))
        draft.positions, draft.rotations = chains.posed(*joints, hands, twist)


def _weights(draft: Draft) -> Array:
    """Return how much each joint counts, shape (..., J)."""
    return np.maximum(draft.reliability, _LEAST_WEIGHT)


class _Mean:
    """A running mean of values by their weights, frame by frame."""

    def __init__(self, cutoff: float) -> None:
        self._rate = 2.0 * np.pi * cutoff  # 1/s
        self._mean: tuple[Array, Array] | None = None

    def __call__(
        self, elapsed: float, values: Array, weights: Array
    ) -> tuple[Array, Array]:
        """Return the means of values and weights ``elapsed`` [s] after the last."""
        latest = weights[..., None] * values, weights
        share = 1.0 - np.exp(-self._rate * elapsed)
        ends = zip(self._mean or latest, latest, strict=True)
        self._mean = pull, weight = tuple(a + share * (b - a) for a, b in ends)
        return pull / weight[..., None], weight


def _smoothed(
    time: Array, cutoff: float, values: Array, weights: Array
) -> tuple[Array, Array]:
    """Return values and weights of a take smoothed without lag, by its parts."""
    found, level = np.empty_like(values), np.empty_like(weights)
    for k in parts_of(time):
        found[k] = smooth(time[k], values[k], weights[k], cutoff=cutoff)
        even = np.ones_like(weights[k])
        mean = smooth(time[k], weights[k][..., None], even, cutoff=cutoff)
        level[k] = np.maximum(mean[..., 0], _LEAST_WEIGHT)
    return found, level
