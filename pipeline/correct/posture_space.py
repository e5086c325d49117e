"""Local principal components of natural postures, and what is found in them.

Shum 2013, sections V.B and VI: the natural posture space of the neighboring postures,
the control, style, kinematics and continuity energies of a posture in it, and two
searches for the least energy: a solver and the paper's sampling. ``NaturalSpaces``
tells what of a posture lies outside the natural posture spaces around it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dposv

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.database import PostureDatabase
from kinefilter.pipeline.database.threshold_rule import filter_to_count

_STEPS = 8
_CONVERGED = 1e-3  # latent step [m], over all joints together: no one sees less
# Chosen on six people with marker mocap beside the Kinect, with the mocap of the others
# and unrelated CMU motion as databases.
_SENSOR_NOISE = 0.013  # m, of a joint along each axis, that no other joint shares
_HARDER_TO_SEE = 1.4  # noise of the middle of a limb, which has no outline of its own
_SPACES, _POSTURES = 200, 500  # local spaces, and postures that span each
_MOST = 20_000  # postures of a larger database that say how far postures vary
_BLUR = 0.06  # m a joint, over which one space gives way to the next
_FAR = 2.2  # of the database's spacing: from there it knows less and less
_IGNORANCE = 0.05  # share of the squared distance beyond that adds to its variances
_SPACING_ERROR = 0.05  # m, of a joint that Kinect v2 tracks, sizes standardized


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
        reliability: Array,
        neighbors: Array,
        steady: Array | None,
    ) -> None:
        """Set what the energy is about in this frame.

        Args:
            measured: Joint positions [m], shape (J, 3); NaN only at reliability 0.
            reliability: Reliability of each joint, shape (J,).
            neighbors: Neighboring postures [m], shape (K, 3 J).
            steady: Posture [m] that continues the last two, shape (3 J,), or None.
        """
        self.reliability = np.repeat(reliability, 3)
        self.measured = np.where(self.reliability > 0.0, measured.ravel(), 0.0)
        self.neighbors = neighbors
        self._neighbor_squares = np.sum(neighbors * neighbors, axis=1)
        self.steady = steady

    def __call__(self, postures: Array) -> Array:
        """Return energies [m^2] (N,) of postures [m] (N, 3 J)."""
        w = self.weights
        away = postures - self.measured
        control = (away * away) @ self.reliability  # eq. 10
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


def solve(space: PostureSpace, energy: PostureEnergy, start: Array) -> Array:
    """Return the latent point of least energy, by Gauss-Newton.

    All terms but the segment lengths are quadratic, and the style term of each neighbor
    adds the same Hessian, so one factorization gives every neighbor's minimum at once;
    the best of them under the true energy is the next iterate. A step that does not
    lower the energy is halved. The energy has observed the frame.
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
        pulled = (w.control * energy.reliability)[:, None] * basis
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

        The point has shape (d,), the bones there (S, 3) and their lengths (S,).
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


class NaturalSpaces:
    """Local Gaussians of natural postures, seen from the middle of the hips.

    Kinect's error puts joints where no posture has them: a knee too low for the hip, a
    shoulder too far ahead. What a measurement does along directions in which natural
    postures hardly vary is error (probabilistic PCA, Tipping & Bishop 1999, section 2).

    Args:
        database: Natural postures.
    """

    def __init__(self, database: PostureDatabase) -> None:
        skeleton = database.skeleton
        names = skeleton.joints
        # Hands follow the wrists: what they do by themselves has no shape to keep.
        self._joints = [
            j
            for j, name in enumerate(names)
            if "Hand" not in name and "Thumb" not in name
        ]
        self._hips = skeleton.hips
        self._carrier = np.arange(len(skeleton))
        for j in skeleton.order:
            if j not in self._joints:
                self._carrier[j] = self._carrier[skeleton.parents[j]]
        middle = [
            _HARDER_TO_SEE if "Elbow" in names[j] or "Knee" in names[j] else 1.0
            for j in self._joints
        ]
        self._noise = np.repeat(_SENSOR_NOISE * np.array(middle), 3)
        some = database.positions[:: -(-len(database) // _MOST)].astype(float)
        self._postures = self._rows(some)
        self._squares = np.sum(self._postures**2, axis=1)
        self._near = _FAR * np.hypot(database.spacing, _SPACING_ERROR)
        self._fit(some)

    def _rows(self, postures: Array) -> Array:
        """Return what is compared, in meters, shape (..., F)."""
        middle = postures[..., self._hips, :].mean(axis=-2, keepdims=True)
        rows = (postures - middle)[..., self._joints, :]
        return np.asarray(rows.reshape(*rows.shape[:-2], -1))

    def _fit(self, postures: Array) -> None:
        chosen = filter_to_count(postures, _SPACES)
        self._centers = self._postures[chosen]
        count = min(_POSTURES, len(self._postures))
        means, axes, variances = [], [], []
        for center in self._centers:
            squares = np.sum((self._postures - center) ** 2, axis=1)
            nearest = np.argpartition(squares, count - 1)[:count]
            # In units of the noise, so that it is the same along all axes.
            part = self._postures[nearest] / self._noise
            mean = part.mean(axis=0)
            values, vectors = np.linalg.eigh((part - mean).T @ (part - mean) / count)
            means.append(mean)
            axes.append(vectors)
            variances.append(np.maximum(values, 0.0))
        self._means, self._axes = np.array(means), np.array(axes)
        self._variances = np.array(variances)

    def shift(self, posture: Array) -> Array:
        """Return what brings a posture to where natural ones are [m], (J, 3).

        The mean of the posterior of the posture that was measured with noise. Where
        the nearest posture of the database is far, its variances grow by a share of
        the distance, and the shift goes to nothing.

        Args:
            posture: Joint positions [m], finite, shape (J, 3).
        """
        row = self._rows(posture)
        apart = self._squares - 2.0 * self._postures @ row + row @ row
        per_joint = max(float(apart.min()), 0.0) / len(self._joints)
        unknown = _IGNORANCE * max(per_joint - self._near**2, 0.0) / _SENSOR_NOISE**2
        squares = np.sum((self._centers - row) ** 2, axis=1) / len(self._joints)
        likeness = np.exp(-0.5 * (squares - squares.min()) / _BLUR**2)
        used = np.flatnonzero(likeness > 1e-3 * likeness.sum())
        weights = likeness[used] / likeness[used].sum()
        away = row / self._noise - self._means[used]
        along = np.einsum("kf,kfe->ke", away, self._axes[used])
        along /= self._variances[used] + unknown + 1.0
        moved = -np.einsum("k,ke,kfe->f", weights, along, self._axes[used])
        shifts = np.zeros_like(posture)
        shifts[self._joints] = (moved * self._noise).reshape(-1, 3)
        return np.asarray(shifts[self._carrier])
