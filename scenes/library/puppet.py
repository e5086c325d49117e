"""A body that is posed by anatomical angles and planted feet.

Trunk and arms are posed by angles; the legs follow by two-bone inverse kinematics, so
that planted soles stay in place. Shoulder angles follow the International Society of
Biomechanics (Wu et al. 2005, J. Biomech. 38(5)): plane of elevation (0 to the side, 90
degrees forward), elevation, axial rotation (positive inward).
"""

from dataclasses import replace
from typing import NamedTuple

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
    unit,
    wxyz_from_matrix,
)
from kinefilter.characters.skeleton import SIDES

from .poses import LEFT, RIGHT, Arm, Pose

_SIDES = np.array([1.0, -1.0])
_X, _DOWN = np.array([1.0, 0.0, 0.0]), np.array([0.0, -1.0, 0.0])
_MIRROR = np.array([1.0, 1.0, -1.0, -1.0])  # of a wxyz quaternion, across x = 0

_MAX_REACH = 0.998  # of a straight limb: a straight joint has no bending direction
_MAX_ELBOW = np.radians(150.0)
_MAX_KNEE = np.radians(145.0)

_KNEE_FOLLOWS_FOOT = 0.8  # share of the foot's yaw that turns the knee along
_POINTED_TOES = np.radians(25.0)  # of a hanging foot
_CLEARANCE = 0.03  # m of a lifted ankle above its height when the foot is flat
_HANGS_FROM = 0.15  # m of ankle rise above which a lifted foot hangs fully
_TRUNK = {
    **dict.fromkeys(("HipCenter", "SpineBase"), "pelvis"),
    **dict.fromkeys(("Spine", "SpineMid"), "lower"),
    **dict.fromkeys(("ShoulderCenter", "SpineShoulder"), "thorax"),
}


class Trunk(NamedTuple):
    """Position [m] and rotations (wxyz) of the trunk in the world frame."""

    root: Array  # (..., 3)
    pelvis: Array  # (..., 4)
    lower: Array  # lower spine, (..., 4)
    thorax: Array  # upper spine and rib cage, (..., 4)
    neck: Array  # joint between the shoulders, (..., 3)


Turns = dict[str, Array]  # world rotations (wxyz) by segment


