"""Reliability from noise, as learned from simulated people, and after Chiang 2017.

Where a Kinect has to guess a joint, the guess changes from frame to frame, and segments
change their lengths. A person's joint is close to a cubic over five frames, however
fast it is; the rest is noise. Noise and length errors give an estimate of the error.

A Kinect's errors also depend on the posture: a raised elbow is always misplaced,
without noise and with correct segment lengths. A logistic regression for each kind of
joint predicts from posture, noise, length errors and lost tracking whether it is far
off. Chiang (section 4.2) combines Shum's segment lengths with a test for errors that
last a single frame.
"""

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Any, Self

import numpy as np
from scipy.special import expit

from kinefilter.characters import STANDARD_HEIGHT, InputError, Skeleton, State, Term
from kinefilter.characters.arrays import Array, Codes
from kinefilter.characters.rotations import cross, unit
from kinefilter.pipeline.formats.npz import read_arrays, write_arrays
from kinefilter.pipeline.pairs import PairedTake
from kinefilter.pipeline.reliability import (
    Reference,
    ReliabilityScorer,
    measure_reference,
)
from kinefilter.retarget import measured_body

FRAME_TIME = 1.0 / 30.0  # s, between frames without time stamps: a Kinect's
SAMPLES = 5  # positions a cubic is subtracted from, one more than it can fit
MEMORY = 0.2
"""Time constant [s] of the means of squared noise and squared length errors: as long as
the window of Shum's reliability. On paired data 0.1 to 1 s do about as well."""
RECOVERY = 0.1  # s, to be reliable once tracked: 0.85 after 0.2 s, as Shum's
MOTION_SHARE = 0.1
"""Part of a person's own motion that a cubic does not explain, relative to the distance
covered per frame. At 30 Hz, nine tenths of marker mocap (CMU: walking, punching, sword
play, dance) are below this between 0.6 and 3 m/s."""
ERROR_PER_NOISE = 7.0
"""Error of a joint relative to its noise along one axis: most of Kinect's errors change
too slowly to be noise. Fitted on six people; 5 to 15 do about as well."""
DOUBTFUL_ERROR = 0.25
"""Estimated error [m] at which reliability falls to 1/e. It is 0.85 at 10 cm and 0.6 at
18 cm; of recorded joints there, three and five in ten vary by over 7 cm."""
LARGEST_ERROR = 2.0 * DOUBTFUL_ERROR  # m, of a frame: a jump is soon forgotten
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


class _EachFrame(ReliabilityScorer):
    """Scores the frames of a take one by one."""

    def _next(self, positions: Array, state: Codes, time: Any = None) -> Any:
        rows = zip(positions, state, time.tolist(), strict=True)
        return map(np.array, zip(*(self.step(*row) for row in rows), strict=True))


