"""Scripted sports and arts: tai chi, golf, dance, jumps, rolling hands, bent legs."""

from dataclasses import replace

import numpy as np

from kinefilter.characters.anthropometry import GRAVITY

from .poses import BOTH, LEFT, RIGHT, Pose, Rng, Score
from .puppet import Puppet
from .stances import alternating, by_name, draw_fault, draw_hold

_Goal = tuple[float, float, float]
_ELBOW_DOWN = (0.7, -1.0, -0.1)

# Hands in named tai chi forms: (leading hand, other hand), each outward, up and forward
# of the joint between the shoulders [m] on a body of 1.75 m.
_TAI_CHI: dict[str, tuple[_Goal, _Goal]] = {
    "hold the ball": ((0.02, -0.1, 0.34), (0.02, -0.38, 0.32)),
    "part the mane": ((0.18, 0.02, 0.52), (0.24, -0.46, 0.08)),
    "brush knee and push": ((0.1, -0.06, 0.55), (0.3, -0.45, 0.12)),
    "white crane": ((0.22, 0.16, 0.36), (0.25, -0.44, 0.1)),
    "single whip": ((0.3, 0.0, 0.48), (0.62, 0.0, 0.12)),
    "cloud hands": ((-0.02, 0.0, 0.42), (0.1, -0.4, 0.3)),
    "push": ((0.12, -0.06, 0.56), (0.12, -0.06, 0.56)),
    "ward off": ((-0.02, -0.06, 0.42), (0.12, -0.26, 0.34)),
    "raise hands": ((0.18, -0.04, 0.58), (0.18, -0.04, 0.58)),
}


