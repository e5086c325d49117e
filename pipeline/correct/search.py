"""Two searches for the posture of least energy: a solver and the paper's sampling."""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dposv

from kinefilter.characters.arrays import Array

from .posture_space import PostureEnergy, PostureSpace

_STEPS = 8
_CONVERGED = 1e-3  # latent step [m], over all joints together: no one sees less


def solve(space: PostureSpace, energy: PostureEnergy, start: Array) -> Array:
    """Return the latent point of least energy, by Gauss-Newton.

    All terms but the segment lengths are quadratic, and the style term of each neighbor
    adds the same Hessian, so one factorization gives every neighbor's minimum at once;
    the best of them under the true energy is the next iterate. A step that does not
    lower the energy is halved.

    Args:
        space: The natural posture space.
        energy: The energy, with the frame observed.
        start: Latent point to start from, shape (d,).
    """
    inside = _EnergyInside(space, energy)
    latent = start
    energies, bones, lengths = inside(latent[None])
    best, bones, lengths = float(energies[0]), bones[0], lengths[0]
    for _ in range(_STEPS):
        points = inside.minima(latent, bones, lengths)
        energies, tried_bones, tried_lengths = inside(points)
        k = int(energies.argmin())
        step, lowered = points[k] - latent, float(energies[k])
        while lowered > best and np.abs(step).max() > _CONVERGED:
            step, k = step / 2.0, 0
            energies, tried_bones, tried_lengths = inside((latent + step)[None])
            lowered = float(energies[0])
        if lowered > best:
            break
        latent, best = latent + step, lowered
        bones, lengths = tried_bones[k], tried_lengths[k]
        if np.abs(step).max() <= _CONVERGED:
            break
    return latent


class _EnergyInside:
    """The energy as a function of the latent point, up to a constant.

    The basis is orthonormal, so distances between postures of the space are those of
    their latent points, and nothing but the bones has to leave the space.
    """

    def __init__(self, space: PostureSpace, energy: PostureEnergy) -> None:
        w, joints = energy.weights, energy.joints
        basis, axes = space.basis, space.basis.shape[1]
        pulled = (w.control * energy.rate)[:, None] * basis
        self.hessian = pulled.T @ basis
        self.fixed = (energy.measured - space.mean) @ pulled
        eased = w.style / joints
        if energy.steady is not None:
            eased += w.continuity / joints
            self.fixed += w.continuity / joints * space.project(energy.steady)
        self.hessian.flat[:: axes + 1] += eased
        self.to_neighbors = w.style / joints * space.latent
        self.from_neighbors = w.style / joints * space.squares
        points = space.mean.reshape(-1, 3)
        self.bones = points[energy.ends] - points[energy.starts]
        points = basis.reshape(joints, 3, axes)
        self.bone_basis = points[energy.ends] - points[energy.starts]
        self._flat_basis = self.bone_basis.reshape(-1, axes).T
        self.lengths = energy.lengths
        self.stiff = w.kinematics / len(self.lengths)

    def __call__(self, points: Array) -> tuple[Array, Array, Array]:
        """Return energies (N,) of points (N, d), bones (N, S, 3) and lengths (N, S)."""
        bones = self.bones + (points @ self._flat_basis).reshape(-1, *self.bones.shape)
        lengths = np.sqrt(np.vecdot(bones, bones))
        errors = lengths - self.lengths
        energies = np.vecdot(points @ self.hessian - 2.0 * self.fixed, points)
        style = self.from_neighbors - 2.0 * (points @ self.to_neighbors.T)
        energies += style.min(axis=1)
        energies += self.stiff * np.vecdot(errors, errors)
        return energies, bones, lengths

    def minima(self, latent: Array, bones: Array, lengths: Array) -> Array:
        """Return where each neighbor's energy, linearized at a point, is least, (K, d).

        Args:
            latent: The point, shape (d,).
            bones: The bones there, shape (S, 3).
            lengths: Their lengths, shape (S,).
        """
        directions = bones / np.maximum(lengths, 1e-9)[:, None]
        slope = np.einsum("sk,skd->sd", directions, self.bone_basis)
        curvature = self.hessian + self.stiff * (slope.T @ slope)
        wanted = slope @ latent - (lengths - self.lengths)
        pull = self.fixed + self.stiff * (wanted @ slope)
        # LAPACK itself: the wrappers' checks take longer than so small a solution.
        return np.asarray(dposv(curvature, (pull + self.to_neighbors).T)[1].T)


def stochastic_search(
    space: PostureSpace,
    energy: PostureEnergy,
    start: Array,
    generator: np.random.Generator,
    *,
    steps: int = 20,
    samples: int = 100,
) -> Array:
    """Return a latent point of low energy, by the paper's local stochastic search.

    Shum 2013, section VI.E: each step draws samples around the best point so far and
    moves to the best of them, until a limit of steps. The paper leaves the spread open:
    half a standard deviation of the neighbors, shrinking by a fifth a step.

    Args:
        space: The natural posture space.
        energy: The energy, with the frame observed.
        start: Latent point to start from, shape (d,).
        generator: Source of the samples.
        steps: Most steps.
        samples: Samples a step.
    """
    latent = start
    best = float(energy(space.posture(latent[None]))[0])
    spread = 0.5 * space.deviations
    for _ in range(steps):
        points = latent + spread * generator.standard_normal((samples, len(latent)))
        energies = energy(space.posture(points))
        k = int(np.argmin(energies))
        if energies[k] < best:
            latent, best = points[k], float(energies[k])
        spread = spread * 0.8
    return latent