class NoiseReliabilityScorer(_EachFrame):
    """Scores frame by frame; a whole take gets the same scores.

    Noise is relative to the root, and the root's own to the room. Reliability is a
    Gaussian of the error that noise and length errors suggest. It is 0 while a joint is
    inferred or not tracked, and recovers gradually. The deciding term is the one that
    lowers the reliability most; Term.BEHAVIOR stands for noise. The geometry of a
    tracked joint ignores noise: it is still closer to the truth than a reconstruction.
    """

    def __init__(self, skeleton: Skeleton, reference: Reference) -> None:
        super().__init__(skeleton, reference)  # without the keywords of Shum's scorer

    def start(self) -> None:
        """Reset the state for a new motion."""
        n = len(self.skeleton)
        self._paths = np.full((SAMPLES, n, 3), np.nan)
        self._stamps = np.full((SAMPLES, n), np.nan)
        self._means = np.zeros(n + len(self.skeleton.segments))  # noise, then lengths
        self._counts = np.zeros_like(self._means)
        self._tracked = np.ones(n)
        self._time: float | None = None

    def step(
        self, positions: Array, state: Codes, time: float | None = None
    ) -> tuple[Array, Codes, Array]:
        """Score the next frame; see ``ReliabilityScorer.step``."""
        elapsed = self._elapsed(time)
        noise, lengths = self._square_errors(positions, elapsed)
        noise = ERROR_PER_NOISE**2 * np.maximum(noise, 0.0)
        lost = (state != State.TRACKED) | np.isnan(positions[:, 0])
        self._tracked += (1.0 - np.exp(-elapsed / RECOVERY)) * (1.0 - self._tracked)
        self._tracked[lost] = 0.0
        reliability = np.exp(-(noise + lengths) / DOUBTFUL_ERROR**2)
        term = np.where(noise > lengths, Term.BEHAVIOR, Term.KINEMATICS)
        term = np.where(self._tracked < reliability, Term.TRACKING_STATE, term)
        geometry = np.where(lost, reliability, np.exp(-lengths / DOUBTFUL_ERROR**2))
        return self._tracked * reliability, term.astype(np.uint8), geometry

    def _elapsed(self, time: float | None) -> float:
        before = self._time
        if time is None:
            time = 0.0 if before is None else before + FRAME_TIME
        self._time = time
        return FRAME_TIME if before is None else time - before

    def _square_errors(self, positions: Array, elapsed: float) -> tuple[Array, Array]:
        """Return mean squares of noise along an axis and length errors [m^2], (J,)."""
        root = self.skeleton.root
        relative = positions - positions[root]
        relative[root] = positions[root]
        seen = ~np.isnan(relative[:, 0])
        self._paths[:-1, seen] = self._paths[1:, seen]
        self._stamps[:-1, seen] = self._stamps[1:, seen]
        self._paths[-1, seen], self._stamps[-1, seen] = relative[seen], self._time
        bones = self.skeleton.bones(positions)
        error = np.sqrt(np.sum(bones * bones, axis=1)) - self._lengths
        square_error = np.minimum(error * error, LARGEST_ERROR**2)
        values = np.concatenate([self._square_noise(), square_error])
        known = ~np.isnan(values)
        self._counts += known
        share = 1.0 - np.exp(-elapsed / MEMORY)
        gain = np.maximum(share, 1.0 / np.maximum(self._counts, 1.0))
        self._means += np.where(known, gain * (values - self._means), 0.0)
        noise, lengths = np.split(self._means, [len(self.skeleton)])
        return noise, self._touch @ lengths

    def _square_noise(self) -> Array:
        """Return this frame's squared noise along one axis [m^2], NaN unknown, (J,).

        The divided difference of five positions, at any times, is 0 for every cubic
        (Newton's interpolation); with weights of norm 1 it is as large as the noise.
        The result can be negative, since the person's own motion is subtracted.
        """
        apart = self._stamps[:, None] - self._stamps
        apart[np.arange(SAMPLES), np.arange(SAMPLES)] = 1.0
        weights = 1.0 / np.prod(apart, axis=1)
        weights /= np.sqrt(np.sum(weights * weights, axis=0))
        rest = np.einsum("kj,kjc->jc", weights, self._paths)
        moved = (self._paths[-1] - self._paths[0]) / (SAMPLES - 1)
        square = np.sum(rest * rest / 3.0 - (MOTION_SHARE * moved) ** 2, axis=1)
        square = np.minimum(square, (LARGEST_ERROR / ERROR_PER_NOISE) ** 2)
        return np.where(self._stamps[-1] == self._time, square, np.nan)


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
            wrong = f"{path}: no reliability weights for {skeleton.name}"
            raise InputError(f"{wrong}; reinstall kinefilter") from None


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


@dataclass(eq=False, repr=False)
class ChiangReliabilityScorer(_EachFrame):
    """Scores frame by frame; a whole take gets the same scores.

    An inferred joint is as reliable as its segments and its motion are plausible; only
    a joint that is not tracked scores 0 for its state. Term.BEHAVIOR stands for the
    temporal term, whose threshold is per frame, at 30 Hz.
    """

    skeleton: Skeleton
    reference: Reference  # the person's segment lengths
    _: KW_ONLY
    largest_displacement: float = 0.03  # T [m]: of joints not in error (eq. 10)
    steepness: float = 4.0  # reliability lost per T beyond T (eq. 10)
    now: float = 0.7  # weight of the current frame, not the one before (eq. 12)

    def __post_init__(self) -> None:
        super().__init__(self.skeleton, self.reference)

    def start(self) -> None:
        """Reset the state for a new motion."""
        super().start()
        self._past: list[Array] = []
        self._previous: Array | None = None

    def step(
        self,
        positions: Array,
        state: Codes,
        time: float | None = None,  # noqa: ARG002 - the terms are for 30 Hz
    ) -> tuple[Array, Codes, Array]:
        """Score the next frame; see ``ReliabilityScorer.step``."""
        temporal = self._temporal(positions)
        kinematics = self._kinematics(positions)  # eq. 6-7
        tracking = np.where(state == State.NOT_TRACKED, 0.0, 1.0)  # eq. 11
        terms = np.stack([temporal, kinematics, tracking])
        term = np.argmin(terms, axis=0).astype(np.uint8)
        scores = np.stack([terms.min(axis=0), np.minimum(temporal, kinematics)])
        before = scores if self._previous is None else self._previous
        self._previous = scores
        mean = self.now * scores + (1.0 - self.now) * before  # eq. 12
        return mean[0], term, mean[1]

    def _temporal(self, positions: Array) -> Array:
        """Return the term for jumps away from both previous frames (eq. 8-10).

        Eq. 10 prints (1 - 4 (d2 - T)) / T, which exceeds 1; here it is 1 - 4 (d2 - T) /
        T, at least 0; 1 where a position is missing, and in the first two frames.
        """
        term = np.ones(len(positions))
        if len(self._past) == 2:
            d1, d2 = np.sqrt(np.sum((positions - np.array(self._past)) ** 2, axis=2))
            largest = self.largest_displacement
            moved = (d1 > largest) & (d2 > largest)
            excess = (d2[moved] - largest) / max(largest, 1e-9)
            term[moved] = np.maximum(1.0 - self.steepness * excess, 0.0)
        self._past = [*self._past[-1:], positions.copy()]
        return term
