"""Keeps feet from pointing farther off the heading of the hips than people can.

Where a sensor swaps sides, and where people turn while a foot stands or between two
places, toes would point backward. Only feet under upright shanks are judged: the foot
of a raised shank may point anywhere.
"""

import numpy as np

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import wrapped
from kinefilter.retarget import HeadingFrame

_SPLAYED = np.radians(75.0)
"""Angle [rad] off the heading of the hips: 99.9 % of the feet in every third take of
CMU's mocap turn by less."""
_RAISED, _UPRIGHT = 0.5, 0.75
"""Cosines of a shank's angle to straight up: not judged, and upright. In the mocap all
feet that point backward have raised shanks."""


def hips_yaw(positions: Array, skeleton: Skeleton) -> Array:
    """Return the heading of the hips [rad], (T,), without jumps from pi to -pi."""
    left, right = (positions[:, hip] for hip in skeleton.hips)
    return np.unwrap(np.arctan2((right - left)[:, 2], (left - right)[:, 0]))


def uprightness(shank: Array) -> Array:
    """Return how far shanks, from ankle to knee (T, 3), are upright, 0 to 1, (T,)."""
    cosine = shank[:, 1] / np.maximum(np.linalg.norm(shank, axis=1), 1e-9)
    return np.asarray(((cosine - _RAISED) / (_UPRIGHT - _RAISED)).clip(0.0, 1.0))


def standing_direction(ahead: Array, yaw: Array) -> Array:
    """Return where a foot points that stands, (2,): ``ahead`` or nearer to the hips.

    Directions are horizontal, x and z; ``yaw`` is the heading of the hips [rad], (T,).
    """
    low, high = np.percentile(yaw, [10.0, 90.0])
    middle = 0.5 * (low + high)
    most = max(_SPLAYED - 0.5 * (high - low), 0.0)
    off = wrapped(np.arctan2(ahead[0], ahead[1]) - middle)
    angle = middle + _possible(off, most)
    return np.array([np.sin(angle), np.cos(angle)])


def turned_ahead(foot: Array, yaw: Array, upright: Array) -> Array:
    """Return ankle and toes of a foot [m], (T, 2, 3), with toes that point ahead.

    ``yaw`` is the heading of the hips [rad], ``upright`` the ``uprightness``, (T,).
    """
    toes = foot[:, 1] - foot[:, 0]
    off = wrapped(np.arctan2(toes[:, 0], toes[:, 2]) - yaw)
    turn = upright * (_possible(off, _SPLAYED) - off)
    about = HeadingFrame(foot[:, 0], turn)
    return about.restore(foot - foot[:, :1])


def _possible(off: Array, most: float) -> Array:
    """Return angles [rad] that are at most ``most``: straight back becomes ahead.

    They change steadily with those given, whichever way a foot turns.
    """
    back = np.sign(off) * (np.pi - np.abs(off)) * most / (np.pi - most)
    return np.where(np.abs(off) > most, back, off)
