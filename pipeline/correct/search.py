"""Two searches for the posture of least energy: a solver and the paper's sampling."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dposv

from .posture_space import PostureEnergy, PostureSpace

__all__ = ["solve", "stochastic_search"]

Array = NDArray[np.float64]

_STEPS = 8
_CONVERGED = 1e-4  # latent step [m] below which nothing visible changes


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
    w, joints = energy.weights, energy.joints
    basis = space.basis
    identity = np.eye(basis.shape[1])
    hessian = w.control * (basis.T * energy.rate) @ basis
    fixed = w.control * (energy.rate * (energy.measured - space.mean)) @ basis
    hessian += w.style / joints * identity  # the basis is orthonormal
    if energy.steady is not None:
        hessian += w.continuity / joints * identity
        fixed += w.continuity / joints * space.project(energy.steady)
    per_neighbor = w.style / joints * space.latent
    bone_basis = _bone_basis(basis, energy)
    latent = start
    best = float(energy(space.posture(latent[None]))[0][0])
    for _ in range(_STEPS):
        errors, bones, lengths = energy.segment_errors(space.posture(latent[None]))
        directions = bones[0] / np.maximum(lengths[0], 1e-9)[:, None]
        slope = (directions[:, None] @ bone_basis)[:, 0]
        stiff = w.kinematics / len(slope)
        curvature = hessian + stiff * slope.T @ slope
        pull = fixed + stiff * slope.T @ (slope @ latent - errors[0])
        # LAPACK itself: the wrappers' checks take as long as the 20 x 20 solution.
        points = dposv(curvature, (pull + per_neighbor).T)[1].T
        energies = energy(space.posture(points))[0]
        k = int(np.argmin(energies))
        step, lowered = points[k] - latent, float(energies[k])
        while lowered > best and np.abs(step).max() > _CONVERGED:
            step = step / 2.0
            lowered = float(energy(space.posture((latent + step)[None]))[0][0])
        if lowered > best:
            break
        latent, best = latent + step, lowered
        if np.abs(step).max() <= _CONVERGED:
            break
    return latent


def _bone_basis(basis: Array, energy: PostureEnergy) -> Array:
    """Return the change of every bone vector along the latent axes, (S, 3, d)."""
    points = basis.reshape(energy.joints, 3, -1)
    return points[energy.ends] - points[energy.starts]


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
    best = float(energy(space.posture(latent[None]))[0][0])
    spread = 0.5 * space.deviations
    for _ in range(steps):
        points = latent + spread * generator.standard_normal((samples, len(latent)))
        energies = energy(space.posture(points))[0]
        k = int(np.argmin(energies))
        if energies[k] < best:
            latent, best = points[k], float(energies[k])
        spread = spread * 0.8
    return latent
