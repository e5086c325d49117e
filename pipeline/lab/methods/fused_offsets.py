"""Predicted offsets, fused with steady movement and with the measurement.

Zhou, Liu, Leung & Shum 2014 and Liu, Zhou, Leung & Shum 2016, eq. 22: the energy that
both papers put around the predictions of their Gaussian processes.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar, Literal

import numpy as np

from kinefilter.characters import InputError
from kinefilter.characters.arrays import Array, Flags
from kinefilter.pipeline.correct import Correction, Observation
from kinefilter.pipeline.correct.hold import RELIABLE

from .training_data import OffsetCorrector, TrainingSet

Likelihood = Literal["relative", "density"]
_LARGEST = 100_000  # frames used to measure the variances of movement and error
_LEAST = 1e-8  # m^2: a tenth of a millimeter, which is invisible
_RELIABLE = 0.9  # reliability from which a joint's error counts as a reliable joint's
_DOUBTED = 0.7
"""Reliability up to which a joint's measured position is ignored: Chiang's minimum for
training data, and Shum's reliability in the first frame in which the sensor guesses. At
0.3 a limb would be held where the first guesses jump to."""


def least_energy(
    mean: Array,
    certainty: Array,
    steady: Array,
    reliabilities: Array,
    *,
    spatial: float,
    temporal: Any,
    reliability: Any,
) -> Array:
    """Return the offsets of least energy (Liu eq. 22), in closed form.

    The paper minimizes the spatial term as a log density (eq. 7); here it is the
    negative of that, times twice the prior variance: certainty * |y - mean|^2, a
    squared distance like the other terms (eq. 20, 21). Every term is quadratic in y.

    ``mean`` (M, 3) are the predicted offsets [m], ``certainty`` (M, 3) the prior
    variance over the predicted one, 1 without training data nearby, so that the weights
    are then those of the paper, ``steady`` (M, 3) the offsets of constant velocity [m],
    NaN where unknown, and ``reliabilities`` (M,) those of the joints. The others are
    the terms' weights, of shape (M, 1) or numbers.
    """
    near = spatial * certainty
    flow = np.where(np.isnan(steady), 0.0, temporal)
    total = near + flow + reliability * reliabilities[:, None] ** 2
    pull = near * mean + flow * np.nan_to_num(steady)
    return np.asarray(pull / np.maximum(total, 1e-12))


@dataclass(eq=False, repr=False, kw_only=True)
class FusedOffsets(OffsetCorrector):
    """Adds to each joint the offset of least energy around a prediction."""

    spatial: float = 0.6  # weight of the predicted offset (first term of eq. 22)
    temporal: float = 0.2  # weight of constant velocity (second term)
    reliability: float = 0.2  # weight of a zero offset, times reliability (third)
    likelihood: Likelihood = "relative"
    """Units of the energy's terms: squared distances, the spatial one ``relative`` to
    its prior variance; or negative log densities, with measured variances."""
    carry: float = 1.0  # share of the last velocity that the temporal term expects
    spared: float = 0.0  # share of the temporal weight less for a fully reliable joint
    inputs: Literal["measured", "held"] = "held"
    """What offsets are predicted from and added to: the joints as measured, or, if
    there is a reliability term, with unreliable ones held on their last bones."""
    seen_: Flags = field(init=False)  # the joints that the sensor measures, shape (J,)
    movement_: Array = field(init=False)
    """Variance [m^2] of the temporal term's density: of a coordinate's second
    difference between frames in which the joint is reliable, shape (M,)."""
    misplaced_: Array = field(init=False)
    """Variance [m^2] of the reliability term's density, which is a ratio: the density
    of reliable joints' offsets over that of all offsets, shape (M,)."""
    adjustable: ClassVar[tuple[str, ...]] = (
        *("spatial", "temporal", "reliability", "likelihood", "carry", "spared"),
        "inputs",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("carry", "spared"):
            if not 0.0 <= (share := getattr(self, name)) <= 1.0:
                raise InputError(f"{name}={share:g}: must be a share, from 0 to 1")
        self._past: list[Array] = []

    @cached_property
    def _neighbors(self) -> Array:
        """1 where two joints that the sensor has share a bone, otherwise 0, (J, J)."""
        adjacent = np.zeros((len(self.skeleton), len(self.skeleton)))
        ends, starts = self.skeleton.segments, self.skeleton.segment_parents
        adjacent[ends, starts] = adjacent[starts, ends] = 1.0
        return adjacent * self.seen_ * self.seen_[:, None]

    def _measure(self, training: TrainingSet) -> None:
        """Measure the variances of the temporal and the reliability term's density."""
        positions = training.positions[:_LARGEST, self.joints_]
        reliable = training.reliability[:_LARGEST, self.joints_] >= _RELIABLE
        # The jitter of the measurement is in the velocity, too, and so belongs here.
        steps = positions[2:] - 2.0 * positions[1:-1] + positions[:-2]
        begins = training.first[:_LARGEST]
        interrupted = begins[2:] | begins[1:-1]
        steps[interrupted[:, None] | ~reliable[2:]] = np.nan
        offsets = training.truth[:_LARGEST, self.joints_] - positions
        small_offsets = np.where(reliable[..., None], offsets, np.nan)
        self.movement_, small, usual = (
            np.maximum(_mean_square(values), _LEAST)
            for values in (steps, small_offsets, offsets)
        )
        # The prediction already has the usual size; this is what reliability adds.
        self.misplaced_ = 1.0 / np.maximum(1.0 / small - 1.0 / usual, _LEAST)

    def start(self) -> None:
        """Reset the state for a new motion."""
        super().start()
        self._past = []

    def step(self, observation: Observation) -> Correction:
        """Correct the next frame; a missing joint has reliability 0."""
        missing = np.isnan(observation.positions[:, 0])
        reliability = np.where(missing, 0.0, observation.reliability)
        self._trusted = self._trust(reliability, missing)
        held = self.inputs == "held" and self.reliability > 0.0
        follows = self._trusted if held else np.where(missing, 0.0, 1.0)
        posture = self._hold.follow(observation.positions, follows)
        seen = replace(observation, reliability=reliability)
        offsets, coverage = self._offsets(posture, seen)
        hung = missing.copy()
        hung[self.joints_] = False
        result = self._moved(posture, offsets, hung, coverage)
        self._past = [*self._past[-1:], result.positions[self.joints_]]
        return replace(result, confidence=np.where(missing, 0.0, result.confidence))

    def _trust(self, reliability: Array, missing: Flags) -> Array:
        """Return how closely each joint follows its measurement, in [0, 1], (J,)."""
        # Scorers count a bone whose far joint is missing as wrong, which says nothing
        # about the near joint; undo that.
        count = self._neighbors.sum(axis=1)
        lost = self._neighbors @ (missing & self.seen_)
        reliability = reliability * count / np.maximum(count - lost, 1.0)
        trust = np.clip((reliability - _DOUBTED) / (RELIABLE - _DOUBTED), 0.0, 1.0)
        root = self.skeleton.root
        trust[root] = float(not missing[root])  # the origin, however reliable
        return np.asarray(trust)

    def _fused(
        self, mean: Array, variance: Array, prior: Array, posture: Array, seen: Array
    ) -> Array:
        """Return the offsets [m] of least energy around predictions, shape (M, 3)."""
        scale, moves, misplaced = prior[:, None], np.ones(1), np.ones(1)
        if self.likelihood == "density":
            scale = np.ones(1)
            moves, misplaced = self.movement_[:, None], self.misplaced_[:, None]
        kept = 1.0 - self.spared * self._trusted[self.joints_, None]
        temporal = self.temporal * kept**2  # squared, like the reliability in eq. 21
        return least_energy(
            mean,
            scale / variance,
            self._steady(posture[self.joints_]),
            seen[self.joints_],
            spatial=self.spatial,
            temporal=temporal / moves,
            reliability=self.reliability / misplaced,
        )

    def _steady(self, posture: Array) -> Array:
        """Return the offsets that keep the velocity (eq. 20), NaN where unknown."""
        if len(self._past) < 2:
            return np.full_like(posture, np.nan)
        before, last = self._past
        return last + self.carry * (last - before) - posture


def _mean_square(values: Array) -> Array:
    present = ~np.isnan(values)
    squares = np.sum(np.where(present, values, 0.0) ** 2, axis=(0, 2))
    return np.asarray(squares / np.maximum(present.sum(axis=(0, 2)), 1))
