"""Clearance of scripted hands and forearms: head, trunk, legs, floor, the other arm.

Where a forearm or hand would penetrate another part by more than soft tissue allows,
the hand is moved out the shortest way, and the arm follows.
"""

from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter1d, maximum_filter1d

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import continuous, inverse, normalize, rotate
from kinefilter.characters.skeleton import SIDES

from .poses import LEFT, RIGHT, Pose
from .puppet import Puppet, Trunk

_TISSUE = 0.01  # m that two parts may overlap: skin and clothes give way
_BLURS, _ROUNDS = 2, 3  # passes of smoothing, and displacements in each pass
_SMOOTHING = 0.1  # s, standard deviation of the blur of the displacements
# Opposite displacements cancel in the blur; it is amplified by at most this factor.
_MOST_STRETCHED = 2.0
_UP = np.array([0.0, 1.0, 0.0])
_SHARES = np.linspace(0.25, 1.0, 4)  # points along forearm and hand that are checked
_LEGS = ("Knee", "Ankle")
_FOREARM = ("Wrist", "Hand")


def clear_arms(puppet: Puppet, pose: Pose, fps: float) -> Pose:
    """Return a motion (one axis of frames) with the arms moved out of other parts."""
    trunk, turns = puppet.without_arms(pose)
    for _ in range(_BLURS):
        scripted = pose
        for _ in range(_ROUNDS):
            before, positions = pose, puppet.with_arms(pose, trunk, turns)[1]
            for side in (LEFT, RIGHT):
                push = _smooth(_displacement(puppet, positions, side), fps)
                if push.any():
                    pose = _pushed(puppet, pose, trunk, positions, side, push)
            if pose is before:
                break
        pose = _smoothed(scripted, pose, fps)
    return pose


def _displacement(puppet: Puppet, positions: Array, side: int) -> Array:
    """Return the vector [m] that frees an arm from its deepest overlap, (T, 3)."""
    body, index = puppet.body, puppet.body.skeleton.index
    ends = [index(part + SIDES[side]) for part in ("Elbow", *_FOREARM)]
    elbow, wrist, hand = (positions[:, end] for end in ends)
    shares = _SHARES[:, None, None]
    parts = elbow + shares * (wrist - elbow), wrist + shares * (hand - wrist)
    points = np.concatenate(parts)
    radii = np.repeat(body.radii[ends[1:]], len(_SHARES))[:, None]
    frames = np.arange(len(positions))
    deepest = (radii - points[..., 1]).max(axis=0).clip(min=0.0)
    out = deepest[:, None] * _UP
    for end, share in _obstacles(body.skeleton, side):
        away = _from_axis(body.skeleton, positions, end, points)
        distance = np.sqrt(np.einsum("ptk,ptk->pt", away, away))
        depth = radii + body.radii[end] - _TISSUE - distance
        worst = depth.argmax(axis=0)
        deep = depth[worst, frames]
        if not (deep > deepest).any():
            continue
        near = np.maximum(distance[worst, frames], 1e-6)[:, None]
        line = away[worst, frames] / near
        # Deep inside, the shortest way can reverse between frames; add an upward part.
        if share == 1.0:
            line = line + (deep / (radii.max() + body.radii[end]))[:, None] * _UP
        line = line / np.maximum(np.linalg.norm(line, axis=-1, keepdims=True), 1e-6)
        out = np.where((deep > deepest)[:, None], share * deep[:, None] * line, out)
        deepest = np.maximum(deep, deepest)
    return np.asarray(out)


def _obstacles(skeleton: Skeleton, side: int) -> list[tuple[int, float]]:
    trunk = skeleton.ancestors(skeleton.index("Head"))
    legs = [j for part in _LEGS for j in skeleton.sides(part)]
    other = [skeleton.index(part + SIDES[1 - side]) for part in ("Elbow", *_FOREARM)]
    return [(end, 1.0) for end in trunk + legs] + [(end, 0.5) for end in other]


def _from_axis(skeleton: Skeleton, positions: Array, end: int, points: Array) -> Array:
    """Return the vectors [m] from a part's axis to points, both (P, T, 3)."""
    start = positions[:, skeleton.parents[end]]
    axis = positions[:, end] - start
    gap = points - start
    along = np.einsum("ptk,tk->pt", gap, axis) / np.einsum("tk,tk->t", axis, axis)
    return np.asarray(gap - np.minimum(np.maximum(along, 0.0), 1.0)[..., None] * axis)


def _smooth(push: Array, fps: float) -> Array:
    """Spread a displacement over time, keeping its length where it was needed."""
    length = np.linalg.norm(push, axis=1)
    if not length.any():
        return push
    width = max(1, round(_SMOOTHING * fps))
    longest = maximum_filter1d(length, 4 * width + 1)
    longest = gaussian_filter1d(longest, width, radius=2 * width)
    blurred = gaussian_filter1d(push, width, axis=0, radius=6 * width)
    norm = np.maximum(np.linalg.norm(blurred, axis=1), 1e-12)
    return np.asarray(blurred * np.minimum(longest / norm, _MOST_STRETCHED)[:, None])


def _pushed(
    puppet: Puppet, pose: Pose, trunk: Trunk, joints: Array, side: int, push: Array
) -> Pose:
    """Return the motion with one hand moved by ``push`` [m], elbow direction kept."""
    index = puppet.body.skeleton.index
    shoulder, elbow, wrist = (
        joints[:, index(part + SIDES[side])] for part in ("Shoulder", "Elbow", "Wrist")
    )
    fore = wrist - elbow
    fore = fore * (puppet.forearm(side) / np.linalg.norm(fore, axis=1))[:, None]
    pole = elbow - (shoulder + wrist) / 2.0
    pole = rotate(inverse(trunk.thorax), pole)
    pole = pole * np.array([1.0 - 2.0 * side, 1.0, 1.0]) + [1e-3, -1e-3, 0.0]
    arm, bend = puppet.reach_world(trunk, side, elbow + fore + push, pole)
    moved = np.any(push != 0.0, axis=1)
    arms, elbows = pose.arm.copy(), pose.elbow.copy()
    arms[moved, side], elbows[moved, side] = arm[moved], bend[moved]
    return replace(pose, arm=arms, elbow=elbows)


def _smoothed(before: Pose, after: Pose, fps: float) -> Pose:
    width = _SMOOTHING / 2.0 * fps
    moved = np.any(before.arm != after.arm, axis=-1)
    share = gaussian_filter1d(moved.astype(float), width, axis=0)[..., None]
    share = np.where(share > 1e-3, np.minimum(2.0 * share, 1.0), 0.0)
    arms = continuous(after.arm)
    soft = gaussian_filter1d(arms, width, axis=0)
    elbows = gaussian_filter1d(after.elbow, width, axis=0)
    return replace(
        after,
        arm=normalize(arms + share * (soft - arms)),
        elbow=after.elbow + share[..., 0] * (elbows - after.elbow),
    )
