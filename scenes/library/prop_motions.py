"""Scripted motions with imaginary objects, for the scenes of Shum 2013, table II."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import about_y, rotate

from .poses import BOTH, LEFT, RIGHT, Pose, Rng, Score
from .puppet import Puppet
from .stances import Script, alternating, by_name

_DOWN = (0.7, -1.0, -0.1)


def _crouch(puppet: Puppet, pose: Pose, knees: float, bend: float) -> Pose:
    """Go down by ``knees`` (share of leg length) and bend the trunk [rad]."""
    back = 0.3 * knees * puppet.leg + 0.08 * bend * puppet.scale
    pose = pose.leaning(drop=knees * puppet.leg, back=back)
    return pose.leaning(pelvis=0.5 * bend, spine=0.5 * bend, head=-0.25 * bend)


def _lift_box(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    """Lift a box from the floor, hold it, turn or shelve it, and set it down."""
    score, u = Score(base).hold(0.2), rng.uniform
    base = base.with_foot(BOTH, knee_out=u(0.05, 0.3, 2))
    while score.duration < length:
        half, grip = u(0.12, 0.26) * puppet.scale, u(0.16, 0.45) * puppet.scale
        share = u(0.0, 1.0)  # 0: from the back, 1: from the knees
        low = _crouch(puppet, base, 0.12 + 0.4 * share, 1.35 - 0.6 * share)
        ahead = float(low.ankle[:, 2].mean()) + 0.36 * puppet.scale
        for side, x in ((LEFT, half), (RIGHT, -half)):
            low = puppet.put_hand_world(low, side, (x, grip, ahead), (1.0, 0.2, -0.2))
        near = np.array([half / puppet.scale, u(-0.42, -0.15), 0.33])
        score.to(u(0.9, 1.4), low).hold(0.15)
        hold = puppet.reach_both(base.leaning(spine=-0.08), near, _DOWN)
        score.to(u(0.9, 1.4), hold).hold(u(0.2, 0.6))
        for _ in range(rng.integers(1, 3)):
            turn = u(-0.5, 0.5)
            spot = near + np.array([0.0, u(-0.1, 0.45), u(0.0, 0.15)])
            other = base.leaning(pelvis=(0.5 * turn, 0.0, 0.0))
            other = other.leaning(spine=(u(-0.1, 0.25), 0.0, 0.6 * turn))
            score.to(0.9, puppet.reach_both(other, spot, _DOWN)).hold(0.2)
        score.to(0.9, hold).to(u(0.9, 1.4), low).hold(0.1).to(u(0.8, 1.3), base)
    return score


def _store_box(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    """Lift a box from the floor, step to a low table on the right, and put it there."""
    score, u = Score(base).hold(0.2), rng.uniform
    base = base.with_foot(BOTH, knee_out=u(0.05, 0.3, 2))
    half, grip = u(0.14, 0.24) * puppet.scale, u(0.16, 0.35) * puppet.scale
    low = _crouch(puppet, base, u(0.15, 0.35), u(0.8, 1.2))
    ahead = float(low.ankle[:, 2].mean()) + u(0.34, 0.42) * puppet.scale
    for side, x in ((LEFT, half), (RIGHT, -half)):
        low = puppet.put_hand_world(low, side, (x, grip, ahead), (1.0, 0.2, -0.2))
    near = np.array([half / puppet.scale, u(-0.42, -0.3), 0.33])
    hold = puppet.reach_both(base.leaning(spine=-0.08), near, _DOWN)
    score.to(u(0.9, 1.4), low).hold(0.2).to(u(0.9, 1.4), hold).hold(u(0.2, 0.5))
    # Two steps of each foot, the right one first.
    pose, turn, way = hold, -u(1.1, 1.3), np.array([-0.36, 0.0, 0.2])
    center = base.ankle.mean(axis=0)
    for step in range(4):
        side, share = (RIGHT, LEFT)[step % 2], (step // 2 + 1) / 2.0
        heading = rotate(about_y(share * turn), base.ankle[side] - center)
        spot = center + share * way + heading
        to = base.root + (step + 1) / 4.0 * way
        pelvis = base.pelvis + np.array([(step + 1) / 4.0 * turn, 0.0, 0.0])
        air = pose.stepping(side, spot, 0.06 * puppet.scale)
        middle = 0.5 * (pose.root + to)
        score.to(u(0.28, 0.4), replace(air, root=middle, pelvis=pelvis))
        pose = pose.with_foot(side, ankle=spot, yaw=share * turn, heel=0.0)
        pose = replace(pose, root=to, pelvis=pelvis)
        score.to(u(0.28, 0.4), pose)
    score.hold(u(0.1, 0.3))
    # As high as the table and a hand on the side of a box on it.
    table, across = pose.root + 0.48 * puppet.scale * _ahead(turn), _ahead(turn + 1.57)
    table[1] = u(0.55, 0.68)
    put = _crouch(puppet, pose, 0.1, 0.0)
    bend = replace(put, spine=put.spine + np.array([u(0.35, 0.5), 0.0, 0.0]))
    for side, sign in ((LEFT, 1.0), (RIGHT, -1.0)):
        place = table + sign * half * across
        bend = puppet.put_hand_world(bend, side, place, (1.0, 0.2, -0.2))
    score.to(u(0.9, 1.3), bend).hold(0.25)
    rest = replace(pose, arm=base.arm, elbow=base.elbow, spine=base.spine)
    return score.to(u(0.8, 1.2), rest).hold(max(length - score.duration, 0.3))


def _dribble(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    """Pick up a ball ahead on the right, dribble it with one hand, and catch it."""
    score, u = Score(base).hold(0.2), rng.uniform
    base = base.with_foot(BOTH, knee_out=u(0.05, 0.3, 2))
    half, grip = u(0.14, 0.19), u(0.12, 0.22)
    low = _crouch(puppet, base, u(0.4, 0.5), u(0.9, 1.2))
    low = low.leaning(pelvis=(-0.3, 0.0, 0.0), spine=(0.0, 0.0, -0.3))
    ball = np.array([u(-0.4, -0.2), grip, u(0.35, 0.5)])
    for side, x in ((LEFT, half), (RIGHT, -half)):
        low = puppet.put_hand_world(low, side, ball + x * _ahead(1.1), (1.0, 0.2, -0.2))
    belly = np.array([half / puppet.scale, u(-0.38, -0.3), 0.36])
    hold = puppet.reach_both(base.leaning(spine=-0.08), belly, _DOWN)
    score.to(u(0.9, 1.4), low).hold(0.2).to(u(0.9, 1.4), hold).hold(u(0.2, 0.5))
    while score.duration < length - 1.0:
        side = int(rng.integers(2))
        pose = _crouch(puppet, base, u(0.05, 0.25), u(0.2, 0.6))
        pose = pose.with_arm(1 - side, puppet.arm(u(0.4, 1.1), 0.8, 0.3, 1.1))
        out, pace = u(0.18, 0.32), u(0.24, 0.36)
        for beat in range(2 * int(rng.integers(6, 11))):
            up, forward = (-0.46, 0.34) if beat % 2 else (-0.24, 0.36)
            spot = np.array([out, up, forward]) + rng.normal(0.0, 0.015, 3)
            sink = pose.leaning(drop=0.02 * (beat % 2) * puppet.scale)
            sink = puppet.put_hand(sink, side, spot, (0.7, -0.5, -0.8))
            score.to(pace if beat else 0.6, sink)
        score.to(u(0.5, 0.7), hold).hold(u(0.3, 0.6))
    return score.hold(max(length - score.duration, 0.3))


def _ahead(yaw: float) -> Array:
    return np.array([np.sin(yaw), 0.0, np.cos(yaw)])


def _flip_chart(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    """Point at a chart beside the body, and turn its sheet over the top."""
    u, side = rng.uniform, int(rng.integers(2))
    sign = 1.0 - 2.0 * side
    toward = base.leaning(pelvis=(0.25 * sign, 0.02, 0.0))
    toward = toward.leaning(spine=(0.05, 0, 0.25 * sign), head=(0, 0, 0.35 * sign))
    score, distance = Score(base).hold(0.2), u(0.42, 0.55)
    while score.duration < length:
        for _ in range(rng.integers(1, 4)):
            spot = (u(0.05, 0.4), u(-0.25, 0.35), distance)
            pose = toward.leaning(spine=tuple(0.06 * rng.normal(size=3)))
            pose = puppet.put_hand(pose, side, spot, (0.8, -1.0, -0.1))
            score.to(u(0.5, 0.9), pose).hold(0.2)
        hands = [side] if rng.random() < 0.6 else [LEFT, RIGHT]
        low = toward.leaning(drop=0.03 * puppet.leg, spine=(0.15, 0.0, 0.1 * sign))
        track = [(low, -0.3, distance), (toward, 0.1, distance - 0.05)]
        track += [(toward, 0.5, 0.35), (toward, 0.4, 0.5)]
        for pose, up, forward in track:
            for hand in hands:
                out = 0.22 if hand == side else 0.05
                pose = puppet.put_hand(pose, hand, (out, up, forward), (0.9, -0.8, 0.1))
            score.to(u(0.4, 0.7), pose)
        score.to(0.8, base).hold(u(0.1, 0.4))
    return score


def _basketball(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    """Dribble low or high with either hand, catch the ball and shoot."""
    score, u = Score(base).hold(0.2), rng.uniform
    for side in alternating(score, rng, length, 0.5):
        pose = _crouch(puppet, base, u(0.05, 0.25), u(0.2, 0.7))
        pose = pose.leaning(head=(-0.2, 0.0, rng.normal(0.0, 0.3)))
        pose = pose.with_arm(1 - side, puppet.arm(u(0.4, 1.1), 0.8, 0.3, 1.1))
        out, pace = u(0.18, 0.32), u(0.2, 0.32)
        for beat in range(2 * int(rng.integers(3, 6))):
            up, forward = (-0.44, 0.28) if beat % 2 else (-0.24, 0.32)
            spot = np.array([out, up, forward]) + rng.normal(0.0, 0.015, 3)
            sink = pose.leaning(drop=0.02 * (beat % 2) * puppet.scale)
            sink = puppet.put_hand(sink, side, spot, (0.7, -0.5, -0.8))
            score.to(pace if beat else 0.6, sink)
        if rng.random() < 0.6:
            _shoot(puppet, score, rng, base, side)
        score.to(0.6, base).hold(u(0.05, 0.3))
    return score


def _shoot(puppet: Puppet, score: Score, rng: Rng, base: Pose, side: int) -> None:
    """Dip with the ball at the belly, raise it to the brow, stretch up on the toes."""
    dip = _crouch(puppet, base, rng.uniform(0.12, 0.3), 0.4)
    dip = puppet.reach_both(dip, (0.1, -0.32, 0.3), _DOWN)
    brow = _crouch(puppet, base, 0.1, 0.1)
    brow = puppet.put_hand(brow, side, (0.06, 0.22, 0.26), (0.5, -1.0, 0.5))
    brow = puppet.put_hand(brow, 1 - side, (0.1, 0.2, 0.24), (0.8, -1.0, 0.4))
    out = base.leaning(drop=-0.2, spine=-0.08, head=-0.25)
    out = out.with_foot(BOTH, heel=rng.uniform(0.4, 0.7, 2))
    out = puppet.put_hand(out, side, (0.12, 0.52, 0.4), (0.6, -0.6, 0.3))
    out = puppet.put_hand(out, 1 - side, (0.14, 0.42, 0.3), (0.9, -0.6, 0.3))
    score.to(0.6, dip).to(0.45, brow).to(0.3, out).hold(rng.uniform(0.1, 0.4))


class _Seat(NamedTuple):
    """Poses of one person sitting down on a chair."""

    midway: Pose  # leaning forward over the feet
    seated: Pose  # with the hands on the thighs

    def sit(self, score: Score, rng: Rng) -> None:
        score.to(rng.uniform(0.7, 1.0), self.midway)
        score.to(rng.uniform(0.5, 0.8), self.seated)

    def stand(self, score: Score, rng: Rng, base: Pose) -> Score:
        score.to(rng.uniform(0.5, 0.9), self.seated)
        score.to(rng.uniform(0.5, 0.8), self.midway)
        return score.to(rng.uniform(0.6, 0.9), base).hold(0.2)


def _seat(puppet: Puppet, rng: Rng, base: Pose, knees: float) -> _Seat:
    u = rng.uniform
    seat = u(0.49, 0.57) * puppet.scale  # of the root above the floor
    drop, back = float(base.root[1] - seat), u(0.34, 0.43) * puppet.scale
    lean = u(0.5, 0.9)
    base = base.with_foot(BOTH, knee_out=knees)
    seated = base.leaning(drop=drop, back=back, pelvis=u(-0.25, 0.05))
    seated = seated.leaning(spine=u(0.0, 0.25))
    midway = base.leaning(drop=0.5 * drop, back=0.65 * back)
    midway = midway.leaning(pelvis=0.55 * lean, spine=0.6 * lean, head=-0.3 * lean)
    for side in (LEFT, RIGHT):
        lap = (u(0.1, 0.17), u(-0.37, -0.32), 0.34)
        seated = puppet.put_hand(seated, side, lap, (0.8, -1.0, -0.2))
        midway = midway.with_arm(side, puppet.arm(u(0.4, 1.0), 1.3, 0.3, 0.5))
    return _Seat(midway, seated)


def _shifted(pose: Pose, rng: Rng, size: float = 1.0) -> Pose:
    lean, side, turn = size * rng.normal(0.0, (0.12, 0.08, 0.12))
    head = tuple(0.12 * size * rng.normal(size=3))
    return pose.leaning(pelvis=0.4 * lean, spine=(lean, side, turn), head=head)


def _chair(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    """Sit down on a chair, gesture while talking, stretch a leg, stand up."""
    score, u = Score(base).hold(0.2), rng.uniform
    seat = _seat(puppet, rng, base, u(-0.05, 0.4))
    seat.sit(score, rng)
    while score.duration < length:
        pose, kind = _shifted(seat.seated, rng), rng.random()
        if kind < 0.5:
            for side in ([LEFT, RIGHT], [LEFT], [RIGHT])[rng.integers(3)]:
                spot = (u(0.08, 0.3), u(-0.26, 0.1), 0.36)
                pose = puppet.put_hand(pose, side, spot, (0.9, -1.0, -0.1))
        elif kind < 0.65:
            pose = puppet.reach_both(pose, (-0.02, -0.15, 0.26), (1.0, -1.0, 0.0))
        elif kind < 0.8:
            side = int(rng.integers(2))
            air = puppet.swing_leg(pose, side, u(1.6, 1.9), 0.1, 0.7)
            out = pose.ankle[side] + np.array([0.0, 0.0, 0.25 * puppet.leg])
            score.to(0.7, air).to(0.6, pose.with_foot(side, ankle=out))
            score.hold(u(0.1, 0.6)).to(0.6, air)
        else:
            pose = pose.with_arm(BOTH, puppet.arm(u(0.8, 2.4), u(-0.1, 0.9), -0.8, 0.5))
        score.to(u(0.6, 1.1), pose).hold(u(0.05, 0.4))
    return seat.stand(score, rng, base)


def _office(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    """Sit at a desk: type, use the mouse, reach for an object, answer the phone."""
    score, u = Score(base).hold(0.2), rng.uniform
    seat = _seat(puppet, rng, base, u(-0.05, 0.15))
    seat.sit(score, rng)
    desk = u(-0.28, -0.18)  # m: height of the hands relative to the shoulders' joint
    keys = np.array([u(0.04, 0.12), desk, u(0.34, 0.44)])
    typing = puppet.reach_both(seat.seated, keys, _DOWN)
    while score.duration < length:
        pose, side = _shifted(typing, rng, 0.6), int(rng.integers(2))
        sign = 1.0 - 2.0 * side
        kind = rng.choice(["type", "mouse", "reach", "phone", "back"])
        score.to(u(0.6, 1.0), pose)
        if kind == "type":
            for beat in range(rng.integers(4, 9)):
                spot = keys + rng.normal(0.0, (0.02, 0.008, 0.01))
                pose = puppet.put_hand(pose, beat % 2, spot, _DOWN)
                score.to(u(0.15, 0.25), pose)
            continue
        if kind == "back":
            pose = pose.leaning(pelvis=-0.2, spine=-0.15)
            spot, elbow_to = np.array([0.1, 0.2, -0.1]), (1.0, 0.3, 0.4)
        elif kind == "phone":
            pose = pose.leaning(head=(0.05, sign * 0.12, 0.0))
            spot, elbow_to = np.array([0.13, 0.14, 0.07]), (0.6, -1.0, 0.6)
        else:
            out = u(0.25, 0.4) if kind == "mouse" else u(0.0, 0.55)
            if kind == "reach":
                pose = pose.leaning(spine=(0.3, -0.25 * sign, 0.25 * sign))
            spot = np.array([out, desk + u(0.0, 0.2), u(0.36, 0.55)])
            elbow_to = (0.8, -1.0, -0.2)
        score.to(u(0.5, 0.9), puppet.put_hand(pose, side, spot, elbow_to))
        score.hold(u(0.2, 0.9))
    return seat.stand(score, rng, base)


PROP_MOTIONS = by_name(_basketball, _chair, _flip_chart, _lift_box, _office)
"""Motions with an imaginary object, by name."""

TASKS: dict[str, Script] = {"dribble": _dribble, "store_box": _store_box}
"""For one scene each, and never learned from."""
