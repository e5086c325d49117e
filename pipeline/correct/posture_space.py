"""Natural posture spaces: local principal components of a database of postures.

Shum 2013, sections V.B and VI: the space of the neighboring postures, the control,
style, kinematics and continuity energies of a posture in it, and two searches for the
minimum: a solver and the paper's sampling. ``NaturalSpaces`` finds the part of a
posture that lies outside the natural posture spaces around it.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dposv, dsyevd

from kinefilter.characters import Body
from kinefilter.characters.arrays import Array
from kinefilter.pipeline.database import PostureDatabase, filter_to_count

_STEPS = 8
_CONVERGED = 1e-3  # latent step [m] of all joints together, too small to see
# Chosen on six people with marker mocap beside the Kinect, with the mocap of the other
# people and unrelated CMU motion as databases.
_SENSOR_NOISE = 0.013  # m, of a joint along each axis, independent of other joints
_HARDER_TO_SEE = 1.4  # noise of elbows and knees, which have no outline of their own
_SPACES, _POSTURES = 200, 500  # number of local spaces, and of postures in each
_MOST = 20_000  # postures used of a larger database
_BLUR = 0.06  # m per joint, over which one space gives way to the next
_FAR = 2.2  # spacings of the database to the nearest posture, from which shifts fade
_IGNORANCE = 0.05  # share of the squared distance beyond that is added to variances
_SPACING_ERROR = 0.05  # m, of a joint that Kinect v2 tracks, on the standard body


@dataclass(frozen=True)
class EnergyWeights:
    """Weights of the energy terms (Shum 2013, section VI.E)."""

    control: float = 1.0  # pull to the measured joints, weighted by their reliability
    style: float = 0.5  # pull to the nearest of the neighboring postures
    kinematics: float = 1.5  # pull to the standard body's segment lengths
    continuity: float = 0.25  # pull to constant velocity over the last two frames


PAPER_WEIGHTS = EnergyWeights()


class PostureSpace:
    """Principal components of some postures (K, 3 J): p = mean + basis q."""

    def __init__(self, postures: Array, dimensions: int) -> None:
        """Fit the space, keeping at most ``dimensions``."""
        count = len(postures)
        self.mean = postures.sum(axis=0) / count
        centered = postures - self.mean
        # The Gram matrix has only as many rows as there are postures.
        gram = centered @ centered.T
        # LAPACK directly: numpy's checks take longer than so small a problem.
        values, vectors, _ = dsyevd(gram)
        least = 1e-12 * max(float(values[-1]), 1e-12)
        solid = int(np.count_nonzero(values > least))
        kept = slice(None, -min(dimensions, count - 1, solid) - 1, -1)
        roots, vectors = np.sqrt(values[kept]), vectors[:, kept]
        self.basis = (centered.T @ vectors) / roots
        """Orthonormal columns, largest variance first, shape (3 J, d)."""
        self.latent = vectors * roots  # latent points of the postures, shape (K, d)
        self.squares = gram.diagonal()
        """Squared distances of the postures from the mean [m^2], shape (K,)."""
        self.deviations = roots / np.sqrt(count)
        """Standard deviation of the postures along each axis [m], shape (d,)."""

    def project(self, posture: Array) -> Array:
        """Return the latent point of the nearest posture in the space, (d,)."""
        return np.asarray((posture - self.mean) @ self.basis)

    def posture(self, latent: Array) -> Array:
        """Return postures (..., 3 J) of latent points (..., d)."""
        return np.asarray(self.mean + latent @ self.basis.T)


class PostureEnergy:
    """E = wc Ec + ws Es + wk Ek + wm Em in a space (Shum 2013, eq. 10-15) [m^2].

    The basis is orthonormal, so distances between postures in the space equal those of
    their latent points; only segment lengths, to be those of ``body``, need joint
    positions. ``measured`` [m] (J, 3) may be NaN where the reliability (J,) is 0;
    ``steady`` [m] (3 J,) is the posture that continues the last two, if any.
    """

    def __init__(
        self,
        space: PostureSpace,
        body: Body,
        measured: Array,
        reliability: Array,
        steady: Array | None,
        weights: EnergyWeights = PAPER_WEIGHTS,
    ) -> None:
        self.space, self._weights = space, weights
        axes, joints = space.basis.shape[1], len(body.lengths)
        self._style = weights.style / joints
        self._to_neighbors = self._style * space.latent  # eq. 11
        self._along = -2.0 * self._to_neighbors.T
        self._from_neighbors = self._style * space.squares
        ends, starts = body.skeleton.segments, body.skeleton.segment_parents
        points = space.mean.reshape(-1, 3)
        self._bones = points[ends] - points[starts]
        points = space.basis.reshape(joints, 3, axes)
        self._bone_basis = points[ends] - points[starts]
        self._flat_basis = self._bone_basis.reshape(-1, axes).T
        self._lengths = body.lengths[ends]
        self._stiff = weights.kinematics / len(ends)  # eq. 12
        self.aim(measured, reliability, steady)

    def aim(self, measured: Array, reliability: Array, steady: Array | None) -> None:
        """Change the measurement and the steady posture, in the same space."""
        space, w, joints = self.space, self._weights, len(reliability)
        trust = w.control * np.repeat(reliability, 3)  # eq. 10
        self._offset = np.where(trust > 0.0, measured.ravel(), 0.0) - space.mean
        self._trust, self._steady = trust, steady
        pulled = trust[:, None] * space.basis
        self._hessian = pulled.T @ space.basis
        self._fixed = self._offset @ pulled
        diagonal = self._style
        if steady is not None:
            diagonal += w.continuity / joints
            self._fixed += w.continuity / joints * space.project(steady)
        self._twice_fixed = 2.0 * self._fixed
        self._hessian.flat[:: len(self._hessian) + 1] += diagonal

    @property
    def constant(self) -> float:
        """Part of the energy that is constant in the space; calls leave it out."""
        constant = float(self._trust @ self._offset**2)
        if self._steady is not None:
            change = self._steady - self.space.mean
            share = self._weights.continuity / (len(self._trust) // 3)
            constant += share * float(change @ change)
        return constant

    def __call__(self, points: Array) -> tuple[Array, Array, Array]:
        """Return energies (N,) of points (N, d), bones (N, S, 3) and lengths (N, S)."""
        moved = (points @ self._flat_basis).reshape(-1, *self._bones.shape)
        bones = self._bones + moved
        lengths = np.sqrt(np.vecdot(bones, bones))
        errors = lengths - self._lengths
        energies = np.vecdot(points @ self._hessian - self._twice_fixed, points)
        style = self._from_neighbors + points @ self._along
        energies += style.min(axis=1)
        energies += self._stiff * np.vecdot(errors, errors)
        return energies, bones, lengths

    def minima(self, latent: Array, bones: Array, lengths: Array) -> Array:
        """Return the minimum of the energy for each neighbor, shape (K, d).

        Segment lengths are linearized at the point ``latent`` (d,), with bones (S, 3).
        """
        directions = bones / np.maximum(lengths, 1e-9)[:, None]
        slope = (directions[:, None] @ self._bone_basis)[:, 0]
        curvature = self._hessian + self._stiff * (slope.T @ slope)
        wanted = slope @ latent - (lengths - self._lengths)
        pull = self._fixed + self._stiff * (wanted @ slope)
        return np.asarray(dposv(curvature, (pull + self._to_neighbors).T)[1].T)


def solve(energy: PostureEnergy, start: Array) -> Array:
    """Return the latent point of least energy, by Gauss-Newton.

    All terms except the segment lengths are quadratic, and the style terms of all
    neighbors have the same Hessian, so one factorization gives the minimum for every
    neighbor; the best of these under the true energy is the next iterate. A step that
    does not lower the energy is halved.
    """
    energies, bones, lengths = energy(start[None])
    latent, best, k = start, float(energies[0]), 0
    for _ in range(_STEPS):
        points = energy.minima(latent, bones[k], lengths[k])
        energies, bones, lengths = energy(points)
        k = int(energies.argmin())
        step, lowered = points[k] - latent, float(energies[k])
        while lowered > best and np.abs(step).max() > _CONVERGED:
            step, k = step / 2.0, 0
            energies, bones, lengths = energy((latent + step)[None])
            lowered = float(energies[0])
        if lowered > best:
            break
        latent, best = latent + step, lowered
        if np.abs(step).max() <= _CONVERGED:
            break
    return latent


def stochastic_search(
    energy: PostureEnergy,
    start: Array,
    generator: np.random.Generator,
    *,
    steps: int = 20,
    samples: int = 100,
) -> Array:
    """Return a latent point of low energy, by the paper's local stochastic search.

    Shum 2013, section VI.E: each step draws samples around the best point so far and
    moves to the best of them. The paper does not specify the spread: here it starts at
    half a standard deviation of the neighbors and shrinks by a fifth in each step.
    """
    latent, best = start, float(energy(start[None])[0][0])
    spread = 0.5 * energy.space.deviations
    for _ in range(steps):
        points = latent + spread * generator.standard_normal((samples, len(latent)))
        energies = energy(points)[0]
        k = int(np.argmin(energies))
        if energies[k] < best:
            latent, best = points[k], float(energies[k])
        spread = spread * 0.8
    return latent


class NaturalSpaces:
    """Local Gaussians of natural postures, relative to the middle of the hips.

    Kinect's errors put joints where no posture has them: a knee too low for the hip, a
    shoulder too far ahead. Whatever a measurement does along directions in which
    natural postures hardly vary is error (probabilistic PCA, Tipping & Bishop 1999,
    section 2).
    """

    def __init__(self, database: PostureDatabase) -> None:
        skeleton = database.skeleton
        # Hands move with the wrists: on their own they have no posture to keep.
        self._joints = np.flatnonzero(~skeleton.hands)
        self._hips = skeleton.hips
        self._carrier = np.arange(len(skeleton))
        for j in skeleton.order:
            if skeleton.hands[j]:
                self._carrier[j] = self._carrier[skeleton.parents[j]]
        hard = [skeleton.joints[j].startswith(("Elbow", "Knee")) for j in self._joints]
        self._noise = np.repeat(_SENSOR_NOISE * np.where(hard, _HARDER_TO_SEE, 1.0), 3)
        some = database.positions[:: -(-len(database) // _MOST)].astype(float)
        self._postures = self._rows(some)
        self._squares = np.sum(self._postures**2, axis=1)
        self._near = _FAR * np.hypot(database.spacing, _SPACING_ERROR)
        self._centers = self._postures[filter_to_count(some, _SPACES)]
        spaces = zip(*map(self._space_around, self._centers), strict=True)
        self._means, self._axes, self._variances = map(np.array, spaces)

    def _rows(self, postures: Array) -> Array:
        """Return postures (..., J, 3) as rows without hands [m], shape (..., F)."""
        middle = postures[..., self._hips, :].mean(axis=-2, keepdims=True)
        rows = (postures - middle)[..., self._joints, :]
        return np.asarray(rows.reshape(*rows.shape[:-2], -1))

    def _space_around(self, center: Array) -> tuple[Array, Array, Array]:
        """Return mean, axes and variances of the postures nearest to a center."""
        count = min(_POSTURES, len(self._postures))
        squares = np.sum((self._postures - center) ** 2, axis=1)
        nearest = np.argpartition(squares, count - 1)[:count]
        # In units of the noise, which is then the same along all axes.
        part = self._postures[nearest] / self._noise
        mean = part.mean(axis=0)
        values, axes = np.linalg.eigh((part - mean).T @ (part - mean) / count)
        return mean, axes, np.maximum(values, 0.0)

    def shift(self, posture: Array) -> Array:
        """Return the shift [m] that makes a finite posture natural, shape (J, 3).

        It leads to the posterior mean of the posture, given that it was measured with
        noise. Where the nearest posture of the database is far away, the variances grow
        by a share of the distance, and the shift fades to zero.
        """
        row = self._rows(posture)
        squares = self._squares - 2.0 * self._postures @ row + row @ row
        per_joint = max(float(squares.min()), 0.0) / len(self._joints)
        unknown = _IGNORANCE * max(per_joint - self._near**2, 0.0) / _SENSOR_NOISE**2
        squares = np.sum((self._centers - row) ** 2, axis=1) / len(self._joints)
        likeness = np.exp(-0.5 * (squares - squares.min()) / _BLUR**2)
        used = np.flatnonzero(likeness > 1e-3 * likeness.sum())
        weights = likeness[used] / likeness[used].sum()
        offset = row / self._noise - self._means[used]
        along = np.einsum("kf,kfe->ke", offset, self._axes[used])
        along /= self._variances[used] + unknown + 1.0
        moved = -np.einsum("k,ke,kfe->f", weights, along, self._axes[used])
        shifts = np.zeros_like(posture)
        shifts[self._joints] = (moved * self._noise).reshape(-1, 3)
        return np.asarray(shifts[self._carrier])