class Puppet:
    """Kinematics of one body."""

    def __init__(self, body: Body) -> None:
        self.body = body
        self.scale = body.height / STANDARD_HEIGHT  # relative to the standard body
        sides, rest = body.skeleton.sides, body.rest_positions
        arm = [sides(joint) for joint in ("Shoulder", "Elbow", "Wrist", "Hand")]
        leg = [sides(joint) for joint in ("Hip", "Knee", "Ankle", "Foot")]
        self._collar, self._upper, self._fore, self._hand = body.lengths[arm]
        _, self._thigh, self._shank, _ = body.lengths[leg]
        self._hips, _, _, self._sole = body.rest_offsets[leg]
        self.ankle_height = float(rest[leg[2], 1].mean())  # where the foot is flat [m]
        self.hip_width = float(np.ptp(rest[leg[0], 0]))  # between the hip joints [m]
        self.leg = float((self._thigh + self._shank).mean())  # hip to ankle [m]
        girdle = body.skeleton.girdle
        self._upper_spine = body.rest_offsets[girdle]
        self._lower_spine = body.rest_offsets[body.skeleton.parents[girdle]]
        lower, upper = self._lower_spine[1], self._upper_spine[1]
        self._lower_share = float(lower / (lower + upper))

    def arm(
        self, elevation: ArrayLike, plane: ArrayLike, axial: ArrayLike, elbow: ArrayLike
    ) -> Arm:
        """Return (upper arm, elbow) for shoulder angles [rad] after Wu et al. 2005."""
        elevation, plane, axial, elbow = np.broadcast_arrays(
            *(np.asarray(a, dtype=float) for a in (elevation, plane, axial, elbow))
        )
        out = np.sin(elevation)
        x, y, z = out * np.cos(plane), -np.cos(elevation), out * np.sin(plane)
        direction = np.stack([x, y, z], axis=-1)
        hanging = multiply(about_y(-axial), about_z(-np.pi / 2.0))
        return multiply(between(_DOWN, direction), hanging), elbow.copy()

    def forearm(self, side: int) -> float:
        """Return the length [m] from elbow to hand with a straight wrist."""
        return float(self._fore[side] + self._hand[side])

    def reach(self, side: int, goal: ArrayLike, pole: ArrayLike) -> Arm:
        """Return (upper arm, elbow) that bring the hand joint to a goal.

        The goal is outward (to the side of the arm), up and forward of the joint
        between the shoulders, thorax frame [m] on the standard body, shape (..., 3);
        the elbow points in the direction ``pole``, same axes, shape (..., 3).
        """
        goal, pole = np.asarray(goal, float) * self.scale, np.asarray(pole, float)
        upper, lower = self._upper[side], self.forearm(side)
        near, far = _third_side(upper, lower, _MAX_ELBOW), _MAX_REACH * (upper + lower)
        along = np.array([np.sin(0.8) * np.cos(1.0), -np.cos(0.8), np.sin(0.8)])
        for _ in range(6):  # the collarbone depends on the arm, and the arm on it
            line = goal - _collarbone_end(along) * self._collar[side]
            distance = np.sqrt(np.sum(line * line, axis=-1))
            line = line / np.maximum(distance, 1e-9)[..., None]
            distance = np.minimum(np.maximum(distance, near), far)
            toward = unit(pole - np.sum(pole * line, axis=-1)[..., None] * line)
            along = _upper_bone(upper, lower, distance, line, toward)
        arm = _from_axes(along, -unit(np.cross(toward, line)))
        bend = (upper**2 + lower**2 - distance**2) / (2.0 * upper * lower)
        return arm, np.pi - np.arccos(bend)

    def put_hand(self, pose: Pose, side: int, goal: ArrayLike, pole: ArrayLike) -> Pose:
        """Return the pose with a hand at a goal; arguments as in ``reach``."""
        return pose.with_arm(side, self.reach(side, goal, pole))

    def reach_both(self, pose: Pose, goal: ArrayLike, pole: ArrayLike) -> Pose:
        """Return the pose with both hands at mirrored goals; see ``reach``."""
        pose = self.put_hand(pose, LEFT, goal, pole)
        return self.put_hand(pose, RIGHT, goal, pole)

    def reach_world(
        self, trunk: Trunk, side: int, goal: ArrayLike, pole: ArrayLike
    ) -> Arm:
        """Return ``reach`` for a goal in the world frame [m] and a pose's trunk."""
        local = rotate(inverse(trunk.thorax), np.asarray(goal, float) - trunk.neck)
        local = local * np.array([_SIDES[side], 1.0, 1.0]) / self.scale
        return self.reach(side, local, pole)

    def put_hand_world(
        self, pose: Pose, side: int, goal: ArrayLike, pole: ArrayLike
    ) -> Pose:
        """Return the pose with a hand at a goal in the world frame [m]."""
        arm = self.reach_world(self.trunk(pose), side, goal, pole)
        return pose.with_arm(side, arm)

    def swing_leg(
        self, pose: Pose, side: int, flexion: float, abduction: float, knee: float
    ) -> Pose:
        """Return the pose with one leg lifted to hip and knee angles [rad]."""
        trunk = self.trunk(pose)
        turn = multiply(about_z(_SIDES[side] * abduction), about_x(-flexion))
        thigh = rotate(multiply(trunk.pelvis, turn), _DOWN) * self._thigh[side]
        turn = multiply(turn, about_x(knee))
        shank = rotate(multiply(trunk.pelvis, turn), _DOWN) * self._shank[side]
        hip = trunk.root + rotate(trunk.pelvis, self._hips[side])
        ankle, lifted, foot = pose.ankle.copy(), pose.lifted.copy(), pose.foot.copy()
        ankle[side], lifted[side], foot[side] = hip + thigh + shank, 1.0, 0.0
        foot[side, 0] = pose.pelvis[0]
        return replace(pose, ankle=ankle, lifted=lifted, foot=foot)

    def trunk(self, pose: Pose) -> Trunk:
        """Return the trunk, its root no higher than the planted legs allow."""
        yaw, tilt, lean = (pose.pelvis[..., k] for k in range(3))
        pelvis = multiply(about_y(yaw), multiply(about_x(tilt), about_z(-lean)))
        lower = multiply(pelvis, _bend(pose.spine * self._lower_share))
        thorax = multiply(pelvis, _bend(pose.spine))
        root = pose.root.copy()
        root[..., 1] = np.minimum(root[..., 1], self._highest_root(pose, pelvis))
        neck = root + rotate(lower, self._lower_spine)
        neck = neck + rotate(thorax, self._upper_spine)
        return Trunk(root, pelvis, lower, thorax, neck)

    def _highest_root(self, pose: Pose, pelvis: Array) -> Array:
        """Return the height [m] at which a planted leg is almost straight, (...)."""
        hips, (ankles, _) = rotate(pelvis[..., None, :], self._hips), self._feet(pose)
        gap = ankles - (pose.root[..., None, :] + hips)
        flat = np.sum(gap[..., [0, 2]] ** 2, axis=-1)
        reach = (_MAX_REACH * (self._thigh + self._shank)) ** 2
        rise = np.sqrt(np.maximum(reach - flat, 0.05 * reach))
        limits = ankles[..., 1] + rise - hips[..., 1] + pose.lifted
        limit = np.asarray(limits.min(axis=-1))
        # Smooth the kinks where the limit changes from one leg to the other.
        if limit.ndim and limit.shape[-1] > 7:
            limit = minimum_filter1d(limit, 7, axis=0)
            limit = gaussian_filter1d(limit, 1.5, axis=0, radius=3)
        return limit

    def _feet(self, pose: Pose) -> tuple[Array, Array]:
        """Return ankles [m], moved by the heel rise, and foot rotations."""
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

        Rotations are those of Clip. Elbows and knees are hinges: upper and lower
        segment share the axis.
        """
        return self.with_arms(pose, *self.without_arms(pose))

    def without_arms(self, pose: Pose) -> tuple[Trunk, Turns]:
        """Return the trunk, and the rotations of all segments that arms do not move."""
        trunk = self.trunk(pose)
        turns = {"pelvis": trunk.pelvis, "lower": trunk.lower, "thorax": trunk.thorax}
        turns["Head"] = multiply(trunk.thorax, _bend(pose.head))
        turns["Neck"] = multiply(trunk.thorax, _bend(pose.head * 0.4))
        for side, name in enumerate(SIDES):
            legs = self._leg(pose, trunk, side)
            turns |= {f"{stem}{name}": turn for stem, turn in legs.items()}
        return trunk, turns

    def with_arms(self, pose: Pose, trunk: Trunk, turns: Turns) -> tuple[Array, Array]:
        """Return what ``solve`` does, given what ``without_arms`` returns."""
        turns = dict(turns)
        for side, name in enumerate(SIDES):
            arms = self._arm(pose, trunk, side)
            turns |= {f"{stem}{name}": turn for stem, turn in arms.items()}
        rows = [turns[_TRUNK.get(joint, joint)] for joint in self.body.skeleton.joints]
        rotations = np.stack(rows, axis=-2)
        return rotations, positions_from_rotations(rotations, trunk.root, self.body)

    def _arm(self, pose: Pose, trunk: Trunk, side: int) -> dict[str, Array]:
        upper = pose.arm[..., side, :]
        lift, forward = _collarbone_angles(rotate(upper, _X))
        collar = multiply(about_y(-forward), about_z(lift))
        fore = multiply(upper, about_y(-pose.elbow[..., side]))
        turns = pose.hand[..., side, :]
        wrist = multiply(about_x(-turns[..., 0]), about_z(-turns[..., 1]))
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
        near, far = _third_side(upper, lower, _MAX_KNEE), _MAX_REACH * (upper + lower)
        distance = np.clip(np.linalg.norm(line, axis=-1), near, far)
        line = unit(line)
        out = _SIDES[side] * pose.knee_out[..., side] + _KNEE_FOLLOWS_FOOT * (
            1.0 - pose.lifted[..., side]
        ) * (pose.foot[..., side, 0] - pose.pelvis[..., 0])
        # The twist-free rotation from hanging to the leg's line takes the knee's axis
        # along, so that legs raised in any direction bend as hanging ones do.
        axis = rotate(multiply(between(_DOWN, line), about_y(out)), _X)
        thigh_line = _upper_bone(upper, lower, distance, line, np.cross(line, axis))
        shank_line = unit(distance[..., None] * line - upper * thigh_line)
        thigh, shank = (
            multiply(trunk.pelvis, _from_axes(axis, -along))
            for along in (thigh_line, shank_line)
        )
        hanging = multiply(shank, about_x(pose.foot[..., side, 1] + _POINTED_TOES))
        height = (ankles[..., side, 1] - self.ankle_height) / self.scale
        free = pose.lifted[..., side] * np.clip(height / _HANGS_FROM, 0.0, 1.0)
        foot = _blend(feet[..., side, :], hanging, free)
        return {"Hip": trunk.pelvis, "Knee": thigh, "Ankle": shank, "Foot": foot}


def _third_side(a: float, b: float, flexion: float) -> float:
    """Return the distance between the ends of two bones flexed [rad] at their joint."""
    return float(np.sqrt(a * a + b * b + 2.0 * a * b * np.cos(flexion)))


def _upper_bone(
    upper: float, lower: float, distance: Array, line: Array, toward: Array
) -> Array:
    """Return the upper bone's direction, for ends ``distance`` apart, (..., 3)."""
    cosine = (upper**2 + distance**2 - lower**2) / (2.0 * upper * distance)
    sine = np.sqrt(np.maximum(1.0 - cosine**2, 0.0))
    return np.asarray(cosine[..., None] * line + sine[..., None] * toward)


