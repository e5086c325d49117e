"""Scripted motions of the upper body while the feet stay planted."""

import numpy as np

from kinefilter.characters.arrays import Array

from .poses import LEFT, RIGHT, Pose, Rng, Score
from .puppet import Puppet
from .stances import alternating, by_name, hanging_arm

_DOWN_OUT = (0.6, -1.0, -0.1)


def _varied(pose: Pose, rng: Rng, size: float = 1.0) -> Pose:
    return pose.leaning(
        side=0.015 * size * rng.normal(),
        spine=tuple(0.04 * size * rng.normal(size=3)),
        head=tuple(0.1 * size * rng.normal(size=3)),
    )


def _one_or_both(rng: Rng) -> list[int]:
    return [[LEFT], [RIGHT], [LEFT, RIGHT]][rng.integers(3)]


def _wave(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    score, u = Score(base).hold(0.4), rng.uniform
    while score.duration < length:
        sides, pace = _one_or_both(rng), u(0.22, 0.42)
        elevation, plane = u(0.9, 2.3), u(0.0, 0.7)
        elbow, swing = u(0.6, 1.6), u(0.2, 0.45)
        pose = _varied(base, rng)
        for beat in range(rng.integers(4, 9)):
            turn = -1.45 + (-1) ** beat * swing * u(0.7, 1.1)
            bend = elbow - (-1) ** beat * 0.5 * swing
            for side in sides:
                pose = pose.with_arm(side, puppet.arm(elevation, plane, turn, bend))
            score.to(pace if beat else u(0.6, 0.9), pose)
        score.to(u(0.6, 1.0), base).hold(u(0.1, 0.6))
    return score


def _point(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    score, u = Score(base).hold(0.3), rng.uniform
    while score.duration < length:
        side = int(rng.integers(2))
        plane = u(-0.2, 2.0)
        toward = (1.0 - 2.0 * side) * (np.pi / 2.0 - plane)
        pose = base.leaning(spine=(0.05, 0, 0.25 * toward), head=(0, 0, 0.5 * toward))
        elevation = u(0.9, 2.2)
        aim = puppet.arm(elevation, plane, u(0.2, 0.9), u(0.05, 0.4))
        score.to(u(0.5, 1.0), pose.with_arm(side, aim))
        nudge = puppet.arm(elevation + rng.normal(0, 0.15), plane, 0.4, 0.15)
        score.to(u(0.4, 1.0), _varied(pose, rng, 0.5).with_arm(side, nudge))
        if rng.random() < 0.6:
            score.to(u(0.6, 1.0), base).hold(u(0.1, 0.5))
    return score


def _scratch(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    score, u = Score(base).hold(0.3), rng.uniform
    while score.duration < length:
        side = int(rng.integers(2))
        pose = _varied(base, rng)
        if rng.random() < 0.55:  # the head, else the other upper arm
            goal = np.array([u(0.09, 0.15), u(0.17, 0.32), 0.03])
            elbow_to, rub = (1.0, u(-0.6, 0.3), 0.6), (0.02, 0.03, 0.02)
            pose = pose.leaning(head=0.15)
        else:
            goal = np.array([-0.17, u(-0.32, -0.12), 0.2])
            elbow_to, rub = (0.7, -1.0, 0.2), (0.01, 0.04, 0.01)
            pose = pose.with_arm(1 - side, puppet.arm(0.3, 1.2, 0.5, 0.8))
        pace = u(0.18, 0.3)
        for beat in range(rng.integers(4, 9)):
            spot = goal + (-1) ** beat * np.array(rub) * u(0.5, 1.2)
            seconds = pace if beat else u(0.7, 1.1)
            score.to(seconds, puppet.put_hand(pose, side, spot, elbow_to))
        score.to(u(0.7, 1.1), base).hold(u(0.1, 0.5))
    return score


def _clap(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    score, u = Score(base).hold(0.3), rng.uniform
    height, forward = u(-0.25, 0.1), u(0.3, 0.42)
    overhead, flare = rng.random() < 0.25, u(0.3, 1.0)
    elbows = (flare, 0.3 if overhead else -0.9, 0.1)
    while score.duration < length:
        gap, pace = u(0.12, 0.35), u(0.16, 0.32)
        pose = _varied(base, rng)
        if overhead:
            height, forward = u(0.42, 0.5), 0.12
        for beat in range(2 * rng.integers(3, 6)):
            apart = 0.04 if beat % 2 else gap * u(0.8, 1.1)
            goal = (apart, height + rng.normal(0, 0.01), forward)
            pose = puppet.reach_both(pose, goal, elbows)
            score.to(pace if beat else 0.8, pose)
        if rng.random() < 0.5:
            score.to(0.8, base).hold(u(0.1, 0.6))
    return score


def _cross_arms(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    score, u = Score(base).hold(0.3), rng.uniform
    elbow_to = (0.75, -1.0, 0.25)
    while score.duration < length:
        over = int(rng.integers(2))
        pose, ready = _varied(base, rng), base
        height = u(-0.26, -0.16)
        for side, above, front in ((over, 0.03, 0.25), (1 - over, -0.02, 0.18)):
            pose = puppet.put_hand(pose, side, (-0.14, height + above, front), elbow_to)
            wide = (0.1, height - 0.05, front + 0.1)
            ready = puppet.put_hand(ready, side, wide, elbow_to)
        score.to(u(0.5, 0.8), ready).to(u(0.35, 0.6), pose)
        for _ in range(rng.integers(1, 3)):
            turn = rng.normal(0, 0.15)
            score.to(u(0.7, 1.2), pose.leaning(spine=(0.0, 0.0, turn)))
        score.to(u(0.35, 0.6), ready)
        score.to(u(0.5, 0.8), base).hold(u(0.1, 0.4))
    return score


def _talk(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    score, u = Score(base).hold(0.2), rng.uniform
    calm = (u(0.08, 0.2), u(-0.35, -0.2), u(0.25, 0.35))
    while score.duration < length:
        pose = _varied(base, rng, 1.5)
        for side in _one_or_both(rng):
            goal = np.array(calm) + rng.normal(0.0, (0.09, 0.09, 0.05))
            goal[0] = max(goal[0], 0.06)
            pose = puppet.put_hand(pose, side, goal, _DOWN_OUT)
        score.to(u(0.35, 0.9), pose)
        if rng.random() < 0.15:
            score.to(0.7, base)
    return score


def _stand_idle(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    score, u = Score(base).hold(0.5), rng.uniform
    while score.duration < length:
        weight = rng.normal(0.0, 0.3)
        pose = _varied(base, rng).leaning(side=0.12 * weight * puppet.scale)
        pose = pose.leaning(pelvis=(0, 0, -0.15 * weight), spine=(0, 0.2 * weight, 0))
        for side in (LEFT, RIGHT):
            if rng.random() < 0.45:
                hips = (u(0.17, 0.21), u(-0.5, -0.42), 0.04)
                pose = puppet.put_hand(pose, side, hips, (1.0, 0.1, -0.6))
            else:
                pose = pose.with_arm(side, puppet.arm(*hanging_arm(rng)))
        score.to(u(0.8, 1.3), pose).hold(u(0.2, 1.0))
    return score


def _raise_arms(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    score, u = Score(base).hold(0.4), rng.uniform
    plane = rng.choice([0.0, 0.0, 0.6, 0.6, 1.5, -1.7]) + rng.normal(0.0, 0.08)
    behind, sides, bend = plane < -1.0, _one_or_both(rng), u(0.03, 0.25)
    while score.duration < length:
        top = u(0.5, 0.9) if behind else u(1.3, 2.8)
        pose = _varied(base, rng, 0.6).leaning(spine=0.1 if behind else -0.05)
        turn, low = -0.45 * max(top - 1.0, 0.0), base
        for side in sides:
            pose = pose.with_arm(side, puppet.arm(top, plane, turn, bend))
            low = low.with_arm(side, puppet.arm(0.12, plane, 0.1, bend))
        score.to(0.3, low).to(u(0.8, 1.5), pose).hold(u(0.1, 0.4)).to(u(0.8, 1.5), low)
    return score


def _rotate_arms(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    score, u = Score(base).hold(0.3), rng.uniform
    sides, elevation = _one_or_both(rng), rng.choice([0.12, 0.12, 1.4])
    plane, elbow = u(0.0, 0.3), u(1.35, 1.7)
    inward, outward = (0.75, -0.9) if elevation < 1.0 else (0.7, -1.5)
    while score.duration < length:
        for turn in (0.0, outward * u(0.7, 1.1), inward * u(0.6, 1.0)):
            pose = _varied(base, rng, 0.5)
            for side in sides:
                pose = pose.with_arm(side, puppet.arm(elevation, plane, turn, elbow))
            score.to(u(0.7, 1.2), pose)
    return score


def _reach_up(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    score, u = Score(base).hold(0.3), rng.uniform
    while score.duration < length:
        sides, high = _one_or_both(rng), u(0.4, 0.66)
        lean = 0.0 if len(sides) == 2 else (2.0 * sides[0] - 1.0) * 0.12
        pose = _varied(base, rng)
        pose = pose.leaning(drop=-0.05, spine=(-0.08, lean, 0.0), head=-0.35)
        for side in sides:
            goal = (u(0.05, 0.3), high, u(0.05, 0.45))
            pose = puppet.put_hand(pose, side, goal, (0.7, -0.5, 0.6))
        score.to(u(0.7, 1.2), pose).hold(u(0.1, 0.4))
        score.to(u(0.7, 1.2), base).hold(u(0.05, 0.3))
    return score


def _punch(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    u, base = rng.uniform, base.leaning(drop=0.04 * puppet.scale)
    guard = base
    for side in (LEFT, RIGHT):
        goal = (u(0.07, 0.14), u(-0.08, 0.06), 0.28)
        guard = puppet.put_hand(guard, side, goal, (0.7, -1.0, 0.0))
    score = Score(base).hold(0.2).to(0.7, guard)
    for side in alternating(score, rng, length, 0.75):
        turn = (2.0 * side - 1.0) * u(0.2, 0.55)
        pose = guard.leaning(back=-0.04, pelvis=(0.5 * turn, 0.05, 0.0))
        pose = pose.leaning(spine=(0.1, 0.0, turn), head=(0.0, 0.0, -turn))
        for seconds, fist, elbow_to in _blow(rng):
            score.to(seconds, puppet.put_hand(pose, side, fist, elbow_to))
        score.to(u(0.25, 0.4), _varied(guard, rng, 0.5)).hold(u(0.05, 0.5))
    return score


def _blow(rng: Rng) -> list[tuple[float, tuple[float, ...], tuple[float, ...]]]:
    """Return (duration, hand, elbow direction) of a straight, hook or uppercut."""
    quick, height = rng.uniform(0.16, 0.3), rng.uniform(-0.2, 0.1)
    kind = rng.choice(["straight", "straight", "hook", "upper"])
    if kind == "straight":
        return [(quick, (rng.uniform(-0.02, 0.12), height, 0.75), (1.0, -0.6, 0.0))]
    if kind == "hook":
        up = (0.8, 0.3, -0.3)
        return [(0.22, (0.42, height, 0.25), up), (quick, (-0.02, height, 0.42), up)]
    low = (0.6, -1.0, -0.4)
    return [(0.22, (0.2, -0.4, 0.2), low), (quick, (0.05, 0.08, 0.38), low)]


def _swing(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    """Swing a sword or bat through a cut, mostly with both hands."""
    base = base.leaning(drop=0.05 * puppet.scale)
    main = int(rng.integers(2))
    both = rng.random() < 0.8
    rest = np.array([0.0, -0.3, 0.38])
    score = Score(base).hold(0.2).to(0.8, _grip(puppet, base, main, rest, both))
    while score.duration < length:
        slant, turn = rng.choice([0.0, 0.5, 1.0, -1.0]), rng.uniform(0.2, 0.5)
        height, lower = rng.uniform(0.75, 1.1), 1.0 - 0.6 * (abs(slant) > 0.9)
        for s, seconds in ((0.0, 0.7), (0.35, 0.12), (0.7, 0.12), (1.0, 0.18)):
            sweep = np.cos(np.pi * s)
            forward = 0.16 + 0.26 * np.sin(np.pi * s) + 0.16 * s
            up = -0.1 + 0.42 * sweep * height * lower
            spot = np.array([0.2 * slant * sweep, up, forward])
            side = (1.0 - 2.0 * main) * slant * sweep
            pose = base.leaning(
                pelvis=(0.4 * turn * side, 0.05 + 0.08 * s, 0.0),
                spine=(0.15 * s, 0.0, turn * side),
                head=(0.0, 0.0, -turn * side),
            )
            score.to(seconds, _grip(puppet, pose, main, spot, both))
        score.to(0.6, _grip(puppet, _varied(base, rng), main, rest, both))
        score.hold(rng.uniform(0.1, 0.4))
    return score


def _grip(puppet: Puppet, pose: Pose, main: int, spot: Array, both: bool) -> Pose:
    """Hold a grip at ``spot`` (to the main hand's side, up, forward) [m]."""
    up, elbow_to = np.array([0.02, 0.05, 0.03]), (0.9, -0.8, 0.1)
    pose = puppet.put_hand(pose, main, spot + up, elbow_to)
    if both:
        other = (spot - up) * np.array([-1.0, 1.0, 1.0])
        pose = puppet.put_hand(pose, 1 - main, other, elbow_to)
    return pose


GESTURES = by_name(
    *(_clap, _cross_arms, _point, _punch, _raise_arms, _reach_up, _rotate_arms),
    *(_scratch, _stand_idle, _swing, _talk, _wave),
)
"""Motions of the upper body, by name."""
