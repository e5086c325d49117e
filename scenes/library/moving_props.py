"""Motion of a scene's movable props during a performance.

A box is carried while the hands are about its width apart and ahead of the body, from
where they are lowest before they rise to where they are lowest before they part.
"""

from collections.abc import Callable

import mujoco
import numpy as np

from kinefilter.characters import Motion
from kinefilter.characters.anthropometry import GRAVITY
from kinefilter.characters.arrays import Array, runs
from kinefilter.characters.rotations import matrix_from_wxyz, normalize

from .ball import ball_path
from .performer_hands import Hands, fading

Support = Callable[[Array], float]

# Guesses that suit the scripted motions.
_GRIP = (0.5, 1.6)  # distance of the hand joints, as a share of the box's width
_AHEAD = 0.25  # m in front of the root joint: hanging hands hold nothing
_SHORTEST_CARRY = 0.4  # s
_STIR = 0.03  # m: smallest rise of the hands that counts as lifting
_ARM = 0.35  # m: largest distance from which the hands grasp a box or set it down


def box_path(hands: Hands, size: Array, rest: Array, support: Support) -> Array:
    """Return position [m] and rotation wxyz of the box, shape (T, 7).

    Until it is first lifted, the box lies below the place of the lift; if that is in
    the air, the hands hold it from the start. A box released in the air falls. ``size``
    are its half extents [m], y between the hands, (3,), ``rest`` its pose where it is
    untouched, (7,), and ``support`` returns the height [m] of the surface below a
    point.
    """
    path = np.tile(np.asarray(rest, dtype=float), (len(hands.time), 1))
    for number, (lift, drop) in enumerate(_carries(hands, size)):
        lying = path[lift].copy()
        if number == 0:
            lying = _laid(hands, lift, size, support)
            if hands.middle[lift, 2] - lying[2] > _ARM:
                lift, lying = 0, _held(hands)[0]
            path[:] = lying
        elif np.linalg.norm(hands.middle[lift] - lying[:3]) > _ARM:
            continue
        path[lift:] = _carried(hands, lying, lift, drop, size, support)[lift:]
    # The center of a tilted box is at least this high above the floor.
    half_height = np.abs(matrix_from_wxyz(path[:, 3:])[:, 2]) @ size
    path[:, 2] = np.maximum(path[:, 2], half_height)
    return path


def _carries(hands: Hands, size: Array) -> list[tuple[int, int]]:
    """Return the frames between which the box leaves its support and lands."""
    share = hands.gap / (2.0 * size[1])
    around = (_GRIP[0] < share) & (share < _GRIP[1]) & (hands.ahead > _AHEAD)
    height = hands.middle[:, 2]
    carries = []
    for run in runs(around, hands.frames(_SHORTEST_CARRY)):
        lift = run.start + _bottom(height[run])
        drop = run.stop - 1 - _bottom(height[run][::-1])
        if drop - lift >= hands.frames(_SHORTEST_CARRY):
            carries.append((lift, drop))
    return carries


def _bottom(height: Array) -> int:
    """Return the index of the lowest point before the first clear rise."""
    rises = np.flatnonzero(height > np.minimum.accumulate(height) + _STIR)
    return int(np.argmin(height[: rises[0] + 1])) if len(rises) else 0


def _held(hands: Hands) -> Array:
    """Return the pose of a box held level between the hands, shape (T, 7)."""
    return np.concatenate([hands.middle, hands.turn], axis=-1)


def _laid(hands: Hands, frame: int, size: Array, support: Support) -> Array:
    x, y, z, *turn = _held(hands)[frame]
    upright = normalize(np.array([turn[0], 0.0, 0.0, turn[3]]))
    return np.array([x, y, support(np.array([x, y, z])) + size[2], *upright])


def _carried(
    hands: Hands, lying: Array, lift: int, drop: int, size: Array, support: Support
) -> Array:
    """Return the poses of a box that is lifted and set down, valid from the lift on."""
    held, time = _held(hands), hands.time
    landed = _laid(hands, drop, size, support)
    fall = held[drop, 2] - landed[2]
    path = held + fading(time - time[lift])[:, None] * _off(lying, held[lift])
    if fall < _ARM:
        path += fading(time[drop] - time)[:, None] * _off(landed, held[drop])
    path[drop:] = landed
    if fall >= _ARM:
        since = time[drop:] - time[drop]
        path[drop:, 2] += np.maximum(fall - 0.5 * GRAVITY * since**2, 0.0)
    path[:, 3:] = normalize(path[:, 3:])
    return path


def _off(wanted: Array, held: Array) -> Array:
    sign = np.ones(7)
    sign[3:] = 1.0 if wanted[3:] @ held[3:] >= 0.0 else -1.0
    return np.asarray(sign * wanted - held)


def movable_props(scene: mujoco.MjSpec) -> tuple[str, ...]:
    """Return the names of the bodies with a free joint, except the character's."""
    bodies = {body.name for body in scene.bodies}
    free = mujoco.mjtJoint.mjJNT_FREE
    names = (joint.parent.name for joint in scene.joints if joint.type == free)
    return tuple(name for name in names if f"target:{name}" not in bodies)


def prop_poses(scene: mujoco.MjSpec, motion: Motion) -> dict[str, Array]:
    """Return the pose of every movable prop in every frame, shape (T, 7), by name.

    A pose is the position [m] and the rotation wxyz of the prop's body in MuJoCo's
    world. A box is carried between both hands; a sphere is held, dribbled and thrown;
    every other prop stays in place. A character in the scene is ignored.
    """
    model = scene.copy().compile()
    hands = Hands.of(motion)
    support = _support(scene)
    poses = {}
    for name in movable_props(scene):
        body = model.body(name)
        rest = np.concatenate([body.pos, body.quat])
        poses[name] = np.tile(rest, (len(motion), 1))
        own = model.geom_bodyid == body.id
        solid = np.flatnonzero(own & (model.geom_contype > 0))
        if len(solid) != 1:  # neither a box nor a ball
            continue
        geom = int(solid[0])
        size = model.geom_size[geom].copy()
        match model.geom_type[geom]:
            case mujoco.mjtGeom.mjGEOM_SPHERE:
                poses[name][:, :3] = ball_path(hands, float(size[0]), rest[:3])
            case mujoco.mjtGeom.mjGEOM_BOX:
                poses[name] = box_path(hands, size, rest, support)
    return poses


def _support(scene: mujoco.MjSpec) -> Support:
    """Return a function for the height [m] of the static surface below a point."""
    room = scene.copy()
    for body in list(room.worldbody.bodies):
        if body.joints or body.mocap:
            room.delete(body)
    model = room.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    down, geom = np.array([0.0, 0.0, -1.0]), np.zeros(1, dtype=np.int32)

    def height(point: Array) -> float:
        fall = mujoco.mj_ray(model, data, point, down, None, 1, -1, geom)
        return float(point[2] - fall) if fall >= 0.0 else 0.0

    return height
