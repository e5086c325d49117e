"""How far each joint of each frame can be trusted, as learned on simulated people.

Where in the body a Kinect puts a joint depends on the posture: a raised elbow is seen
elsewhere than a hanging one, and always so, without any trembling and with segments
that keep their lengths. What postures, noise, wrong lengths and lost tracking go with
joints that are far off, a logistic regression for each kind of joint tells.
"""

from __future__ import annotations

from functools import lru_cache
from importlib import resources

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from kinefilter.characters import STANDARD_HEIGHT, Skeleton, State, Term
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.reliability import Reference
from kinefilter.retarget import measured_body

from .doubt import DoubtWeights
from .noise import MEMORY, NoiseReliabilityScorer

_LEAST = np.array([[1e-4], [0.05], [3e-3]])
"""Added before the logarithm to noise [m], speed [m/s] and length errors [m]: below,
differences mean nothing. Guesses."""
_DIRECTIONS = 9  # numbers that say where a joint is, and its segments' directions
_FIRST, _SECOND = np.triu_indices(_DIRECTIONS)

TERMS = np.array(
    [
        Term.BEHAVIOR,  # noise
        Term.BEHAVIOR,  # speed
        Term.KINEMATICS,  # wrong lengths
        Term.TRACKING_STATE,  # share of the last frames in which it was not tracked
        *[Term.POSTURE] * (_DIRECTIONS + len(_FIRST)),
    ]
)
"""The reliability term to which each clue belongs, shape (C,)."""
_STARTS = np.flatnonzero(np.diff(TERMS, prepend=-1))  # of each term's clues
_STATE = int(_STARTS[Term.TRACKING_STATE])


class LearnedReliabilityScorer(NoiseReliabilityScorer):
    """Scores one frame after the other; a whole take goes the same way.

    The rate is the probability that a joint is less than 10 cm off, its constant
    misplacement included. It does not know in which direction: a posture of which the
    sensor has a wrong idea lowers the rate for as long as it lasts. A joint that is
    missing has none. The deciding term is that whose clues speak most against the
    joint; Term.BEHAVIOR stands for noise and speed.

    The rate of the geometry is that of a joint that was tracked all the time.

    Args:
        skeleton: The joints.
        reference: The person's segment lengths.
        weights: What the clues mean; by default those of the embedded file.
    """

    def __init__(
        self,
        skeleton: Skeleton,
        reference: Reference,
        weights: DoubtWeights | None = None,
    ) -> None:
        body = measured_body(skeleton, reference.lengths, reference.directions)
        self._scale = STANDARD_HEIGHT / body.height
        self._rest = body.rest_positions - body.rest_positions[skeleton.root]
        self._doubt = weights or _embedded_weights(skeleton)
        own = np.arange(len(skeleton))
        before = np.maximum(skeleton.parents, 0)
        after = [next(iter(skeleton.children[j]), j) for j in own]
        self._ends, self._starts = np.array([own, after]), np.array([before, own])
        right = [joint.endswith("Right") for joint in skeleton.joints]
        self._mirrored = np.ones((len(skeleton), 3))
        self._mirrored[right, 0] = -1.0  # left and right share their weights
        super().__init__(skeleton, reference)

    def start(self) -> None:
        """Forget all frames."""
        super().start()
        self._root = np.zeros(3)
        self._posture = self._rest
        self._relative: Array | None = None
        self._speed = np.zeros(len(self.skeleton))
        self._lost = np.zeros(len(self.skeleton))

    def step(
        self,
        positions: Array,
        state: NDArray[np.uint8],
        time: float | None = None,
    ) -> tuple[Array, NDArray[np.uint8], Array]:
        """Score the next frame; see ``ReliabilityScorer.step``."""
        told = self._doubt
        parts = (self.clues(positions, state, time) - told.usual) * told.weights
        doubt = np.add.reduceat(parts, _STARTS, axis=1)
        total = doubt.sum(axis=1) + told.intercepts
        unseen = told.weights[:, _STATE] * self._lost
        rate, geometry = expit([-total, unseen - total])
        term = doubt.argmax(axis=1).astype(np.uint8)
        missing = np.isnan(positions[:, 0])
        if missing.any():
            rate[missing] = geometry[missing] = 0.0
            term[missing] = Term.TRACKING_STATE
        return rate, term, geometry

    def clues(
        self, positions: Array, state: NDArray[np.uint8], time: float | None = None
    ) -> Array:
        """Return what speaks for or against each joint of the next frame, (J, C).

        Arguments are those of ``step``. Logarithms of noise, speed and length errors,
        the share of lost frames, then the posture around the joint and its products.
        """
        elapsed = self._elapsed(time)
        share = 1.0 - np.exp(-elapsed / MEMORY)
        noise, lengths = self._square_errors(positions, share)
        missing = np.isnan(positions)
        lost = (state != State.TRACKED) | missing[:, 0]
        self._lost += (1.0 if self._relative is None else share) * (lost - self._lost)
        if not missing[self.skeleton.root, 0]:
            self._root = positions[self.skeleton.root].copy()
        self._posture = np.where(missing, self._posture, positions - self._root)
        left, right = self.skeleton.hips
        relative = self._posture - 0.5 * (self._posture[left] + self._posture[right])
        if self._relative is not None:
            away = relative - self._relative
            way = np.sqrt(np.einsum("jc,jc->j", away, away))
            self._speed += share * (way / max(elapsed, 1e-3) - self._speed)
        self._relative = relative
        errors = np.sqrt(np.maximum([noise, self._speed**2, lengths], 0.0))
        around = self._around(relative)
        return np.concatenate(
            [
                np.log(errors + _LEAST).T,
                self._lost[:, None],
                around,
                around.take(_FIRST, axis=1) * around.take(_SECOND, axis=1),
            ],
            axis=1,
        )

    def _around(self, posture: Array) -> Array:
        """Return where a joint and its two segments are, in the trunk's frame, (J, 9).

        Positions [m] from the hips' middle, of a person of standard stature; directions
        of the segment that ends at the joint and of the first that starts there. Of
        joints on the right the mirror image.
        """
        left, right = self.skeleton.hips
        across = posture[left] - posture[right]
        spine = posture[self.skeleton.girdle] - posture[self.skeleton.root]
        ahead = _cross(across, spine)
        frame = _unit(np.array([across, _cross(ahead, across), ahead]))
        parts = np.empty((3, *posture.shape))
        parts[0] = self._scale * posture
        parts[1:] = _unit(posture[self._ends] - posture[self._starts])
        turned = (parts @ frame.T) * self._mirrored
        return turned.transpose(1, 0, 2).reshape(len(posture), _DIRECTIONS)


@lru_cache(maxsize=4)
def _embedded_weights(skeleton: Skeleton) -> DoubtWeights:
    """Return what was learned on simulated people for a skeleton."""
    folder = resources.files("kinefilter.pipeline.lab").joinpath("embedded")
    with resources.as_file(folder / f"{skeleton.name}_doubt.npz") as path:
        return DoubtWeights.load(path, skeleton)


def _cross(a: Array, b: Array) -> Array:
    """Return the cross product of two vectors; numpy's takes as long as all else."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def _unit(vectors: Array) -> Array:
    norms = np.sqrt(np.einsum("...c,...c->...", vectors, vectors))
    return np.asarray(vectors / np.maximum(norms, 1e-6)[..., None])
