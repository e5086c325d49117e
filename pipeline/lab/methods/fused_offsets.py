"""Offsets fused from what is predicted, steady movement, and what was measured.

Zhou, Liu, Leung & Shum 2014 and Liu, Zhou, Leung & Shum 2016, eq. 22: the energy that
both put around the predictions of their Gaussian processes.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Any, ClassVar, Literal, TypedDict

import numpy as np
from numpy.typing import NDArray

from kinefilter.characters import InputError, Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.correct import Correction, Observation
from kinefilter.pipeline.correct.hold import RELIABLE

from .lessons import OffsetCorrector, TrainingSet, add_offsets

Likelihood = Literal["relative", "density"]
"""How the terms of the energy compare: squared distances, the spatial one times what
is unknown before over what is unknown now; or each the negative log of a density, with
a variance measured on what is learned from."""
Inputs = Literal["measured", "held"]
"""What offsets are predicted from, and added to: the joints as they were measured; or
those that are not reliable held on their last bones, where there is a reliability
term."""


class Energy(TypedDict, total=False):
    """Keywords of the energy; those left out are as in ``FusedOffsets``."""

    spatial: float
    """Weight of the predicted offset, as are the next two of eq. 22's terms."""
    temporal: float
    """Weight of constant velocity."""
    reliability: float
    """Weight of staying where a reliable joint was measured."""
    likelihood: Likelihood
    """How the terms of the energy compare."""
    carry: float
    """Share of the velocity that the temporal term expects to be left in the next
    frame; 1: constant velocity, as printed."""
    spared: float
    """Share of the temporal weight that a fully reliable joint is spared."""
    inputs: Inputs
    """What offsets are predicted from."""


_LARGEST = 100_000  # frames that movement and misplacement are measured on
_LEAST = 1e-8  # m^2: a tenth of a millimeter, which nobody sees
_RELIABLE = 0.9  # reliability from which on a joint's offset is what the term is about
_DOUBTED = 0.7
"""Reliability up to which the measured place of a joint is ignored, Chiang's least to
learn from: in the first frame in which the sensor guesses, Shum's reliability, a mean
over six, is still at 0.7. With 0.3 a limb is held where the first guesses leap to."""


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
    """Return the offsets of the least energy (Liu eq. 22), in closed form.

    The spatial term is the negative of eq. 7's log density, which is what there is to
    minimize, times twice the prior variance: certainty * |y - mean|^2, a squared
    distance as the other terms (eq. 20, 21) are. Every term is quadratic in y.

    Args:
        mean: Predicted offsets [m], shape (M, 3).
        certainty: Prior variance over predicted variance, shape (M, 3): 1 where
            nothing is known, so that the weights then are those of the paper.
        steady: Offsets of constant velocity [m], NaN where unknown, shape (M, 3).
        reliabilities: Of the joints, in [0, 1], shape (M,).
        spatial: Weight of the spatial term.
        temporal: Weight of the temporal term, or weights of shape (M, 1).
        reliability: Weight of the reliability term, likewise.
    """
    near = spatial * certainty
    flow = np.where(np.isnan(steady), 0.0, temporal)
    total = near + flow + reliability * reliabilities[:, None] ** 2
    pull = near * mean + flow * np.nan_to_num(steady)
    return np.asarray(pull / np.maximum(total, 1e-12))


