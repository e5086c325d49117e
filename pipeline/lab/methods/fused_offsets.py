"""Offsets fused from what is predicted, steady movement, and what was measured.

Zhou, Liu, Leung & Shum 2014 and Liu, Zhou, Leung & Shum 2016, eq. 22: the energy that
both put around the predictions of their Gaussian processes.
"""

from __future__ import annotations

from typing import Any, ClassVar, Literal

import numpy as np

from kinefilter.characters import InputError, Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.correct import Correction, Observation

from .lessons import OffsetCorrector, TrainingSet

Likelihood = Literal["relative", "density"]
"""How the terms of the energy compare: squared distances, the spatial one times what
is unknown before over what is unknown now; or each the negative log of a density, with
a variance measured on what is learned from."""

_LARGEST = 100_000  # frames that movement and misplacement are measured on
_LEAST = 1e-8  # m^2: a tenth of a millimeter, which nobody sees
_RELIABLE = 0.9  # reliability from which on a joint's offset is what the term is about


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
        spatial: Weight of the predicted offset.
        temporal: Weight of constant velocity.
        reliability: Weight of staying where a reliable joint was measured.
        likelihood: How the terms of the energy compare.
        carry: Share of the velocity that the temporal term expects to be left in the
            next frame; 1: constant velocity, as printed.
        spared: Share of the temporal weight that a fully reliable joint is spared.
        seed: Draws the frames.
    """

    movement_: Array
    """Variance [m^2] of a coordinate's second difference from frame to frame in the
    mocap, that of the temporal term's density, shape (M,)."""
    misplaced_: Array
    """Mean square [m^2] of a reliable joint's offset, that of the reliability term's
    density, shape (M,)."""
    adjustable: ClassVar[tuple[str, ...]] = (
        *("spatial", "temporal", "reliability", "likelihood", "carry", "spared"),
    )

    def __init__(
        self,
        skeleton: Skeleton,
        *,
        samples: int,
        spatial: float,
        temporal: float,
        reliability: float,
        likelihood: Likelihood,
        carry: float,
        spared: float,
        seed: int,
    ) -> None:
        for name, share in (("carry", carry), ("spared", spared)):
            if not 0.0 <= share <= 1.0:
                raise InputError(f"{name}={share:g}: a share, from 0 to 1")
        super().__init__(skeleton, samples=samples, seed=seed)
        self.spatial, self.temporal = spatial, temporal
        self.reliability = reliability
        self.likelihood: Likelihood = likelihood
        self.carry, self.spared = carry, spared
        self._past: list[Array] = []

    def _measure(self, training: TrainingSet) -> None:
        """Measure the variances of the temporal and the reliability term's density."""
        truth = training.truth[:_LARGEST, self.joints_]
        steps = truth[2:] - 2.0 * truth[1:-1] + truth[:-2]
        begins = training.first[:_LARGEST]
        steps = steps[~(begins[2:] | begins[1:-1])]
        offsets = truth - training.positions[:_LARGEST, self.joints_]
        sure = training.reliability[:_LARGEST, self.joints_] >= _RELIABLE
        offsets = np.where(sure[..., None], offsets, np.nan)
        self.movement_, self.misplaced_ = (
            np.maximum(_mean_square(values), _LEAST) for values in (steps, offsets)
        )

    def start(self) -> None:
        """Forget all frames."""
        super().start()
        self._past = []

    def step(self, observation: Observation) -> Correction:
        """Correct the next frame."""
        result = super().step(observation)
        seen = ~np.isnan(observation.positions[self.joints_, :1])
        ends = np.where(seen, result.positions[self.joints_], np.nan)
        self._past = [*self._past[-1:], ends]
        return result

    def _fused(
        self, mean: Array, variance: Array, prior: Array, posture: Array, seen: Array
    ) -> Array:
        """Return the offsets [m] of least energy, shape (M, 3).

        Args:
            mean: Predicted offsets [m], shape (M, 3).
            variance: Of these [m^2], shape (M, 3) or (M, 1).
            prior: Of offsets where nothing is known [m^2], shape (M,).
            posture: Measured joints, filled where missing [m], shape (J, 3).
            seen: Reliability of the joints, shape (J,).
        """
        known_before, moves, misplaced = self._units(prior)
        reliable = seen[self.joints_]
        # Squared, as the reliability in eq. 21.
        temporal = self.temporal * (1.0 - self.spared * reliable[:, None]) ** 2
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

    def _steady(self, measured: Array) -> Array:
        """Return the offsets that keep the velocity (eq. 20), NaN where unknown."""
        if len(self._past) < 2:
            return np.full_like(measured, np.nan)
        before, last = self._past
        return last + self.carry * (last - before) - measured


def _mean_square(values: Array) -> Array:
    """Return the mean square of each joint's coordinates, 0 without any, (M,)."""
    there = ~np.isnan(values)
    squares = np.sum(np.where(there, values, 0.0) ** 2, axis=(0, 2))
    return np.asarray(squares / np.maximum(there.sum(axis=(0, 2)), 1))
