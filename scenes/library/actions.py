"""Scripted motions of the whole body around a place: squats, kicks, sitting."""

from __future__ import annotations

import numpy as np

from kinefilter.characters.arrays import Array

from .poses import BOTH, LEFT, RIGHT, Pose, Rng, Score
from .puppet import Puppet
from .stances import ON_HIPS, Script


def _arms_for_balance(puppet: Puppet, pose: Pose, rng: Rng, style: int) -> Pose:
    """Put the arms where people put them in squats: forward, hips, hanging, folded."""
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
    style, out = int(rng.integers(5)), rng.uniform(0.0, 0.25)
    score = Score(base).hold(0.4)
    while score.duration < length:
        depth = rng.uniform(0.2, 0.58)
        low = _arms_for_balance(puppet, base, rng, style).leaning(
            drop=depth * puppet.leg, back=0.4 * depth * puppet.leg
        )
        low = low.leaning(
            pelvis=0.6 * depth, spine=rng.uniform(0.5, 1.1) * depth, head=-0.5 * depth
        )
        low = low.with_foot(BOTH, knee_out=out)
        score.to(rng.uniform(0.9, 1.6), low).hold(rng.uniform(0.05, 0.4))
        score.to(rng.uniform(0.8, 1.4), base).hold(rng.uniform(0.1, 0.4))
    return score


def _stoop(puppet: Puppet, pose: Pose, rng: Rng, depth: float) -> Pose:
    """Bend to a depth in [0, 1] with a share of knees of one's own."""
    knees = rng.uniform(0.1, 0.9) * depth
    return pose.leaning(
        drop=0.45 * knees * puppet.leg,
        back=(0.09 * depth + 0.08 * knees) * puppet.scale,
        pelvis=depth * (1.0 - 0.5 * knees) * rng.uniform(0.7, 1.0),
        spine=depth * (1.0 - 0.4 * knees) * rng.uniform(0.5, 0.9),
        head=0.1 * depth,
    )


