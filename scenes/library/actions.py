"""Scripted motions of the whole body on the spot: squats, kicks, sitting down."""

import numpy as np

from .poses import BOTH, LEFT, RIGHT, Pose, Rng, Score
from .puppet import Puppet
from .stances import ON_HIPS, alternating, by_name


def _arms_for_balance(puppet: Puppet, pose: Pose, rng: Rng, style: int) -> Pose:
    """Place the arms as people do in squats: forward, hips, hanging, folded, wide."""
    for side in (LEFT, RIGHT):
        arms = (
            puppet.arm(rng.uniform(1.2, 1.7), 1.45, 0.2, 0.15),
            puppet.reach(side, ON_HIPS, (1.0, 0.1, -0.6)),
            puppet.arm(0.25, 0.9, 0.3, 0.4),
            puppet.reach(side, (0.03, -0.12, 0.26), (0.9, -0.8, 0.1)),
            puppet.arm(rng.uniform(0.8, 1.5), 0.1, 0.0, 0.2),
        )
        pose = pose.with_arm(side, arms[style])
    return pose


def _squat(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    u = rng.uniform
    style, out = int(rng.integers(5)), u(0.0, 0.25)
    score = Score(base).hold(0.4)
    while score.duration < length:
        depth = u(0.2, 0.58)
        low = _arms_for_balance(puppet, base, rng, style)
        low = low.leaning(drop=depth * puppet.leg, back=0.4 * depth * puppet.leg)
        low = low.leaning(pelvis=0.6 * depth, spine=u(0.5, 1.1) * depth)
        low = low.leaning(head=-0.5 * depth).with_foot(BOTH, knee_out=out)
        score.to(u(0.9, 1.6), low).hold(u(0.05, 0.4))
        score.to(u(0.8, 1.4), base).hold(u(0.1, 0.4))
    return score


def _stoop(puppet: Puppet, pose: Pose, rng: Rng, depth: float) -> Pose:
    """Bend down to a depth in [0, 1], partly by bending the knees."""
    knees = rng.uniform(0.1, 0.9) * depth
    return pose.leaning(
        drop=0.45 * knees * puppet.leg,
        back=(0.09 * depth + 0.08 * knees) * puppet.scale,
        pelvis=depth * (1.0 - 0.5 * knees) * rng.uniform(0.7, 1.0),
        spine=depth * (1.0 - 0.4 * knees) * rng.uniform(0.5, 0.9),
        head=0.1 * depth,
    )


def _bend(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    score, u = Score(base).hold(0.3), rng.uniform
    while score.duration < length:
        kind = rng.choice(["forward", "forward", "side", "back", "twist"])
        style = int(rng.choice([1, 2, 3, 4]))
        pose = base if style == 2 else _arms_for_balance(puppet, base, rng, style)
        sign = rng.choice([-1.0, 1.0])
        if kind == "forward":
            pose = _stoop(puppet, base, rng, u(0.5, 1.15))
            for side in (LEFT, RIGHT):
                goal = pose.ankle[side] + np.array([0.05, u(0.1, 0.4), 0.2])
                pose = puppet.put_hand_world(pose, side, goal, (0.8, 0.1, 0.3))
        elif kind == "side":
            lean = sign * u(0.25, 0.6)
            pose = pose.leaning(side=-0.06 * lean, pelvis=(0.0, 0.0, 0.2 * lean))
            pose = pose.leaning(spine=(0.05, lean, 0.0))
        elif kind == "back":
            lean = u(0.15, 0.4)
            pose = pose.leaning(back=-0.1 * lean, pelvis=-0.3 * lean, spine=-lean)
        else:
            turn = sign * u(0.3, 0.8)
            pose = pose.leaning(pelvis=(0.3 * turn, 0.0, 0.0), spine=(0.05, 0.0, turn))
            pose = pose.leaning(head=(0.0, 0.0, 0.4 * turn))
        score.to(u(0.9, 1.6), pose).hold(u(0.1, 0.4))
        score.to(u(0.9, 1.5), base).hold(u(0.1, 0.4))
    return score


def _pick_up(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    score, u = Score(base).hold(0.3), rng.uniform
    elbow_to = (1.0, 0.2, -0.2)
    while score.duration < length:
        low = _stoop(puppet, base, rng, u(0.9, 1.15))
        hold = base.leaning(spine=-0.05)
        half, one = u(0.1, 0.2), int(rng.integers(2))
        sides = [LEFT, RIGHT] if rng.random() < 0.7 else [one]
        height = u(0.15, 0.45) * puppet.scale
        ready = low.leaning(drop=-0.03, spine=-0.1)
        carry = (half, u(-0.4, -0.2), u(0.26, 0.36))
        for side in sides:
            x = (1.0 - 2.0 * side) * half * puppet.scale
            spot = np.array([x, height, u(0.32, 0.4) * puppet.scale])
            low = puppet.put_hand_world(low, side, spot, elbow_to)
            above = spot + np.array([0.3 * x, 0.1, 0.0])
            ready = puppet.put_hand_world(ready, side, above, elbow_to)
            hold = puppet.put_hand(hold, side, carry, (0.4, -1.0, -0.3))
        score.to(u(0.8, 1.3), ready).to(u(0.3, 0.6), low)
        score.hold(0.15).to(u(0.9, 1.4), hold).hold(u(0.3, 0.8))
        score.to(u(0.8, 1.3), low).to(u(0.8, 1.2), base)
    return score


def _sit(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    score, u = Score(base).hold(0.3), rng.uniform
    seat = u(0.5, 0.58) * puppet.scale  # of the root above the floor
    drop, back = base.root[1] - seat, u(0.38, 0.44) * puppet.scale
    while score.duration < length:
        lean, folded = u(0.5, 0.9), rng.random() < 0.3
        sitting = base.leaning(drop=drop, back=back, pelvis=-0.08, spine=0.12)
        midway = base.leaning(drop=0.45 * drop, back=0.62 * back)
        midway = midway.leaning(pelvis=0.55 * lean, spine=0.6 * lean, head=-0.3 * lean)
        for side in (LEFT, RIGHT):
            lap = (u(0.1, 0.16), u(-0.36, -0.3), 0.32)
            if folded:
                lap = (-0.13, -0.2 - 0.05 * side, 0.22 + 0.07 * side)
            sitting = puppet.put_hand(sitting, side, lap, (0.8, -1.0, -0.1))
            midway = midway.with_arm(side, puppet.arm(u(0.4, 1.0), 1.3, 0.3, 0.5))
        score.to(u(0.7, 1.0), midway).to(u(0.5, 0.8), sitting)
        for _ in range(rng.integers(1, 4)):
            shift = tuple(0.06 * rng.normal(size=3))
            score.to(u(0.6, 1.0), sitting.leaning(spine=shift, head=shift))
        score.to(u(0.5, 0.8), midway).to(u(0.6, 0.9), base).hold(u(0.1, 0.5))
    return score


def _over(pose: Pose, side: int) -> Pose:
    sign, pose = 1.0 - 2.0 * side, pose.over(side, 0.8)
    return pose.leaning(pelvis=(0.0, 0.0, -0.05 * sign), spine=(0.0, 0.08 * sign, 0.0))


def _kick(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    u = rng.uniform
    for side in (LEFT, RIGHT):
        guard = (u(0.1, 0.16), u(-0.2, 0.0), 0.28)
        base = puppet.put_hand(base, side, guard, (0.5, -1.0, 0.0))
    sideways = rng.random() < 0.4
    score = Score(base).hold(0.3)
    for side in alternating(score, rng, length, 0.7):
        height, sign = u(0.9, 1.6), 1.0 - 2.0 * side
        tall = _over(base, 1 - side)
        if sideways:
            aim, fold = (0.2, 0.85 * height), (0.9, 0.5 * height)
            kick = tall.leaning(pelvis=(-0.3 * sign, 0.0, -0.4 * sign))
            kick = kick.leaning(spine=(0.0, -0.15 * sign, 0.0))
        else:
            aim, fold = (height, 0.05), (min(height, 1.3), 0.1)
            kick = tall.leaning(back=0.04, pelvis=(-0.25 * sign, -0.2, 0.0))
            kick = kick.leaning(spine=(0.25, 0.0, 0.1 * sign))
        chamber = puppet.swing_leg(tall, side, *fold, u(1.4, 1.9))
        out = puppet.swing_leg(kick, side, *aim, u(0.1, 0.3))
        quick = u(0.2, 0.35)
        score.to(u(0.35, 0.6), chamber).to(quick, out).to(quick, chamber)
        score.to(u(0.35, 0.6), base).hold(u(0.15, 0.5))
    return score


def _raise_leg(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    u = rng.uniform
    if rng.random() < 0.6:
        base = _arms_for_balance(puppet, base, rng, int(rng.choice([1, 4])))
    side, kind = int(rng.integers(2)), rng.choice(["front", "knee", "side", "back"])
    score = Score(base).hold(0.4)
    while score.duration < length:
        side = 1 - side if rng.random() < 0.4 else side
        top, sign = u(0.5, 1.0), 1.0 - 2.0 * side
        flexion, abduction, knee = {
            "front": (1.3 * top, 0.05, u(0.05, 0.3)),
            "knee": (1.7 * top, 0.05, 1.6 * top),
            "side": (0.05, 0.9 * top, 0.1),
            "back": (-0.45 * top, 0.05, u(0.1, 1.2)),
        }[kind]
        tall = _over(base, 1 - side)
        if kind == "back":
            tall = tall.leaning(pelvis=0.2 * top)
        if kind == "side":
            tall = tall.leaning(pelvis=(0, 0, -0.15 * top * sign))
        up = puppet.swing_leg(tall, side, flexion, abduction, knee)
        score.to(u(0.7, 1.3), up).hold(u(0.1, 0.5))
        score.to(u(0.7, 1.2), base).hold(u(0.2, 0.5))
    return score


def _lunge(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    u = rng.uniform
    style, lateral = int(rng.choice([1, 2, 3])), rng.random() < 0.4
    base = _arms_for_balance(puppet, base, rng, style)
    score = Score(base).hold(0.3)
    for side in alternating(score, rng, length, 0.5):
        reach, depth = u(0.55, 0.8), u(0.12, 0.34)
        sign = 1.0 - 2.0 * side
        by = np.array([sign * reach, 0, 0.03] if lateral else [0.0, 0.0, reach])
        step = by * puppet.leg
        landed = base.with_foot(side, ankle=base.ankle[side] + step)
        high = base.ankle[side] + 0.5 * step + np.array([0.0, 0.12 * puppet.scale, 0.0])
        air = base.with_foot(side, ankle=high, heel=0.2)
        air = air.leaning(side=0.5 * float(step[0]), back=-0.5 * float(step[2]))
        air = air.over(1 - side, 0.5)
        if lateral:
            low = landed.leaning(drop=depth * puppet.leg, back=0.12 * puppet.scale)
            low = low.leaning(side=0.72 * by[0] * puppet.leg, pelvis=0.3, spine=0.35)
            low = low.with_foot(side, yaw=sign * 0.25)
        else:
            drop, back = (0.1 + depth) * puppet.leg, -0.55 * by[2] * puppet.leg
            low = landed.leaning(drop=drop, back=back, spine=u(0.0, 0.3))
            low = low.with_foot(1 - side, heel=u(0.7, 0.95))
        score.to(u(0.4, 0.6), air).to(u(0.6, 0.9), low)
        score.hold(u(0.1, 0.5)).to(u(0.6, 0.8), air)
        score.to(u(0.4, 0.6), base).hold(u(0.2, 0.4))
    return score


def _step_over(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    """Step over a hurdle and back, hands on the hips or arms hanging."""
    u = rng.uniform
    base = _arms_for_balance(puppet, base, rng, int(rng.choice([1, 2])))
    side = int(rng.integers(2))
    score = Score(base).hold(0.3)
    while score.duration < length:
        tall, knee = _over(base, 1 - side), u(1.3, 1.9)
        up = puppet.swing_leg(tall, side, u(1.1, 1.6), 0.1, knee)
        by = np.array([0.0, 0.0, u(0.3, 0.45) * puppet.leg])
        touch = tall.with_foot(side, ankle=tall.ankle[side] + by)
        touch = touch.leaning(back=-0.1, drop=0.02 * puppet.leg)
        score.to(u(0.7, 1.0), up).to(u(0.5, 0.8), touch).hold(0.15)
        score.to(u(0.5, 0.8), up).to(u(0.7, 1.0), base).hold(u(0.2, 0.5))
        side = 1 - side if rng.random() < 0.5 else side
    return score


def _dodge(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    u, base = rng.uniform, base.leaning(drop=0.05 * puppet.scale)
    for side in (LEFT, RIGHT):
        goal = (u(0.08, 0.18), u(-0.2, 0.02), 0.27)
        base = puppet.put_hand(base, side, goal, (0.7, -1.0, 0.0))
    score = Score(base).hold(0.3)
    while score.duration < length:
        sign, low = rng.choice([-1.0, 1.0]), u(0.05, 0.35)
        back = rng.random() < 0.25
        lean = u(0.25, 0.55)
        pose = base.leaning(drop=low * puppet.leg, back=0.05 + 0.08 * low)
        pose = pose.leaning(pelvis=(-0.2 * sign, 0.2 * low, 0.0))
        pose = pose.leaning(spine=(0.0, 0.0, 0.2 * sign), head=(-0.1, -0.2 * sign, 0.0))
        if back:
            pose = pose.leaning(spine=-0.3)
        else:
            pose = pose.leaning(side=0.14 * sign * puppet.scale)
            pose = pose.leaning(pelvis=(0.0, 0.0, 0.12 * sign))
            pose = pose.leaning(spine=(0.9 * low, lean * sign, 0.0))
        score.to(u(0.28, 0.5), pose).hold(u(0.05, 0.2))
        score.to(u(0.4, 0.7), base).hold(u(0.05, 0.5))
    return score


ACTIONS = by_name(
    _bend, _dodge, _kick, _lunge, _pick_up, _raise_leg, _sit, _squat, _step_over
)
"""Motions of the whole body on the spot, by name."""
