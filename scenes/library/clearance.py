"""Keeps scripted hands and forearms out of head, trunk, legs, floor and each other.

A script says where a hand goes, not what is in its way. Where a forearm or hand would
be inside another part by more than soft tissue gives, the hand is moved out by the
shortest way, and the arm follows.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter1d, maximum_filter1d

from kinefilter.characters import Skeleton
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import continuous, inverse, normalize, rotate
from kinefilter.characters.skeleton import SIDES

from .poses import LEFT, RIGHT, Pose
from .puppet import Puppet

_TISSUE = 0.01  # m that two parts may overlap: skin and clothes give way
_BLURS, _ROUNDS = 2, 3  # how often an arm is moved and then made smooth
_SMOOTHING = 0.1  # s, standard deviation of the blur of the way out
_MOST_STRETCHED = 2.0  # ways out that turn round cancel in the blur: not made good
_UP = np.array([0.0, 1.0, 0.0])
_SHARES = np.linspace(0.25, 1.0, 4)  # places on forearm and hand that are looked at
_LEGS = ("Knee", "Ankle")
_FOREARM = ("Wrist", "Hand")


def clear_arms(puppet: Puppet, pose: Pose, fps: float) -> Pose:
    """Return a motion whose hands and forearms are outside of the other parts.

    Args:
        puppet: Who moves.
        pose: The motion, with one leading axis of frames.
        fps: Frames per second.
    """
    for _ in range(_BLURS):
        scripted = pose
        for _ in range(_ROUNDS):
            positions = puppet.solve(pose)[1]
            pushes = [
                _smooth(_way_out(puppet, positions, side), fps)
                for side in (LEFT, RIGHT)
            ]
            if not any(push.any() for push in pushes):
                break
            for side, push in enumerate(pushes):
                if push.any():
                    pose = _pushed(puppet, pose, positions, side, push)
        pose = _without_jerks(scripted, pose, fps)
    return pose


def _way_out(puppet: Puppet, positions: Array, side: int) -> Array:
    """Return the vector [m] that brings an arm out of what it is deepest in, (T, 3)."""
    body, index = puppet.body, puppet.body.skeleton.index
    elbow, wrist, hand = (
        positions[:, index(part + SIDES[side])] for part in ("Elbow", "Wrist", "Hand")
    )
    shares = _SHARES[:, None, None]
    points = np.concatenate(
        [elbow + shares * (wrist - elbow), wrist + shares * (hand - wrist)]
    )
    ends = [index(part + SIDES[side]) for part in _FOREARM]
    radii = np.repeat(body.radii[ends], len(_SHARES))[:, None]
    each = np.arange(len(positions))
    deepest = (radii - points[..., 1]).max(axis=0).clip(min=0.0)
    out = deepest[:, None] * _UP
    for end, share in _obstacles(body.skeleton, side):
        away = _from_axis(body.skeleton, positions, end, points)
        distance = np.sqrt(np.einsum("ptk,ptk->pt", away, away))
        depth = radii + body.radii[end] - _TISSUE - distance
        worst = depth.argmax(axis=0)
        deep = depth[worst, each]
        if not (deep > deepest).any():
            continue
        way = away[worst, each] / np.maximum(distance[worst, each], 1e-6)[:, None]
        # Deep inside, the shortest way turns round from frame to frame; up does not.
        if share == 1.0:
            way = way + (deep / (radii.max() + body.radii[end]))[:, None] * _UP
        way = way / np.maximum(np.linalg.norm(way, axis=-1, keepdims=True), 1e-6)
        out = np.where((deep > deepest)[:, None], share * deep[:, None] * way, out)
        deepest = np.maximum(deep, deepest)
    return np.asarray(out)


def _obstacles(skeleton: Skeleton, side: int) -> list[tuple[int, float]]:
    """Return the parts an arm stays out of, and its share of the way they go apart.

    A part is named by the joint it ends at; the two arms share the way.
    """
    trunk = skeleton.up_from(skeleton.index("Head"))
    legs = [j for part in _LEGS for j in skeleton.sides(part)]
    other = [skeleton.index(part + SIDES[1 - side]) for part in ("Elbow", *_FOREARM)]
    return [(end, 1.0) for end in trunk + legs] + [(end, 0.5) for end in other]


def _from_axis(skeleton: Skeleton, positions: Array, end: int, points: Array) -> Array:
    """Return the vectors [m] from a part's axis to points (P, T, 3), likewise."""
    start = positions[:, skeleton.parents[end]]
    axis = positions[:, end] - start
    gap = points - start
    along = np.einsum("ptk,tk->pt", gap, axis) / np.einsum("tk,tk->t", axis, axis)
    return np.asarray(gap - np.minimum(np.maximum(along, 0.0), 1.0)[..., None] * axis)


def _smooth(push: Array, fps: float) -> Array:
    """Spread a way out over time, at least as long as it was where it was needed."""
    length = np.linalg.norm(push, axis=1)
    if not length.any():
        return push
    width = max(1, round(_SMOOTHING * fps))
    longest = maximum_filter1d(length, 4 * width + 1)
    longest = gaussian_filter1d(longest, width, radius=2 * width)
    way = gaussian_filter1d(push, width, axis=0, radius=6 * width)
    norm = np.maximum(np.linalg.norm(way, axis=1), 1e-12)
    return np.asarray(way * np.minimum(longest / norm, _MOST_STRETCHED)[:, None])


def _pushed(
    puppet: Puppet, pose: Pose, positions: Array, side: int, push: Array
) -> Pose:
    """Return the motion with one hand moved by ``push`` [m], the elbow as it was."""
    index = puppet.body.skeleton.index
    shoulder, elbow, wrist = (
        positions[:, index(part + SIDES[side])]
        for part in ("Shoulder", "Elbow", "Wrist")
    )
    fore = wrist - elbow
    fore = fore * (puppet.forearm(side) / np.linalg.norm(fore, axis=1))[:, None]
    pole = elbow - (shoulder + wrist) / 2.0
    pole = rotate(inverse(puppet.trunk(pose).thorax), pole)
    pole = pole * np.array([1.0 - 2.0 * side, 1.0, 1.0]) + [1e-3, -1e-3, 0.0]
    arm, bend = puppet.reach_world(pose, side, elbow + fore + push, pole)
    moved = np.any(push != 0.0, axis=1)
    arms, elbows = pose.arm.copy(), pose.elbow.copy()
    arms[moved, side], elbows[moved, side] = arm[moved], bend[moved]
    return replace(pose, arm=arms, elbow=elbows)


def _without_jerks(before: Pose, after: Pose, fps: float) -> Pose:
    """Blur arms over time where they were moved."""
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
