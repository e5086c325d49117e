"""Keeps knees, trunks, arms and feet from postures that nobody can take.

Legs of people seen from the side bend backward, and arms pass through the body.
Somebody who turns may leave what correction has learned: it moves one shoulder or hip
into the other, or turns them against each other. Where a sensor swaps sides, and where
people turn while a foot stands or between two places, toes would point backward.
"""

from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d

from kinefilter.characters import Body, Skeleton
from kinefilter.characters.anthropometry import STANDARD_HEIGHT
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import cross, unit, wrapped
from kinefilter.pipeline.failures.limb_failures import LIMBS
from kinefilter.retarget import HeadingFrame


def possible_joints(positions: Array, body: Body) -> Array:
    """Return joints [m] (T, J, 3) with trunk, arms and knees where they can be."""
    positions = possible_arms(possible_trunk(positions, body), body)
    return possible_knees(positions, body.skeleton)


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


_FAST = np.radians(300.0)
"""Speed [rad/s] from which lines between hips, or shoulders, turn more evenly. A guess,
as are the time over which they do and the angles below."""
_EVEN_TIME = 0.1  # s: standard deviation of the Gaussian that evens a turn
_FACING, _ASIDE = np.radians(20.0), np.radians(40.0)
"""Angles [rad] off the direction to the sensor: up to one a line is seen well, and from
the other on it is not."""


def even_turns(positions: Array, body: Body, time: Array) -> Array:
    """Return joints [m] (T, J, 3) with hips and shoulders that do not jerk round.

    As in ``possible_trunk``, only these move, each pair about its middle. Correction
    may jump where a person turns away from the sensor, which is at the origin; people
    who face it may turn as fast as they do. Time stamps [s] have shape (T,).
    """
    if len(time) < 3:
        return positions
    step, moved = float(np.median(np.diff(time))), positions.copy()
    for pair in (list(body.skeleton.hips), body.skeleton.sides("Shoulder")):
        ends = positions[:, pair]
        line, middle = ends[:, 0] - ends[:, 1], ends.mean(axis=1)
        yaw = np.unwrap(np.arctan2(-line[:, 2], line[:, 0]))
        turned = np.abs(np.diff(yaw)) / np.diff(time)
        speed = np.maximum(np.append(turned, 0.0), np.append(0.0, turned))
        view = np.abs(wrapped(yaw - np.arctan2(-middle[:, 0], -middle[:, 2])))
        jerk = (speed / _FAST - 1.0).clip(0.0, 1.0)
        jerk *= ((view - _FACING) / (_ASIDE - _FACING)).clip(0.0, 1.0)
        share = 4.0 * gaussian_filter1d(jerk, _EVEN_TIME / step)
        even = gaussian_filter1d(yaw, _EVEN_TIME / step, mode="nearest")
        about = HeadingFrame(middle, share.clip(0.0, 1.0) * (even - yaw))
        moved[:, pair] = about.restore(ends - middle[:, None])
    return moved


_THICK = np.array([0.18, 0.13])
"""Half width and depth [m] of a trunk of average size, within which no forearm's axis
is in mocap of s02, s03 and s04."""
_OUTWARD = np.array([[[0.5, 0.0]], [[-0.5, 0.0]]])
"""Added, in units of these, to the direction in which the left and the right arm leave
the trunk, so that they rather go to their own side. A guess."""
_LOW, _HIGH = (-0.15, 0.0), (0.85, 1.0)
"""Heights, 0 at the hips and 1 at the shoulders, over which the trunk begins, and over
which it ends. A guess."""


def possible_arms(positions: Array, body: Body) -> Array:
    """Return joints [m] (T, J, 3) with forearms outside of the trunk.

    A Kinect beside a person puts the arm that it does not see into the body. Elbows and
    wrists are moved across the trunk only, rather to their own side, and hands with the
    wrists.
    """
    skeleton = body.skeleton
    parts = [skeleton.sides(part) for part in ("Elbow", "Wrist")]
    size = _THICK * body.height / STANDARD_HEIGHT
    hips, shoulders = skeleton.hips, skeleton.sides("Shoulder")
    corners = positions[:, [*shoulders, *hips]].reshape(-1, 2, 2, 3)
    upper, low = corners.mean(axis=2).transpose(1, 0, 2)
    ends = positions[:, np.transpose(parts)] - low[:, None, None]
    up = unit(upper - low)
    # Few arms are near enough to the line from hips to shoulders.
    points = np.concatenate([ends, ends.mean(axis=2, keepdims=True)], axis=2)
    along = (points @ up[:, None, :, None])[..., 0]
    away = np.vecdot(points, points) - along**2
    near = np.flatnonzero(away.min(axis=(1, 2)) < size.max() ** 2)
    if not len(near):
        return positions
    trunk = _Trunk(corners[near], (upper - low)[near], up[near], size)
    ends = ends[near]
    moves = trunk.way_out(ends.mean(axis=2, keepdims=True))
    moves = moves + trunk.way_out(ends + moves)
    moved = positions.copy()
    for side, (elbow, wrist) in enumerate(np.transpose(parts).tolist()):
        hand = [wrist, *skeleton.descendants(wrist)]
        moved[near, elbow] += moves[:, side, 0]
        moved[np.ix_(near, hand)] += moves[:, side, 1:]
    return moved


class _Trunk(NamedTuple):
    """Trunks (T) as ellipses of a half width and depth [m], ``size`` (2,)."""

    corners: Array  # shoulders and hips, left and right [m], shape (T, 2, 2, 3)
    line: Array  # from the middle of the hips to that of the shoulders [m], (T, 3)
    up: Array  # its direction, (T, 3)
    size: Array

    def way_out(self, points: Array) -> Array:
        """Return moves [m] that bring points of both arms out, (T, 2, N, 3).

        The points are relative to the middle of the hips.
        """
        line, up = self.line[:, None, None], self.up[:, None, None]
        height = np.vecdot(points, line) / np.maximum(np.vecdot(line, line), 1e-9)
        share = height.clip(0.0, 1.0)[..., None]
        lefts = unit(self.corners[:, :, 0] - self.corners[:, :, 1])[:, None, None]
        left = share * lefts[..., 0, :] + (1.0 - share) * lefts[..., 1, :]
        left = unit(left - np.vecdot(left, up)[..., None] * up)
        axes = np.stack([left, cross(left, np.broadcast_to(up, left.shape))], axis=-2)
        place = (axes @ points[..., None])[..., 0] / self.size
        way = unit(place + _OUTWARD)
        along = np.vecdot(place, way)
        inside = np.maximum(1.0 - np.vecdot(place, place), 0.0)
        far = np.sqrt(along**2 + inside) - along  # to the edge of the ellipse
        begins, ends = (
            ((height - first) / (last - first)).clip(0.0, 1.0)
            for first, last in (_LOW, _HIGH)
        )
        far *= begins * (1.0 - ends) * (inside > 0.0)
        across = far[..., None] * way * self.size
        return np.asarray((across[..., None, :] @ axes)[..., 0, :])


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