class FusedOffsets(OffsetCorrector):
    """Adds to each joint the offset of least energy, around what is predicted.

    Args:
        skeleton: The joints.
        samples: Most training frames that are kept.
        seed: Draws the frames.
        spatial: See ``Energy``, as for the others.
    """

    seen_: NDArray[np.bool_]
    """The joints that the sensor measures, shape (J,)."""
    movement_: Array
    """Variance [m^2] of a coordinate's second difference from frame to frame where a
    joint is reliable, that of the temporal term's density, shape (M,)."""
    misplaced_: Array
    """Variance [m^2] of the reliability term's density: that by which reliable joints'
    offsets are smaller than all, as a ratio of the two densities, shape (M,)."""
    adjustable: ClassVar[tuple[str, ...]] = (
        *("spatial", "temporal", "reliability", "likelihood", "carry", "spared"),
        "inputs",
    )

    def __init__(
        self,
        skeleton: Skeleton,
        *,
        samples: int,
        seed: int,
        spatial: float = 0.6,
        temporal: float = 0.2,
        reliability: float = 0.2,
        likelihood: Likelihood = "relative",
        carry: float = 1.0,
        spared: float = 0.0,
        inputs: Inputs = "held",
    ) -> None:
        for name, share in (("carry", carry), ("spared", spared)):
            if not 0.0 <= share <= 1.0:
                raise InputError(f"{name}={share:g}: a share, from 0 to 1")
        super().__init__(skeleton, samples=samples, seed=seed)
        self.spatial, self.temporal = spatial, temporal
        self.reliability = reliability
        self.likelihood: Likelihood = likelihood
        self.carry, self.spared = carry, spared
        self.inputs: Inputs = inputs
        self._past: list[Array] = []

    @cached_property
    def _beside(self) -> Array:
        """1 where joints that the sensor has share a bone, (J, J)."""
        beside = np.zeros((len(self.skeleton), len(self.skeleton)))
        ends, starts = self.skeleton.segments, self.skeleton.segment_parents
        beside[ends, starts] = beside[starts, ends] = 1.0
        return beside * self.seen_ * self.seen_[:, None]

    def _measure(self, training: TrainingSet) -> None:
        """Measure the variances of the temporal and the reliability term's density."""
        seen = training.positions[:_LARGEST, self.joints_]
        sure = training.reliability[:_LARGEST, self.joints_] >= _RELIABLE
        # What velocities are taken from trembles as the measurement does.
        steps = seen[2:] - 2.0 * seen[1:-1] + seen[:-2]
        begins = training.first[:_LARGEST]
        unsteady = begins[2:] | begins[1:-1]
        steps[unsteady[:, None] | ~sure[2:]] = np.nan
        offsets = training.truth[:_LARGEST, self.joints_] - seen
        reliable = np.where(sure[..., None], offsets, np.nan)
        self.movement_, small, usual = (
            np.maximum(_mean_square(values), _LEAST)
            for values in (steps, reliable, offsets)
        )
        # The prediction has how large offsets are; this is what reliability adds.
        self.misplaced_ = 1.0 / np.maximum(1.0 / small - 1.0 / usual, _LEAST)

    def start(self) -> None:
        """Forget all frames."""
        super().start()
        self._past = []

    def step(self, observation: Observation) -> Correction:
        """Correct the next frame; a missing joint is one of no reliability."""
        missing = np.isnan(observation.positions[:, 0])
        reliable = np.where(missing, 0.0, observation.reliability)
        self._trusted = self._trust(reliable, missing)
        held = self.inputs == "held" and self.reliability > 0.0
        follows = self._trusted if held else np.where(missing, 0.0, 1.0)
        posture = self._hold.follow(observation.positions, follows)
        seen = replace(observation, reliability=reliable)
        offsets, coverage = self._offsets(posture, seen)
        hung = missing.copy()
        hung[self.joints_] = False
        found = add_offsets(
            self.skeleton, posture, self.joints_, offsets, hung, coverage
        )
        self._past = [*self._past[-1:], found.positions[self.joints_]]
        return replace(found, confidence=np.where(missing, 0.0, found.confidence))

    def _trust(self, reliable: Array, missing: NDArray[np.bool_]) -> Array:
        """Return how far each joint is taken from where it was measured, (J,)."""
        # A bone whose end is missing is scored as wrong, though nothing tells so.
        lost = self._beside @ (missing & self.seen_)
        reliable = reliable * self._beside.sum(axis=1)
        reliable /= np.maximum(self._beside.sum(axis=1) - lost, 1.0)
        trust = np.clip((reliable - _DOUBTED) / (RELIABLE - _DOUBTED), 0.0, 1.0)
        root = self.skeleton.root
        trust[root] = float(not missing[root])  # the origin, whatever it was seen as
        return np.asarray(trust)

    def _fused(
        self, mean: Array, variance: Array, prior: Array, posture: Array, seen: Array
    ) -> Array:
        """Return the offsets [m] of least energy, shape (M, 3).

        Args:
            mean: Predicted offsets [m], shape (M, 3).
            variance: Of these [m^2], shape (M, 3) or (M, 1).
            prior: Of offsets where nothing is known [m^2], shape (M,).
            posture: The joints that offsets are added to [m], shape (J, 3).
            seen: Reliability of the joints, 0 where missing, shape (J,).
        """
        known_before, moves, misplaced = self._units(prior)
        reliable = seen[self.joints_]
        # Squared, as the reliability in eq. 21.
        spared = self.spared * self._trusted[self.joints_, None]
        temporal = self.temporal * (1.0 - spared) ** 2
        return least_energy(
            mean,
            known_before / variance,
            self._steady(posture[self.joints_]),
            reliable,
            spatial=self.spatial,
            temporal=temporal / moves,
            reliability=self.reliability / misplaced,
        )

    def _units(self, prior: Array) -> tuple[Array, Array, Array]:
        """Return what squared distances of the three terms are divided by, (M, 1)."""
        if self.likelihood == "density":
            moves, misplaced = self.movement_[:, None], self.misplaced_[:, None]
            return np.ones_like(moves), moves, misplaced
        one = np.ones((len(self.joints_), 1))
        return prior[:, None], one, one

    def _steady(self, posture: Array) -> Array:
        """Return the offsets that keep the velocity (eq. 20), NaN where unknown."""
        if len(self._past) < 2:
            return np.full_like(posture, np.nan)
        before, last = self._past
        return last + self.carry * (last - before) - posture


def _mean_square(values: Array) -> Array:
    """Return the mean square of each joint's coordinates, 0 without any, (M,)."""
    there = ~np.isnan(values)
    squares = np.sum(np.where(there, values, 0.0) ** 2, axis=(0, 2))
    return np.asarray(squares / np.maximum(there.sum(axis=(0, 2)), 1))