def _from_axes(x: Array, y: Array) -> Array:
    return wxyz_from_matrix(np.stack([x, y, np.cross(x, y)], axis=-1))


def _blend(a: Array, b: Array, weight: Array) -> Array:
    b = b * np.where(np.sum(a * b, axis=-1, keepdims=True) < 0.0, -1.0, 1.0)
    return normalize(a + weight[..., None] * (b - a))


def _bend(angles: Array) -> Array:
    turn = multiply(about_x(angles[..., 0]), about_z(-angles[..., 1]))
    return multiply(turn, about_y(angles[..., 2]))


def _collarbone_angles(along: Array) -> tuple[Array, Array]:
    """Return elevation and protraction [rad] of the left collarbone, (...) each.

    It follows the unit vector along the left upper arm, thorax frame, (..., 3), after
    the shoulder rhythm of Inman et al. 1944 (J. Bone Joint Surg. 26), by guessed
    amounts.
    """
    elevation = np.arccos(np.minimum(np.maximum(-along[..., 1], -1.0), 1.0)) / np.pi
    lift = np.radians(-7.0 + 32.0 * elevation**1.5)
    inward = np.maximum(-along[..., 0], 0.0)
    forward = np.radians(11.0) * along[..., 2] + np.radians(8.0) * inward
    return lift, forward


def _collarbone_end(along: Array) -> Array:
    lift, forward = _collarbone_angles(along)
    flat = np.cos(lift)
    parts = (flat * np.cos(forward), np.sin(lift), flat * np.sin(forward))
    return np.stack(parts, axis=-1)
