"""Keeps knees, trunks and feet from postures that nobody can take.

Legs of people seen from the side bend backward. Somebody who turns may leave what
correction has learned: it moves one shoulder or hip into the other, or turns them
against each other. Where a sensor swaps sides, and where people turn while a foot
stands or between two places, toes would point backward.
"""

import numpy as np

from kinefilter.characters import Body, Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import cross, unit, wrapped
from kinefilter.pipeline.failures.limb_failures import LIMBS
from kinefilter.retarget import HeadingFrame

# m by which a knee may be behind the line from hip to ankle: 9 degrees. Mocap of six
# people has 12 degrees at most. Chosen, as the rest, on walks of p00 to p08.
_BEHIND = 0.03
_SIDEWAYS, _FACED = 0.3, 0.7
"""Sines of a leg's angle to the line through the hips: which way knees of a leg face
that points along it is not known, and is known."""


def possible_knees(positions: Array, skeleton: Skeleton) -> Array:
    """Return joints [m] (T, J, 3) with knees that are hardly behind their leg."""
    hips, knees, ankles = (skeleton.sides(part) for part in LIMBS["leg"])
    top, moved = positions[:, hips], positions.copy()
    left = unit(top[:, :1] - top[:, 1:])
    front = cross(unit(positions[:, ankles] - top), left)
    sine = np.sqrt(np.vecdot(front, front))
    front = unit(front)
    ahead = np.vecdot(positions[:, knees] - top, front)
    known = ((sine - _SIDEWAYS) / (_FACED - _SIDEWAYS)).clip(0.0, 1.0)
    change = known * np.maximum(-_BEHIND - ahead, 0.0)
    moved[:, knees] += change[..., None] * front
    return moved


_TWISTED = np.radians(45.0)
"""Angle [rad] between hips and shoulders: at most 44 degrees in mocap of the six people
of UI-PRMD."""
_FOLDED = 0.75
"""Share of its length at rest that is left of the line between hips, or shoulders.
Chosen, as the angle, on walks of p00 to p08 of two-kinects."""
_JUDGED = 0.7  # cosine of the angle to straight up within which lines are judged


def possible_trunk(positions: Array, body: Body) -> Array:
    """Return joints [m] (T, J, 3) with hips and shoulders as bodies can have them.

    Only these move, each pair about its middle and without changing height. The shorter
    a line, the less it tells which way the trunk faces.
    """
    skeleton = body.skeleton
    pairs = [list(skeleton.hips), skeleton.sides("Shoulder")]
    ends = positions[:, pairs]
    lines = ends[:, :, 0] - ends[:, :, 1]
    rest = body.rest_positions[pairs]
    usual = np.linalg.norm(rest[:, 0] - rest[:, 1], axis=1)
    trunk = positions[:, skeleton.girdle] - positions[:, skeleton.root]
    upright = trunk[:, 1] > _JUDGED * np.linalg.norm(trunk, axis=1)
    level = lines[..., 0] - 1j * lines[..., 2]  # its angle is the yaw
    width = np.linalg.norm(lines, axis=2) / (_FOLDED * usual)
    heading = np.angle((level / usual).sum(axis=1, keepdims=True))
    away = wrapped(np.angle(level) - heading) * np.minimum(width, 1.0)
    twist = np.abs(away[:, 1:] - away[:, :1])
    away *= np.minimum(_TWISTED / np.maximum(twist, 1e-9), 1.0)
    reach = np.sqrt(np.maximum((_FOLDED * usual) ** 2 - lines[..., 1] ** 2, 0.0))
    turned = np.maximum(np.abs(level), reach) * np.exp(1j * (heading + away))
    half = 0.5 * np.where(upright[:, None], turned - level, 0.0)
    moved, joints = positions.copy(), np.array(pairs)
    change = np.stack([half.real, 0.0 * half.real, -half.imag], axis=2)
    moved[:, joints[:, 0]] += change
    moved[:, joints[:, 1]] -= change
    return moved


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
    """Return how far shanks, from ankle to knee (T, 3), are upright, 0 to 1, (T,).

    Only feet under upright shanks are judged: that of a raised one may point anywhere.
    """
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
