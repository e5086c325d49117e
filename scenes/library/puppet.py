"""A body posed by anatomical angles and planted feet: the performers' instrument.

A pose says what an anatomist or a choreographer would: how the pelvis and the spine
tilt, where the upper arms point and how far the elbows are bent, and where the feet
are. The legs follow by two-bone inverse kinematics, so that soles stay where they are
put whatever the trunk does. Angle conventions are those of the International Society
of Biomechanics (Wu et al. 2005, J. Biomech. 38(5)) for the shoulder: plane of
elevation (0 to the side, 90 degrees forward), elevation, axial rotation (positive
inward).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import gaussian_filter1d, minimum_filter1d

from kinefilter.characters import STANDARD_HEIGHT, Body, positions_from_rotations
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import (
    about_x,
    about_y,
    about_z,
    between,
    inverse,
    multiply,
    normalize,
    rotate,
    wxyz_from_matrix,
)

from .poses import LEFT, RIGHT, Pose

_SIDES = np.array([1.0, -1.0])
_X, _DOWN = np.array([1.0, 0.0, 0.0]), np.array([0.0, -1.0, 0.0])
_MIRROR = np.array([1.0, 1.0, -1.0, -1.0])  # of a wxyz quaternion, across x = 0

_MAX_REACH = 0.998  # of a straight limb: a locked joint has no bending direction
_MAX_ELBOW = np.radians(150.0)
_MAX_KNEE = np.radians(145.0)


_KNEE_FOLLOWS_FOOT = 0.8
_POINTED_TOES = np.radians(25.0)  # of a foot that hangs
_CLEARANCE = 0.03  # m between the floor and the ankle's least height when lifted
_HANGS_FROM = 0.15  # m the ankle is raised: lower, a foot is kept clear of the floor
_TRUNK = {
    "HipCenter": "pelvis",
    "SpineBase": "pelvis",
    "Spine": "lower",
    "SpineMid": "lower",
    "ShoulderCenter": "thorax",
    "SpineShoulder": "thorax",
}


@dataclass(frozen=True, eq=False)
class Trunk:
    """Where the trunk of a pose is, world frame."""

    root: Array
    """Root joint [m], (..., 3)."""
    pelvis: Array
    """Rotation of the pelvis, wxyz, (..., 4)."""
    lower: Array
    """Rotation of the lower spine, wxyz, (..., 4)."""
    thorax: Array
    """Rotation of the upper spine and rib cage, wxyz, (..., 4)."""
    neck: Array
    """Joint between the shoulders [m], (..., 3)."""


class Puppet:
    """Poses of one body."""

    def __init__(self, body: Body) -> None:
        self.body = body
        self.scale = body.height / STANDARD_HEIGHT
        """Size against the standard body, which the motions are written for."""
        index, rest = body.skeleton.index, body.rest_positions
        arm, leg = (
            [[index(f"{stem}{side}") for side in ("Left", "Right")] for stem in stems]
            for stems in (
                ("Shoulder", "Elbow", "Wrist", "Hand"),
                ("Hip", "Knee", "Ankle", "Foot"),
            )
        )
        self._collar, self._upper, self._fore, self._hand = body.lengths[arm]
        _, self._thigh, self._shank, _ = body.lengths[leg]
        self._hips, _, _, self._sole = body.rest_offsets[leg]
        self.ankle_height = float(rest[leg[2], 1].mean())
        """Height [m] of the ankle of a flat foot."""
        self.hip_width = float(np.ptp(rest[leg[0], 0]))
        """Distance [m] between the hip joints."""
        self.leg = float((self._thigh + self._shank).mean())
        """Length [m] of the straight leg, hip to ankle."""
        above = body.skeleton.girdle
        spine = body.rest_offsets[above]
        below = body.rest_offsets[body.skeleton.parents[above]]
        self._spine = below, spine
        self._lower_share = float(below[1] / (below[1] + spine[1]))

    # Poses from angles and goals -----------------------------------------------

    def stand(self, *, width: float = 1.2, toe_out: float = 0.1) -> Pose:
        """Return a relaxed upright stance, feet ``width`` hip widths apart."""
        half = width * self.hip_width / 2.0
        ankle = np.array([[half, self.ankle_height, 0.0]] * 2)
        ankle[:, 0] *= _SIDES
        arm, elbow = self.arm(0.12, 0.6, 0.3, 0.25)
        return Pose(
            root=np.array([0.0, self.ankle_height + 0.997 * self.leg, 0.01]),
            pelvis=np.zeros(3),
            spine=np.zeros(3),
            head=np.zeros(3),
            arm=np.stack([arm, arm]),
            elbow=np.stack([elbow, elbow]),
            hand=np.zeros((2, 2)),
            ankle=ankle,
            foot=np.stack([toe_out * _SIDES, np.zeros(2)], axis=-1),
            lifted=np.zeros(2),
            knee_out=np.zeros(2),
        )

    def arm(
        self,
        elevation: ArrayLike,
        plane: ArrayLike,
        rotation: ArrayLike,
        elbow: ArrayLike,
    ) -> tuple[Array, Array]:
        """Return (upper arm, elbow) from shoulder angles [rad] after Wu et al. 2005."""
        elevation, plane, rotation, elbow = np.broadcast_arrays(
            *(np.asarray(a, dtype=float) for a in (elevation, plane, rotation, elbow))
        )
        out = np.sin(elevation)
        direction = np.stack(
            [out * np.cos(plane), -np.cos(elevation), out * np.sin(plane)], axis=-1
        )
        hanging = multiply(about_y(-rotation), about_z(-np.pi / 2.0))
        return multiply(between(_DOWN, direction), hanging), elbow.copy()

    def forearm(self, side: int) -> float:
        """Return the length [m] from elbow to hand of a straight wrist."""
        return float(self._fore[side] + self._hand[side])

    def reach(
        self, side: int, goal: ArrayLike, elbow_to: ArrayLike
    ) -> tuple[Array, Array]:
        """Return (upper arm, elbow) that bring the hand joint to a goal.

        Args:
            side: LEFT or RIGHT.
            goal: Outward, up and forward of the joint between the shoulders, thorax
                frame [m] on the standard body, (..., 3). Outward is the arm's own side.
            elbow_to: Direction the elbow points to, same axes, (..., 3).
        """
        goal, pole = np.asarray(goal, float) * self.scale, np.asarray(elbow_to, float)
        upper, lower = self._upper[side], self._fore[side] + self._hand[side]
        near, far = _third_side(upper, lower, _MAX_ELBOW), _MAX_REACH * (upper + lower)
        along = np.array([np.sin(0.8) * np.cos(1.0), -np.cos(0.8), np.sin(0.8)])
        for _ in range(6):  # the collarbone follows the arm, the arm the collarbone
            line = goal - _collarbone_end(along) * self._collar[side]
            distance = np.sqrt(np.sum(line * line, axis=-1))
            line = line / np.maximum(distance, 1e-9)[..., None]
            distance = np.minimum(np.maximum(distance, near), far)
            toward = pole - np.sum(pole * line, axis=-1)[..., None] * line
            toward = _unit(toward)
            cosine = (upper**2 + distance**2 - lower**2) / (2.0 * upper * distance)
            sine = np.sqrt(1.0 - cosine**2)
            along = cosine[..., None] * line + sine[..., None] * toward
        hinge = _unit(np.cross(toward, line))
        arm = wxyz_from_matrix(_frame(along, -hinge))
        bend = (upper**2 + lower**2 - distance**2) / (2.0 * upper * lower)
        return arm, np.pi - np.arccos(bend)

    def put_hand(
        self, pose: Pose, side: int, goal: ArrayLike, elbow_to: ArrayLike
    ) -> Pose:
        """Return the pose with a hand at a goal, as ``reach``."""
        return pose.with_arm(side, self.reach(side, goal, elbow_to))

    def reach_both(self, pose: Pose, goal: ArrayLike, elbow_to: ArrayLike) -> Pose:
        """Return the pose with both hands at mirrored places, as ``reach``."""
        for side in (LEFT, RIGHT):
            pose = self.put_hand(pose, side, goal, elbow_to)
        return pose

    def reach_world(
        self, pose: Pose, side: int, goal: ArrayLike, elbow_to: ArrayLike
    ) -> tuple[Array, Array]:
        """Return ``reach`` for a goal [m] in the world, the trunk as in the pose."""
        trunk = self.trunk(pose)
        local = rotate(inverse(trunk.thorax), np.asarray(goal, float) - trunk.neck)
        local = local * np.array([_SIDES[side], 1.0, 1.0]) / self.scale
        return self.reach(side, local, elbow_to)

    def swing_leg(
        self, pose: Pose, side: int, flexion: float, abduction: float, knee: float
    ) -> Pose:
        """Return the pose with one leg lifted to hip and knee angles [rad]."""
        pelvis = self.trunk(pose).pelvis
        turn = multiply(about_z(_SIDES[side] * abduction), about_x(-flexion))
        thigh = rotate(multiply(pelvis, turn), _DOWN) * self._thigh[side]
        turn = multiply(turn, about_x(knee))
        shank = rotate(multiply(pelvis, turn), _DOWN) * self._shank[side]
        hip = self.trunk(pose).root + rotate(pelvis, self._hips[side])
        ankle, lifted, foot = pose.ankle.copy(), pose.lifted.copy(), pose.foot.copy()
        ankle[side], lifted[side], foot[side] = hip + thigh + shank, 1.0, 0.0
        foot[side, 0] = pose.pelvis[0]
        return replace(pose, ankle=ankle, lifted=lifted, foot=foot)

    # Kinematics ----------------------------------------------------------------

    def trunk(self, pose: Pose) -> Trunk:
        """Return where the trunk is, the root as high as the standing legs allow."""
        pelvis = multiply(about_y(pose.pelvis[..., 0]), _bend(pose.pelvis, yaw=False))
        lower = multiply(pelvis, _bend(pose.spine * self._lower_share))
        thorax = multiply(pelvis, _bend(pose.spine))
        root = pose.root.copy()
        root[..., 1] = np.minimum(root[..., 1], self._highest_root(pose, pelvis))
        below, above = self._spine
        neck = root + rotate(lower, below) + rotate(thorax, above)
        return Trunk(root, pelvis, lower, thorax, neck)

    def _highest_root(self, pose: Pose, pelvis: Array) -> Array:
        """Height [m] at which a standing leg is almost straight, (...)."""
        hips = rotate(pelvis[..., None, :], self._hips)
        gap = self._feet(pose)[0] - (pose.root[..., None, :] + hips)
        flat = np.sum(gap[..., [0, 2]] ** 2, axis=-1)
        reach = (_MAX_REACH * (self._thigh + self._shank)) ** 2
        rise = np.sqrt(np.maximum(reach - flat, 0.05 * reach))
        limits = self._feet(pose)[0][..., 1] + rise - hips[..., 1] + pose.lifted
        limit = np.asarray(limits.min(axis=-1))
        if limit.ndim and limit.shape[-1] > 7:  # no kinks where the limit changes legs
            limit = minimum_filter1d(limit, 7, axis=0)
            limit = gaussian_filter1d(limit, 1.5, axis=0, radius=3)
        return limit

    def _feet(self, pose: Pose) -> tuple[Array, Array]:
        """Return ankles [m], raised where the heel is, and foot rotations."""
        yaw, pitch = pose.foot[..., 0], pose.foot[..., 1]
        turn = multiply(about_y(yaw), about_x(pitch))
        pivot = rotate(about_y(yaw), self._sole) - rotate(turn, self._sole)
        on_toes = (pitch > 0.0) * (1.0 - pose.lifted)
        ankle = pose.ankle + pivot * on_toes[..., None]
        lowest = self.ankle_height + _CLEARANCE * self.scale * pose.lifted
        ankle[..., 1] = np.maximum(ankle[..., 1], lowest)
        return ankle, turn

    def solve(self, pose: Pose) -> tuple[Array, Array]:
        """Return world rotations wxyz (..., J, 4) and joint positions [m] (..., J, 3).

        Rotations are those of Clip: of the segment that ends at each joint, identity
        in the T-pose, pelvis in the root's row. Elbows and knees turn about one axis
        that upper and lower segment share.
        """
        trunk = self.trunk(pose)
        turns = {"pelvis": trunk.pelvis, "lower": trunk.lower, "thorax": trunk.thorax}
        turns["Head"] = multiply(trunk.thorax, _bend(pose.head))
        turns["Neck"] = multiply(trunk.thorax, _bend(pose.head * 0.4))
        for side, name in enumerate(("Left", "Right")):
            limbs = {**self._arm(pose, trunk, side), **self._leg(pose, trunk, side)}
            turns |= {f"{stem}{name}": turn for stem, turn in limbs.items()}
        rows = [turns[_TRUNK.get(joint, joint)] for joint in self.body.skeleton.joints]
        rotations = np.stack(rows, axis=-2)
        return rotations, positions_from_rotations(rotations, trunk.root, self.body)

    def _arm(self, pose: Pose, trunk: Trunk, side: int) -> dict[str, Array]:
        upper = pose.arm[..., side, :]
        collar = _collarbone(upper)
        fore = multiply(upper, about_y(-pose.elbow[..., side]))
        wrist = multiply(
            about_x(-pose.hand[..., side, 0]), about_z(-pose.hand[..., side, 1])
        )
        hand = multiply(fore, wrist)
        local = {"Shoulder": collar, "Elbow": upper, "Wrist": fore, "Hand": hand}
        local |= {"HandTip": hand, "Thumb": hand}
        mirror = _MIRROR if side == RIGHT else 1.0
        return {stem: multiply(trunk.thorax, q * mirror) for stem, q in local.items()}

    def _leg(self, pose: Pose, trunk: Trunk, side: int) -> dict[str, Array]:
        ankles, feet = self._feet(pose)
        line = ankles[..., side, :] - trunk.root
        line = rotate(inverse(trunk.pelvis), line) - self._hips[side]
        upper, lower = self._thigh[side], self._shank[side]
        distance = np.clip(
            np.linalg.norm(line, axis=-1),
            _third_side(upper, lower, _MAX_KNEE),
            _MAX_REACH * (upper + lower),
        )
        line = _unit(line)
        out = _SIDES[side] * pose.knee_out[..., side] + _KNEE_FOLLOWS_FOOT * (
            1.0 - pose.lifted[..., side]
        ) * (pose.foot[..., side, 0] - pose.pelvis[..., 0])
        # The turn without twist from hanging to the leg's line carries the knee's axis
        # along, so that raised legs of any direction bend as hanging ones do.
        axis = rotate(multiply(between(_DOWN, line), about_y(out)), _X)
        front = np.cross(line, axis)
        cosine = (upper**2 + distance**2 - lower**2) / (2.0 * upper * distance)
        sine = np.sqrt(np.maximum(1.0 - cosine**2, 0.0))
        thigh_line = cosine[..., None] * line + sine[..., None] * front
        shank_line = _unit(distance[..., None] * line - upper * thigh_line)
        thigh, shank = (
            multiply(trunk.pelvis, wxyz_from_matrix(_frame(axis, -along)))
            for along in (thigh_line, shank_line)
        )
        hanging = multiply(shank, about_x(pose.foot[..., side, 1] + _POINTED_TOES))
        height = (ankles[..., side, 1] - self.ankle_height) / self.scale
        free = pose.lifted[..., side] * np.clip(height / _HANGS_FROM, 0.0, 1.0)
        foot = _blend(feet[..., side, :], hanging, free)
        return {"Hip": trunk.pelvis, "Knee": thigh, "Ankle": shank, "Foot": foot}


def _unit(v: Array) -> Array:
    return np.asarray(v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-9))


def _third_side(a: float, b: float, bend: float) -> float:
    """Length between the ends of two bones bent by ``bend`` [rad] at their joint."""
    return float(np.sqrt(a * a + b * b + 2.0 * a * b * np.cos(bend)))


def _frame(x: Array, y: Array) -> Array:
    return np.stack([x, y, np.cross(x, y)], axis=-1)


def _blend(a: Array, b: Array, weight: Array) -> Array:
    b = b * np.where(np.sum(a * b, axis=-1, keepdims=True) < 0.0, -1.0, 1.0)
    return normalize(a + weight[..., None] * (b - a))


def _bend(angles: Array, *, yaw: bool = True) -> Array:
    """Rotation of (flexion, bend to the left, axial) or (yaw, tilt, lean) [rad]."""
    if not yaw:
        return multiply(about_x(angles[..., 1]), about_z(-angles[..., 2]))
    turn = multiply(about_x(angles[..., 0]), about_z(-angles[..., 1]))
    return multiply(turn, about_y(angles[..., 2]))


def _collarbone(arm: Array) -> Array:
    """Rotation of a left collarbone against the thorax: it follows the upper arm.

    Elevation and protraction grow with the arm's, after the shoulder rhythm of Inman
    et al. 1944 (J. Bone Joint Surg. 26); how much is a guess that looks right.
    """
    lift, forward = _collarbone_angles(rotate(arm, _X))
    return multiply(about_y(-forward), about_z(lift))


def _collarbone_angles(along: Array) -> tuple[Array, Array]:
    """Return elevation and protraction [rad] of the collarbone, (...), (...).

    Args:
        along: Unit vector along a left upper arm, thorax frame, (..., 3).
    """
    elevation = np.arccos(np.minimum(np.maximum(-along[..., 1], -1.0), 1.0)) / np.pi
    lift = np.radians(-7.0 + 32.0 * elevation**1.5)
    forward = np.radians(11.0) * along[..., 2] + np.radians(8.0) * np.maximum(
        -along[..., 0], 0.0
    )
    return lift, forward


def _collarbone_end(along: Array) -> Array:
    """Return the unit vector along the left collarbone, as ``_collarbone`` turns it."""
    lift, forward = _collarbone_angles(along)
    flat = np.cos(lift)
    ends = (flat * np.cos(forward), np.sin(lift), flat * np.sin(forward))
    return np.stack(ends, axis=-1)
