"""The natural posture space and the energy that is minimized in it.

Shum 2013, sections V.B and VI: principal components of the neighboring postures, and
control, style, kinematics and continuity energies of a posture in their span.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array


@dataclass(frozen=True)
class EnergyWeights:
    """Weights of the energy terms (Shum 2013, section VI.E)."""

    control: float = 1.0
    """Pull to the measured joints, by their reliability."""
    style: float = 0.5
    """Pull to the nearest of the neighboring postures."""
    kinematics: float = 1.5
    """Pull to the standard body's segment lengths."""
    continuity: float = 0.25
    """Pull to steady movement since the last two frames."""


class PostureSpace:
    """Principal components of some postures: p = mean + basis q."""

    def __init__(self, postures: Array, dimensions: int) -> None:
        """Fit the space to postures (K, 3 J), keeping at most ``dimensions``."""
        count = len(postures)
        self.mean = postures.sum(axis=0) / count
        centered = postures - self.mean
        # The Gram matrix is as small as the neighbors are few.
        gram = centered @ centered.T
        values, vectors = np.linalg.eigh(gram)
        least = 1e-12 * max(float(values[-1]), 1e-12)
        solid = int(np.count_nonzero(values > least))
        kept = slice(None, -min(dimensions, count - 1, solid) - 1, -1)
        values, vectors = values[kept], vectors[:, kept]
        roots = np.sqrt(values)
        self.basis = (centered.T @ vectors) / roots
        """Orthonormal columns, largest variance first, shape (3 J, d)."""
        self.latent = vectors * roots
        """The postures in the space, shape (K, d)."""
        self.squares = gram.diagonal()
        """Their squared distances from the mean [m^2], shape (K,)."""
        self.deviations = roots / np.sqrt(count)
        """Standard deviation of the postures along each axis [m], shape (d,)."""

    def project(self, posture: Array) -> Array:
        """Return the latent point of the nearest posture in the space, (d,)."""
        return np.asarray((posture - self.mean) @ self.basis)

    def posture(self, latent: Array) -> Array:
        """Return postures (..., 3 J) of latent points (..., d)."""
        return np.asarray(self.mean + latent @ self.basis.T)


class PostureEnergy:
    """E = wc Ec + ws Es + wk Ek + wm Em of postures (Shum 2013, eq. 10-15) [m^2]."""

    def __init__(
        self, skeleton: Skeleton, standard_lengths: Array, weights: EnergyWeights
    ) -> None:
        self.weights = weights
        self.ends, self.starts = skeleton.segments, skeleton.segment_parents
        self.lengths = standard_lengths[self.ends]
        self.joints = len(skeleton)

    def observe(
        self,
        measured: Array,
        rate: Array,
        neighbors: Array,
        steady: Array | None,
    ) -> None:
        """Set what the energy is about in this frame.

        Args:
            measured: Joint positions [m], finite where the rate is not 0, (J, 3).
            rate: Reliability rate of each joint, shape (J,).
            neighbors: Neighboring postures [m], shape (K, 3 J).
            steady: Posture [m] that continues the last two, shape (3 J,), or None.
        """
        self.rate = np.repeat(rate, 3)
        self.measured = np.where(self.rate > 0.0, measured.ravel(), 0.0)
        self.neighbors = neighbors
        self._neighbor_squares = np.sum(neighbors * neighbors, axis=1)
        self.steady = steady

    def __call__(self, postures: Array) -> Array:
        """Return energies [m^2] (N,) of postures [m] (N, 3 J)."""
        w = self.weights
        away = postures - self.measured
        control = (away * away) @ self.rate  # eq. 10
        squares = np.sum(postures * postures, axis=1)
        to_neighbors = (
            squares[:, None]
            - 2.0 * (postures @ self.neighbors.T)
            + self._neighbor_squares
        )
        style = to_neighbors.min(axis=1) / self.joints  # eq. 11
        error = self._length_errors(postures)
        kinematics = np.mean(error * error, axis=1)  # eq. 12
        energy = w.control * control + w.style * style + w.kinematics * kinematics
        if self.steady is not None:
            change = postures - self.steady
            energy += w.continuity * np.sum(change * change, axis=1) / self.joints
        return np.asarray(energy)

    def _length_errors(self, postures: Array) -> Array:
        """Return by how much segments are too long [m], shape (N, S)."""
        points = postures.reshape(len(postures), -1, 3)
        bones = points[:, self.ends] - points[:, self.starts]
        lengths = np.sqrt(np.sum(bones * bones, axis=2))
        return np.asarray(lengths - self.lengths)
