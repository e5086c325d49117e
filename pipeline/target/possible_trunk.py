"""Keeps correction from folding or twisting trunks as nobody can.

Somebody who turns may leave what correction has learned: it moves one shoulder or hip
into the other, or turns them against each other.
"""

import numpy as np

from kinefilter.characters import Body
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import wrapped

_TWISTED = np.radians(45.0)
"""Angle [rad] between hips and shoulders: at most 44 degrees in mocap of the six people
of UI-PRMD."""
_FOLDED = 0.75
"""Share of its length at rest that is left of the line between hips, or shoulders.
Chosen, as the angle, on walks of p00 to p08 of two-kinects."""
_UPRIGHT = 0.7  # cosine of the angle to straight up within which lines are judged


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
    upright = trunk[:, 1] > _UPRIGHT * np.linalg.norm(trunk, axis=1)
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