def _bend(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    score = Score(base).hold(0.3)
    while score.duration < length:
        kind = rng.choice(["forward", "forward", "side", "back", "twist"])
        style = int(rng.choice([1, 2, 3, 4]))
        pose = base if style == 2 else _arms_for_balance(puppet, base, rng, style)
        way = rng.choice([-1.0, 1.0])
        if kind == "forward":
            pose = _stoop(puppet, base, rng, rng.uniform(0.5, 1.15))
            for side in (LEFT, RIGHT):
                goal = pose.ankle[side] + np.array([0.05, rng.uniform(0.1, 0.4), 0.2])
                arm = puppet.reach_world(pose, side, goal, (0.8, 0.1, 0.3))
                pose = pose.with_arm(side, arm)
        elif kind == "side":
            lean = way * rng.uniform(0.25, 0.6)
            pose = pose.leaning(
                side=-0.06 * lean, pelvis=(0, 0, 0.2 * lean), spine=(0.05, lean, 0.0)
            )
        elif kind == "back":
            lean = rng.uniform(0.15, 0.4)
            pose = pose.leaning(back=-0.1 * lean, pelvis=-0.3 * lean, spine=-lean)
        else:
            turn = way * rng.uniform(0.3, 0.8)
            pose = pose.leaning(
                pelvis=(0.3 * turn, 0, 0),
                spine=(0.05, 0, turn),
                head=(0, 0, 0.4 * turn),
            )
        score.to(rng.uniform(0.9, 1.6), pose).hold(rng.uniform(0.1, 0.4))
        score.to(rng.uniform(0.9, 1.5), base).hold(rng.uniform(0.1, 0.4))
    return score


def _pick_up(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    score = Score(base).hold(0.3)
    while score.duration < length:
        low = _stoop(puppet, base, rng, rng.uniform(0.9, 1.15))
        hold = base.leaning(spine=-0.05)
        half, one = rng.uniform(0.1, 0.2), int(rng.integers(2))
        sides = [LEFT, RIGHT] if rng.random() < 0.7 else [one]
        height = rng.uniform(0.15, 0.45) * puppet.scale
        ready = low.leaning(drop=-0.03, spine=-0.1)
        carry = (half, rng.uniform(-0.4, -0.2), rng.uniform(0.26, 0.36))
        for side in sides:
            x = (1.0 - 2.0 * side) * half * puppet.scale
            spot = np.array([x, height, rng.uniform(0.32, 0.4) * puppet.scale])
            aim = puppet.reach_world(low, side, spot, (1.0, 0.2, -0.2))
            low = low.with_arm(side, aim)
            spot = spot + np.array([0.3 * x, 0.1, 0.0])
            aim = puppet.reach_world(ready, side, spot, (1.0, 0.2, -0.2))
            ready = ready.with_arm(side, aim)
            hold = puppet.put_hand(hold, side, carry, (0.4, -1.0, -0.3))
        score.to(rng.uniform(0.8, 1.3), ready).to(rng.uniform(0.3, 0.6), low)
        score.hold(0.15).to(rng.uniform(0.9, 1.4), hold).hold(rng.uniform(0.3, 0.8))
        score.to(rng.uniform(0.8, 1.3), low).to(rng.uniform(0.8, 1.2), base)
    return score


def _sit(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    """Sit down on a chair that is not there and stand up again."""
    seat = rng.uniform(0.5, 0.58) * puppet.scale  # of the root above the floor
    drop, back = base.root[1] - seat, rng.uniform(0.38, 0.44) * puppet.scale
    score = Score(base).hold(0.3)
    while score.duration < length:
        lean, folded = rng.uniform(0.5, 0.9), rng.random() < 0.3
        sitting = base.leaning(drop=drop, back=back, pelvis=-0.08, spine=0.12)
        way = base.leaning(drop=0.45 * drop, back=0.62 * back)
        way = way.leaning(pelvis=0.55 * lean, spine=0.6 * lean, head=-0.3 * lean)
        for side in (LEFT, RIGHT):
            lap = (rng.uniform(0.1, 0.16), rng.uniform(-0.36, -0.3), 0.32)
            if folded:
                lap = (-0.13, -0.2 - 0.05 * side, 0.22 + 0.07 * side)
            sitting = puppet.put_hand(sitting, side, lap, (0.8, -1.0, -0.1))
            way = way.with_arm(side, puppet.arm(rng.uniform(0.4, 1.0), 1.3, 0.3, 0.5))
        score.to(rng.uniform(0.7, 1.0), way).to(rng.uniform(0.5, 0.8), sitting)
        for _ in range(rng.integers(1, 4)):
            shift = tuple(0.06 * rng.normal(size=3))
            score.to(rng.uniform(0.6, 1.0), sitting.leaning(spine=shift, head=shift))
        score.to(rng.uniform(0.5, 0.8), way).to(rng.uniform(0.6, 0.9), base)
        score.hold(rng.uniform(0.1, 0.5))
    return score


def _over(pose: Pose, side: int) -> Pose:
    """Shift the weight over the foot of one side."""
    way = 1.0 - 2.0 * side
    return pose.over(side, 0.8).leaning(
        pelvis=(0.0, 0.0, -0.05 * way), spine=(0.0, 0.08 * way, 0.0)
    )


def _kick(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    for side in (LEFT, RIGHT):
        guard = (rng.uniform(0.1, 0.16), rng.uniform(-0.2, 0.0), 0.28)
        base = puppet.put_hand(base, side, guard, (0.5, -1.0, 0.0))
    sideways = rng.random() < 0.4
    side = int(rng.integers(2))
    score = Score(base).hold(0.3)
    while score.duration < length:
        side = 1 - side if rng.random() < 0.7 else side
        height, way = rng.uniform(0.9, 1.6), 1.0 - 2.0 * side
        tall = _over(base, 1 - side)
        if sideways:
            aim, fold = (0.2, 0.85 * height), (0.9, 0.5 * height)
            kick = tall.leaning(
                pelvis=(-0.3 * way, 0.0, -0.4 * way), spine=(0.0, -0.15 * way, 0.0)
            )
        else:
            aim, fold = (height, 0.05), (min(height, 1.3), 0.1)
            kick = tall.leaning(
                back=0.04, pelvis=(-0.25 * way, -0.2, 0.0), spine=(0.25, 0.0, 0.1 * way)
            )
        chamber = puppet.swing_leg(tall, side, *fold, rng.uniform(1.4, 1.9))
        out = puppet.swing_leg(kick, side, *aim, rng.uniform(0.1, 0.3))
        quick = rng.uniform(0.2, 0.35)
        score.to(rng.uniform(0.35, 0.6), chamber).to(quick, out).to(quick, chamber)
        score.to(rng.uniform(0.35, 0.6), base).hold(rng.uniform(0.15, 0.5))
    return score


def _raise_leg(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    if rng.random() < 0.6:
        base = _arms_for_balance(puppet, base, rng, int(rng.choice([1, 4])))
    side, kind = int(rng.integers(2)), rng.choice(["front", "knee", "side", "back"])
    score = Score(base).hold(0.4)
    while score.duration < length:
        side = 1 - side if rng.random() < 0.4 else side
        top, way = rng.uniform(0.5, 1.0), 1.0 - 2.0 * side
        flexion, abduction, knee = {
            "front": (1.3 * top, 0.05, rng.uniform(0.05, 0.3)),
            "knee": (1.7 * top, 0.05, 1.6 * top),
            "side": (0.05, 0.9 * top, 0.1),
            "back": (-0.45 * top, 0.05, rng.uniform(0.1, 1.2)),
        }[kind]
        tall = _over(base, 1 - side)
        if kind == "back":
            tall = tall.leaning(pelvis=0.2 * top)
        if kind == "side":
            tall = tall.leaning(pelvis=(0, 0, -0.15 * top * way))
        up = puppet.swing_leg(tall, side, flexion, abduction, knee)
        score.to(rng.uniform(0.7, 1.3), up).hold(rng.uniform(0.1, 0.5))
        score.to(rng.uniform(0.7, 1.2), base).hold(rng.uniform(0.2, 0.5))
    return score


def _step(pose: Pose, side: int, by: Array, lift: float) -> tuple[Pose, Pose]:
    """Return mid-air and landed pose of one foot that steps ``by`` [m]."""
    landed = pose.with_foot(side, ankle=pose.ankle[side] + by)
    high = pose.ankle[side] + 0.5 * by + np.array([0.0, lift, 0.0])
    air = pose.with_foot(side, ankle=high, heel=0.2)
    return air.leaning(side=0.5 * float(by[0]), back=-0.5 * float(by[2])), landed


def _lunge(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    style, lateral = int(rng.choice([1, 2, 3])), rng.random() < 0.4
    base = _arms_for_balance(puppet, base, rng, style)
    side = int(rng.integers(2))
    score = Score(base).hold(0.3)
    while score.duration < length:
        side = 1 - side if rng.random() < 0.5 else side
        reach, depth = rng.uniform(0.55, 0.8), rng.uniform(0.12, 0.34)
        way = 1.0 - 2.0 * side
        by = np.array([way * reach, 0, 0.03] if lateral else [0.0, 0.0, reach])
        air, landed = _step(base, side, by * puppet.leg, 0.12 * puppet.scale)
        air = air.over(1 - side, 0.5)
        if lateral:
            low = landed.leaning(
                drop=depth * puppet.leg,
                side=0.72 * by[0] * puppet.leg,
                back=0.12 * puppet.scale,
                pelvis=0.3,
                spine=0.35,
            ).with_foot(side, yaw=way * 0.25)
        else:
            low = landed.leaning(
                drop=(0.1 + depth) * puppet.leg,
                back=-0.55 * by[2] * puppet.leg,
                spine=rng.uniform(0.0, 0.3),
            ).with_foot(1 - side, heel=rng.uniform(0.7, 0.95))
        score.to(rng.uniform(0.4, 0.6), air).to(rng.uniform(0.6, 0.9), low)
        score.hold(rng.uniform(0.1, 0.5)).to(rng.uniform(0.6, 0.8), air)
        score.to(rng.uniform(0.4, 0.6), base).hold(rng.uniform(0.2, 0.4))
    return score


def _step_over(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    """Step over a hurdle and back, hands at the hips or across the shoulders."""
    base = _arms_for_balance(puppet, base, rng, int(rng.choice([1, 2])))
    side = int(rng.integers(2))
    score = Score(base).hold(0.3)
    while score.duration < length:
        tall = _over(base, 1 - side)
        knee = rng.uniform(1.3, 1.9)
        up = puppet.swing_leg(tall, side, rng.uniform(1.1, 1.6), 0.1, knee)
        by = np.array([0.0, 0.0, rng.uniform(0.3, 0.45) * puppet.leg])
        touch = _step(tall, side, by, 0.0)[1].leaning(back=-0.1, drop=0.02 * puppet.leg)
        score.to(rng.uniform(0.7, 1.0), up).to(rng.uniform(0.5, 0.8), touch)
        score.hold(0.15).to(rng.uniform(0.5, 0.8), up)
        score.to(rng.uniform(0.7, 1.0), base).hold(rng.uniform(0.2, 0.5))
        side = 1 - side if rng.random() < 0.5 else side
    return score


def _dodge(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    base = base.leaning(drop=0.05 * puppet.scale)
    for side in (LEFT, RIGHT):
        goal = (rng.uniform(0.08, 0.18), rng.uniform(-0.2, 0.02), 0.27)
        base = puppet.put_hand(base, side, goal, (0.7, -1.0, 0.0))
    score = Score(base).hold(0.3)
    while score.duration < length:
        way, low = rng.choice([-1.0, 1.0]), rng.uniform(0.05, 0.35)
        back = rng.random() < 0.25
        lean = rng.uniform(0.25, 0.55)
        pose = base.leaning(
            drop=low * puppet.leg,
            side=0.0 if back else 0.14 * way * puppet.scale,
            back=0.05 + 0.08 * low,
            pelvis=(-0.2 * way, 0.2 * low, 0.0 if back else 0.12 * way),
            spine=(-0.3 if back else 0.9 * low, 0.0 if back else lean * way, 0.2 * way),
            head=(-0.1, -0.2 * way, 0.0),
        )
        score.to(rng.uniform(0.28, 0.5), pose).hold(rng.uniform(0.05, 0.2))
        score.to(rng.uniform(0.4, 0.7), base).hold(rng.uniform(0.05, 0.5))
    return score


ACTIONS: dict[str, Script] = {
    "bend": _bend,
    "dodge": _dodge,
    "kick": _kick,
    "lunge": _lunge,
    "pick_up": _pick_up,
    "raise_leg": _raise_leg,
    "sit": _sit,
    "squat": _squat,
    "step_over": _step_over,
}
"""Motions of the whole body in one place, by name."""
