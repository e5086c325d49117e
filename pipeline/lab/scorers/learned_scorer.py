"""Reliability learned from simulated people.

A Kinect's errors depend on the posture: a raised elbow is always misplaced, without
noise and with correct segment lengths. A logistic regression for each kind of joint
predicts from posture, noise, length errors and lost tracking whether it is far off.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Self

import numpy as np
from scipy.special import expit

from kinefilter.characters import STANDARD_HEIGHT, InputError, Skeleton, State, Term
from kinefilter.characters.arrays import Array, Codes
from kinefilter.characters.rotations import cross, unit
from kinefilter.pipeline.formats.npz import read_arrays, write_arrays
from kinefilter.pipeline.pairs import PairedTake
from kinefilter.pipeline.reliability import Reference, measure_reference
from kinefilter.retarget import measured_body

from .noise_scorer import MEMORY, NoiseReliabilityScorer

FAR_OFF = 0.10  # m relative to the hips above which a joint is far off
_EVERY = 4  # every fourth frame is used in training; those between add little
_PENALTY = 1.0  # inverse strength of the penalty on large weights
_LEAST = np.array([[1e-4], [0.05], [3e-3]])
"""Added to noise [m], speed [m/s] and length errors [m] before the logarithm, since
differences below these values mean nothing. Guesses."""
_DIRECTIONS = 9  # numbers for a joint's position and its segments' directions
_FIRST, _SECOND = np.triu_indices(_DIRECTIONS)

TERMS = np.array(
    [Term.BEHAVIOR, Term.BEHAVIOR, Term.KINEMATICS, Term.TRACKING_STATE]
    + [Term.POSTURE] * (_DIRECTIONS + len(_FIRST))
)
"""The reliability term that each clue belongs to, shape (C,). The clues are noise,
speed, length errors, the share of recent frames in which the joint was not tracked, and
posture."""
_STARTS = np.flatnonzero(np.diff(TERMS, prepend=-1))  # first clue of each term
_STATE = int(_STARTS[Term.TRACKING_STATE])
_ARRAYS = ("usual", "weights", "intercepts")


@dataclass(frozen=True, eq=False)
class ClueWeights:
    """Weights of the log odds that a joint is far off, a sum over clues."""

    skeleton: Skeleton  # the joints, in the order of the arrays
    usual: Array  # mean of each clue in training, shape (J, C)
    weights: Array  # log odds per unit of difference from that mean, shape (J, C)
    intercepts: Array  # log odds with every clue at its mean, shape (J,)

    @classmethod
    def even_odds(cls, skeleton: Skeleton) -> Self:
        """Return untrained weights, which give every joint even odds."""
        zeros = np.zeros((len(skeleton), len(TERMS)))
        return cls(skeleton, zeros, zeros.copy(), zeros[:, 0].copy())

    def save(self, path: Path) -> None:
        """Write the weights as npz, with one row for each kind of joint."""
        kinds, first = np.unique(self.skeleton.kinds, return_index=True)
        arrays = {key: getattr(self, key)[first].astype(np.float32) for key in _ARRAYS}
        write_arrays(path, {"kinds": kinds, **arrays})

    @classmethod
    def load(cls, path: Path, skeleton: Skeleton) -> Self:
        """Read weights that ``save`` wrote; raises an InputError for other files."""
        try:
            file = read_arrays(path)
            kinds = file["kinds"].tolist()
            rows = [kinds.index(kind) for kind in skeleton.kinds]
            return cls(skeleton, *(file[key][rows].astype(float) for key in _ARRAYS))
        except (InputError, KeyError, ValueError, TypeError, IndexError):
            raise InputError(
                f"{path}: no reliability weights for {skeleton.name}; reinstall "
                "kinefilter"
            ) from None


class LearnedReliabilityScorer(NoiseReliabilityScorer):
    """Scores frame by frame; a whole take gets the same scores.

    Reliability is the probability that a joint is less than 10 cm off, its constant
    offset included; 0 for a missing joint. The deciding term is the one whose clues
    raise the odds of an error most; Term.BEHAVIOR stands for noise and speed. The
    geometry is the reliability that the joint would have if it were always tracked.
    """

    def __init__(
        self, skeleton: Skeleton, reference: Reference, given: ClueWeights | None = None
    ) -> None:
        body = measured_body(skeleton, reference.lengths, reference.directions)
        self._scale = STANDARD_HEIGHT / body.height
        self._rest = body.rest_positions - body.rest_positions[skeleton.root]
        self._learned = given or _embedded_weights(skeleton)
        own = np.arange(len(skeleton))
        before = np.maximum(skeleton.parents, 0)
        after = [next(iter(skeleton.children[j]), j) for j in own]
        self._ends, self._starts = np.array([own, after]), np.array([before, own])
        right = [joint.endswith("Right") for joint in skeleton.joints]
        self._signs = np.ones((len(skeleton), 3))
        self._signs[right, 0] = -1.0  # left and right share their weights
        super().__init__(skeleton, reference)

    def start(self) -> None:
        """Reset the state for a new motion."""
        super().start()
        self._root = np.zeros(3)
        self._posture = self._rest
        self._relative: Array | None = None
        self._speed = np.zeros(len(self.skeleton))
        self._lost = np.zeros(len(self.skeleton))

    def step(
        self, positions: Array, state: Codes, time: float | None = None
    ) -> tuple[Array, Codes, Array]:
        """Score the next frame; see ``ReliabilityScorer.step``."""
        learned = self._learned
        parts = (self.clues(positions, state, time) - learned.usual) * learned.weights
        odds = np.add.reduceat(parts, _STARTS, axis=1)
        total = odds.sum(axis=1) + learned.intercepts
        by_state = learned.weights[:, _STATE] * self._lost
        reliability, geometry = expit([-total, by_state - total])
        term = odds.argmax(axis=1).astype(np.uint8)
        missing = np.isnan(positions[:, 0])
        reliability[missing] = geometry[missing] = 0.0
        term[missing] = Term.TRACKING_STATE
        return reliability, term, geometry

    def clues(self, positions: Array, state: Codes, time: float | None = None) -> Array:
        """Return the clues for each joint of the next frame, shape (J, C).

        These are the logarithms of noise, speed and length errors, the share of frames
        not tracked, then the posture around the joint and its products.
        """
        elapsed = self._elapsed(time)
        share = 1.0 - np.exp(-elapsed / MEMORY)
        noise, lengths = self._square_errors(positions, elapsed)
        missing = np.isnan(positions)
        lost = (state != State.TRACKED) | missing[:, 0]
        self._lost += (1.0 if self._relative is None else share) * (lost - self._lost)
        if not missing[self.skeleton.root, 0]:
            self._root = positions[self.skeleton.root].copy()
        self._posture = np.where(missing, self._posture, positions - self._root)
        left, right = self.skeleton.hips
        relative = self._posture - 0.5 * (self._posture[left] + self._posture[right])
        if self._relative is not None:
            moved = relative - self._relative
            distance = np.sqrt(np.einsum("jc,jc->j", moved, moved))
            self._speed += share * (distance / max(elapsed, 1e-3) - self._speed)
        self._relative = relative
        errors = np.sqrt(np.maximum([noise, self._speed**2, lengths], 0.0))
        posture = self._around(relative)
        products = posture.take(_FIRST, axis=1) * posture.take(_SECOND, axis=1)
        logarithms = np.log(errors + _LEAST).T
        return np.hstack([logarithms, self._lost[:, None], posture, products])

    def _around(self, posture: Array) -> Array:
        """Return joints' positions and segment directions in the trunk frame, (J, 9).

        The position [m] is relative to the hips' midpoint, at standard height; the
        segments are the one that ends at the joint and the first that starts there.
        Joints on the right are mirrored.
        """
        left, right = self.skeleton.hips
        across = posture[left] - posture[right]
        spine = posture[self.skeleton.girdle] - posture[self.skeleton.root]
        ahead = cross(across, spine)
        frame = unit(np.array([across, cross(ahead, across), ahead]))
        directions = unit(posture[self._ends] - posture[self._starts])
        parts = np.concatenate([self._scale * posture[None], directions])
        turned = (parts @ frame.T) * self._signs
        return turned.transpose(1, 0, 2).reshape(len(posture), _DIRECTIONS)


@lru_cache(maxsize=4)
def _embedded_weights(skeleton: Skeleton) -> ClueWeights:
    folder = resources.files("kinefilter.pipeline.lab").joinpath("embedded")
    with resources.as_file(folder / f"{skeleton.name}_doubt.npz") as path:
        return ClueWeights.load(path, skeleton)


def learned_weights(pairs: Sequence[PairedTake]) -> ClueWeights:
    """Return weights trained on pairs of one skeleton."""
    from sklearn.linear_model import LogisticRegression

    clues, far = map(np.concatenate, zip(*map(_clues_and_errors, pairs), strict=True))
    learned = ClueWeights.even_odds(pairs[0].take.skeleton)
    kinds = np.array(learned.skeleton.kinds)
    for kind in dict.fromkeys(kinds):
        joints = np.flatnonzero(kinds == kind)
        known = ~np.isnan(far[:, joints])
        inputs, wrong = clues[:, joints][known], far[:, joints][known]
        # Laplace's rule: even odds without any data.
        odds = (wrong.sum() + 1.0) / ((1.0 - wrong).sum() + 1.0)
        learned.intercepts[joints] = np.log(odds)
        if not 0.0 < wrong.sum() < len(wrong):
            continue
        mean, spread = inputs.mean(axis=0), inputs.std(axis=0)
        spread = np.where(spread > 1e-6, spread, np.inf)
        model = LogisticRegression(C=_PENALTY, max_iter=500)
        model.fit((inputs - mean) / spread, wrong)
        learned.usual[joints], learned.weights[joints] = mean, model.coef_[0] / spread
        learned.intercepts[joints] = model.intercept_[0]
    return learned


def _clues_and_errors(pair: PairedTake) -> tuple[Array, Array]:
    """Return clues (T, J, C), and 1 for joints far off, NaN if unknown, (T, J)."""
    take, skeleton = pair.take, pair.take.skeleton
    untrained = ClueWeights.even_odds(skeleton)
    scorer = LearnedReliabilityScorer(skeleton, measure_reference(take), untrained)
    frames = zip(take.positions, take.state, take.time, strict=True)
    clues = [scorer.clues(p, state, float(time)) for p, state, time in frames]
    errors = take.positions - pair.truth
    errors = errors - errors[:, skeleton.hips].mean(axis=1, keepdims=True)
    distance = np.linalg.norm(errors, axis=2)
    far = np.where(np.isnan(distance), np.nan, distance > FAR_OFF)
    return np.array(clues[::_EVERY]), far[::_EVERY]