def _tai_chi(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    """Perform slow forms on bent knees while the weight moves from foot to foot."""
    score, u = Score(base).hold(0.2), rng.uniform
    forward = u(0.0, 0.45) * puppet.leg
    lead = int(rng.integers(2))
    if forward > 0.15 * puppet.leg:
        spot = base.ankle[lead] + np.array([0.0, 0.0, forward])
        shift = 0.6 * float(base.ankle[1 - lead, 0] - base.root[0])
        air = base.leaning(drop=0.08 * puppet.leg, side=shift)
        score.to(0.8, air.stepping(lead, spot, 0.08 * puppet.scale))
        base = base.with_foot(lead, ankle=spot, heel=0.0)
    middle = base.ankle.mean(axis=0)
    forms = list(_TAI_CHI.values())
    while score.duration < length:
        goals = forms[int(rng.integers(len(forms)))]
        main, weight = int(rng.integers(2)), u(-0.35, 0.35)
        over = middle + weight * (base.ankle[lead] - base.ankle[1 - lead])
        turn = (2.0 * main - 1.0) * u(-0.2, 0.5)
        pose = base.leaning(drop=u(0.06, 0.25) * puppet.leg)
        side, back = float(over[0] - base.root[0]), float(base.root[2] - over[2])
        pose = pose.leaning(side=side, back=back, pelvis=(0.5 * turn, 0.08, 0.0))
        pose = pose.leaning(spine=(u(-0.05, 0.15), 0.0, 0.5 * turn))
        for hand, goal in ((main, goals[0]), (1 - main, goals[1])):
            spot = np.array(goal) + rng.normal(0.0, 0.05, 3)
            spot[0] = max(spot[0], -0.02)
            pose = puppet.put_hand(pose, hand, spot, _ELBOW_DOWN)
        score.to(u(0.9, 1.5), pose).hold(u(0.0, 0.2))
    return score


def _golf_swing(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    """Swing a club: address, backswing, downswing, follow-through.

    Sequence and turns after Hume et al. 2005, Sports Med. 35(5): the shoulders turn
    about twice as far as the pelvis, and the downswing takes a quarter of a second.
    """
    trail = int(rng.integers(2))  # the side of the backswing
    away, tilt = 1.0 - 2.0 * trail, rng.uniform(0.3, 0.5)
    base = base.leaning(drop=0.06 * puppet.leg)
    stance = base.leaning(back=0.06, pelvis=tilt, spine=(0.25, -0.05 * away, 0.0))
    address = _club(puppet, stance, trail, 0.0, -0.54, 0.36)
    score = Score(base).hold(0.2).to(0.9, address).hold(rng.uniform(0.2, 0.5))
    while score.duration < length:
        size = rng.uniform(0.5, 1.0)
        keys = (  # time, shoulders, pelvis, hands across, up, forward, weight
            (0.4, 0.35, 0.15, 0.22, -0.42, 0.42, 0.3),
            (0.4, 0.75, 0.45, 0.38, 0.14 * size, 0.36, 0.6),
            (0.15, 0.4, 0.1, 0.28, -0.3, 0.42, 0.0),
            (0.1, 0.0, -0.35, 0.0, -0.56, 0.36, -0.4),
            (0.12, -0.35, -0.6, -0.26, -0.36, 0.44, -0.7),
            (0.3, -0.75, -0.9, -0.36, 0.16 * size, 0.32, -1.0),
        )
        for seconds, shoulders, pelvis, across, up, forward, weight in keys:
            turn, rise = away * size, max(-weight, 0.0)
            pose = stance.leaning(
                side=0.05 * weight * turn * puppet.scale,
                pelvis=(pelvis * turn, -0.25 * rise * tilt, 0.0),
                spine=(-0.15 * rise, 0.0, (shoulders - pelvis) * turn),
                head=(0.1, 0.0, -0.6 * shoulders * turn * (weight > -0.8)),
            )
            heel = 0.7 * max(-weight - 0.2, 0.0) * size
            pose = pose.with_foot(trail, heel=heel, knee_out=0.0)
            score.to(seconds, _club(puppet, pose, trail, across * size, up, forward))
        score.hold(rng.uniform(0.2, 0.5)).to(0.9, address).hold(0.2)
    return score.to(0.8, base)


def _club(
    puppet: Puppet, pose: Pose, trail: int, across: float, up: float, forward: float
) -> Pose:
    """Put both hands on a grip ``across`` to the trailing side [m]."""
    elbows = (0.8, -1.0, 0.0)
    pose = puppet.put_hand(pose, trail, (across + 0.02, up - 0.03, forward), elbows)
    goal = (-across + 0.02, up + 0.03, forward)
    return puppet.put_hand(pose, 1 - trail, goal, elbows)


def _roll_hands(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    """Roll the hands about each other in front of the chest, tall or long circles."""
    score, u = Score(base).hold(0.2), rng.uniform
    while score.duration < length:
        pose, sign = base.leaning(spine=u(-0.05, 0.2)), rng.choice([-1, 1])
        center = np.array([0.05, u(-0.3, -0.08), u(0.3, 0.36)])
        reach = np.array([0.0, u(0.06, 0.16), u(0.05, 0.09)])
        if rng.random() < 0.5:
            reach = np.array([0.0, u(0.06, 0.08), u(0.08, 0.13)])
            center[2] += 0.06
        pace, flare = u(0.09, 0.16), u(-0.9, -0.1)
        for beat in range(8 * int(rng.integers(2, 5))):
            for side in (LEFT, RIGHT):
                phase = sign * np.pi / 4.0 * beat + np.pi * side
                spot = center + reach * [0.0, np.sin(phase), np.cos(phase)]
                pose = puppet.put_hand(pose, side, spot, (1.0, flare, -0.1))
            score.to(pace if beat else 0.8, pose)
    return score.to(0.8, base)


def _bend_leg(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    """Bend one leg: the heel to the seat, the knee to the chest, or in between."""
    u = rng.uniform
    hold = draw_hold(rng, "hips", "hanging", "wide", "forward", "folded", "stick")
    ready = hold.put(puppet, base, draw_fault(rng))
    score = Score(base).hold(0.2).to(0.7, ready)
    for side in alternating(score, rng, length, 0.5):
        fault = draw_fault(rng)
        flexion = rng.choice([u(-0.25, 0.4), u(0.6, 1.8)])
        knee = u(1.0, 2.2) if flexion < 0.5 else u(0.9, 2.2)
        tall = hold.put(puppet, fault.bend(puppet, ready, 0.6), fault)
        tall = tall.over(1 - side, 0.8)
        up = puppet.swing_leg(tall, side, flexion, u(0.0, 0.35), knee)
        score.to(u(0.6, 1.1), up).hold(u(0.05, 0.4))
        score.to(u(0.6, 1.1), ready).hold(u(0.1, 0.4))
    return score.to(0.7, base)


# Classical arm positions: (elevation, plane, rotation, elbow) [rad] of each arm.
_ROUND_LOW = (0.45, 1.1, 0.5, 0.6)
_ROUND_FRONT = (1.15, 1.15, 0.7, 0.9)
_ROUND_HIGH = (2.55, 0.6, -0.8, 0.6)
_SIDE = (1.4, 0.2, 0.0, 0.25)
_AHEAD = (1.55, 1.35, 0.1, 0.15)
_BEHIND = (0.75, -0.9, 0.0, 0.2)
_PORT_DE_BRAS = (
    (_ROUND_LOW, _ROUND_LOW),
    (_ROUND_FRONT, _ROUND_FRONT),
    (_SIDE, _SIDE),
    (_ROUND_FRONT, _SIDE),
    (_ROUND_HIGH, _SIDE),
    (_ROUND_HIGH, _ROUND_FRONT),
    (_ROUND_HIGH, _ROUND_HIGH),
    (_AHEAD, _SIDE),
    (_AHEAD, _BEHIND),
)
_LEGS = ("front", "side", "back", "passe")


def _danced(puppet: Puppet, pose: Pose, rng: Rng) -> Pose:
    arms = _PORT_DE_BRAS[int(rng.integers(len(_PORT_DE_BRAS)))]
    first = int(rng.integers(2))
    for side, angles in ((first, arms[0]), (1 - first, arms[1])):
        elevation, plane, rotation, elbow = angles + rng.normal(0.0, 0.14, 4)
        elevation, elbow = np.clip(elevation, 0.2, 2.8), max(elbow, 0.05)
        pose = pose.with_arm(side, puppet.arm(elevation, plane, rotation, elbow))
    lean, turn = rng.normal(0.0, 0.2, 2)
    pose = pose.leaning(spine=(rng.normal(0.0, 0.15), lean, turn))
    return pose.leaning(head=(rng.normal(-0.05, 0.15), 0.0, rng.normal(0.0, 0.3)))


def _dance(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    """Dance classical positions: plies, legs to all sides, turned trunks, rises."""
    score, u = Score(base).hold(0.1), rng.uniform
    while score.duration < length:
        pose = _danced(puppet, base, rng)
        kind = rng.choice([*_LEGS, *_LEGS, "plie", "rise", "step", "step", "step"])
        side = int(rng.integers(2))
        if kind == "plie":
            depth = u(0.1, 0.58)
            back = u(0.1, 0.4) * depth * puppet.leg
            pose = pose.leaning(drop=depth * puppet.leg, back=back)
            pose = pose.leaning(pelvis=u(0.0, 0.8) * depth)
            pose = pose.with_foot(BOTH, knee_out=u(0.1, 0.9, 2))
        elif kind == "rise":
            pose = pose.leaning(drop=-0.2).with_foot(BOTH, heel=u(0.4, 0.8))
        elif kind == "step":
            pose, air = _dance_step(puppet, pose, rng, side)
            score.to(0.45, air)
        else:
            pose = _dance_leg(puppet, pose, rng, side, str(kind))
        score.to(u(0.45, 0.8), pose).hold(u(0.0, 0.2))
        if kind == "step":
            score.to(0.45, air)
        score.to(u(0.4, 0.6), _danced(puppet, base, rng))
    return score.to(0.6, base)


def _dance_leg(puppet: Puppet, pose: Pose, rng: Rng, side: int, kind: str) -> Pose:
    top, sign = rng.uniform(0.3, 1.15), 1.0 - 2.0 * side
    flexion, abduction, knee = {
        "front": (1.5 * top, 0.15, 0.1),
        "side": (0.5 * top, 0.75 * top, 0.1),
        "back": (-0.45 * top, 0.1, rng.choice([0.1, 1.0])),
        "passe": (1.2 * top, 0.5, 1.9 * top),
    }[kind]
    sink = rng.uniform(0.0, 0.14) * puppet.leg
    pose = pose.over(1 - side, 0.8).leaning(drop=sink, back=0.3 * sink)
    if kind == "back":  # an arabesque: the trunk tips as the leg rises
        tip = rng.uniform(0.1, 1.2) * top
        pose = pose.leaning(pelvis=tip, spine=-0.5 * tip, back=0.1 * tip)
    if kind == "side":
        pose = pose.leaning(pelvis=(0.0, 0.0, -0.25 * top * sign))
    return puppet.swing_leg(pose, side, flexion, abduction, knee)


def _dance_step(puppet: Puppet, pose: Pose, rng: Rng, side: int) -> tuple[Pose, Pose]:
    """Return a long step onto a bent knee, the other leg straight, and its midpoint."""
    u, sign = rng.uniform, 1.0 - 2.0 * side
    heading = u(-0.4, 1.6)
    size = u(0.4, 1.05) * puppet.leg
    by = size * np.array([sign * np.sin(heading), 0.0, np.cos(heading)])
    air = pose.over(1 - side, 0.5)
    air = air.stepping(side, pose.ankle[side] + by, 0.1 * puppet.scale)
    share, lean = u(0.35, 0.8), rng.normal(0.05, 0.2)
    pose = pose.with_foot(side, ankle=pose.ankle[side] + by)
    pose = pose.with_foot(1 - side, heel=u(0.2, 1.0))
    pose = pose.leaning(drop=u(0.04, 0.3) * puppet.leg, side=share * float(by[0]))
    pose = pose.leaning(back=-share * float(by[2]))
    return pose.leaning(pelvis=(rng.normal(0.0, 0.3), lean, 0.0)), air


def _jump(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    """Jump on the spot: squat, swing the arms, fly ballistically, land softly."""
    score, u = Score(base).hold(0.3), rng.uniform
    while score.duration < length:
        high, tuck = u(0.06, 0.35), u(0.0, 0.9)
        split = u(-0.9, 0.9) if rng.random() < 0.5 else 0.0
        swing, spread = u(0.3, 2.2), u(0.3, 1.5)
        low = base.leaning(drop=u(0.15, 0.35) * puppet.leg, back=0.05)
        low = low.leaning(pelvis=0.35, spine=0.35, head=-0.3)
        land = low.leaning(drop=-0.1 * puppet.leg)
        land = land.with_arm(BOTH, puppet.arm(1.0, spread, 0.0, 0.5))
        low = low.with_arm(BOTH, puppet.arm(0.6, -1.2, 0.0, 0.3))
        off = base.leaning(drop=-0.2).with_foot(BOTH, heel=0.7)
        off = off.with_arm(BOTH, puppet.arm(swing, spread, -0.3 * swing, 0.4))
        off = replace(off, root=puppet.trunk(off).root)
        top = off.leaning(drop=-high)
        for side in (LEFT, RIGHT):
            flexion = np.clip(0.9 * tuck + split * (1.0 - 2.0 * side), -0.4, 1.6)
            top = puppet.swing_leg(top, side, flexion, 0.1, 1.5 * tuck + 0.15)
        half = float(np.sqrt(2.0 * high / GRAVITY))
        score.to(0.7, low).to(0.4, off).to(half, top).to(half, off)
        score.to(0.25, land).to(0.6, base).hold(u(0.1, 0.4))
    return score


SPORTS = by_name(_bend_leg, _dance, _golf_swing, _jump, _roll_hands, _tai_chi)
"""Sports and arts, by name."""
