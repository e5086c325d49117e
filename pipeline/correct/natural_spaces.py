"""What of a posture lies outside the natural posture spaces around it.

Kinect's error puts joints where no posture has them: a knee too low for the hip, a
shoulder too far ahead. Local principal components of natural postures tell how far
postures vary along each direction; what a measurement does along directions in which
they hardly vary is error (probabilistic PCA, Tipping & Bishop 1999, section 2).
"""

from __future__ import annotations

import numpy as np

from kinefilter.characters.arrays import Array
from kinefilter.pipeline.database import PostureDatabase
from kinefilter.pipeline.database.threshold_rule import filter_to_count

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


class NaturalSpaces:
    """Local Gaussians of natural postures, seen from the middle of the hips.

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
