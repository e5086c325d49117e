"""Scripted motions with a thing in hand or under the body; the thing is imagined.

One for each scene of Shum et al. 2013, table II: a box to lift, a flip chart, a
basketball, a chair, an office desk. The hands are where the thing would be.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .poses import BOTH, LEFT, RIGHT, Pose, Rng, Score
from .puppet import Puppet
from .stances import Script

_DOWN = (0.7, -1.0, -0.1)


def _crouch(puppet: Puppet, pose: Pose, knees: float, bend: float) -> Pose:
    """Go down by ``knees`` (share of leg length) and a bend of the trunk [rad]."""
    pose = pose.leaning(
        drop=knees * puppet.leg,
        back=0.3 * knees * puppet.leg + 0.08 * bend * puppet.scale,
    )
    return pose.leaning(pelvis=0.5 * bend, spine=0.5 * bend, head=-0.25 * bend)


def _gripped(puppet: Puppet, pose: Pose, half: float, height: float) -> Pose:
    """Put the hands at both sides of a box on the floor, lengths [m]."""
    for side in (LEFT, RIGHT):
        x, forward = (1.0 - 2.0 * side) * half, 0.36 * puppet.scale
        spot = np.array([x, height, float(pose.ankle[:, 2].mean()) + forward])
        arm = puppet.reach_world(pose, side, spot, (1.0, 0.2, -0.2))
        pose = pose.with_arm(side, arm)
    return pose


def _lift_box(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    """Lift a box from the floor, hold it, turn, shelve it or look, put it down."""
    score = Score(base).hold(0.2)
    for side in (LEFT, RIGHT):
        base = base.with_foot(side, knee_out=rng.uniform(0.05, 0.3))
    while score.duration < length:
        half = rng.uniform(0.12, 0.26) * puppet.scale
        grip = rng.uniform(0.16, 0.45) * puppet.scale
        share = rng.uniform(0.0, 1.0)  # 0: from the back, 1: from the knees
        low = _crouch(puppet, base, 0.12 + 0.4 * share, 1.35 - 0.6 * share)
        low = _gripped(puppet, low, half, grip)
        near = np.array([half / puppet.scale, rng.uniform(-0.42, -0.15), 0.33])
        score.to(rng.uniform(0.9, 1.4), low).hold(0.15)
        hold = puppet.reach_both(base.leaning(spine=-0.08), near, _DOWN)
        score.to(rng.uniform(0.9, 1.4), hold).hold(rng.uniform(0.2, 0.6))
        for _ in range(rng.integers(1, 3)):
            turn = rng.uniform(-0.5, 0.5)
            spot = near + np.array([0.0, rng.uniform(-0.1, 0.45), rng.uniform(0, 0.15)])
            other = base.leaning(
                pelvis=(0.5 * turn, 0, 0),
                spine=(rng.uniform(-0.1, 0.25), 0.0, 0.6 * turn),
            )
            score.to(0.9, puppet.reach_both(other, spot, _DOWN)).hold(0.2)
        score.to(0.9, hold).to(rng.uniform(0.9, 1.4), low).hold(0.1)
        score.to(rng.uniform(0.8, 1.3), base)
    return score


def _flip_chart(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    """Point at a chart beside the body, and turn its sheet over the top."""
    side = int(rng.integers(2))
    way = 1.0 - 2.0 * side
    toward = base.leaning(
        pelvis=(0.25 * way, 0.02, 0.0),
        spine=(0.05, 0.0, 0.25 * way),
        head=(0.0, 0.0, 0.35 * way),
    )
    score, distance = Score(base).hold(0.2), rng.uniform(0.42, 0.55)
    while score.duration < length:
        for _ in range(rng.integers(1, 4)):
            spot = (rng.uniform(0.05, 0.4), rng.uniform(-0.25, 0.35), distance)
            pose = toward.leaning(spine=tuple(0.06 * rng.normal(size=3)))
            arm = puppet.reach(side, spot, (0.8, -1.0, -0.1))
            score.to(rng.uniform(0.5, 0.9), pose.with_arm(side, arm)).hold(0.2)
        hands = [side] if rng.random() < 0.6 else [LEFT, RIGHT]
        low = toward.leaning(drop=0.03 * puppet.leg, spine=(0.15, 0.0, 0.1 * way))
        track = [(low, -0.3, distance), (toward, 0.1, distance - 0.05)]
        track += [(toward, 0.5, 0.35), (toward, 0.4, 0.5)]
        for pose, up, forward in track:
            for hand in hands:
                out = 0.22 if hand == side else 0.05
                pose = puppet.put_hand(pose, hand, (out, up, forward), (0.9, -0.8, 0.1))
            score.to(rng.uniform(0.4, 0.7), pose)
        score.to(0.8, base).hold(rng.uniform(0.1, 0.4))
    return score


def _basketball(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    """Dribble low or high with either hand, catch the ball and shoot."""
    score, side = Score(base).hold(0.2), int(rng.integers(2))
    while score.duration < length:
        side = 1 - side if rng.random() < 0.5 else side
        low = rng.uniform(0.05, 0.25)
        pose = _crouch(puppet, base, low, rng.uniform(0.2, 0.7))
        pose = pose.leaning(head=(-0.2, 0.0, rng.normal(0.0, 0.3)))
        pose = pose.with_arm(1 - side, puppet.arm(rng.uniform(0.4, 1.1), 0.8, 0.3, 1.1))
        out, pace = rng.uniform(0.18, 0.32), rng.uniform(0.2, 0.32)
        for beat in range(2 * int(rng.integers(3, 6))):
            up = -0.24 if beat % 2 == 0 else -0.44
            spot = np.array([out, up, 0.32 - 0.04 * (beat % 2)]) + rng.normal(
                0, 0.015, 3
            )
            sink = pose.leaning(drop=0.02 * (beat % 2) * puppet.scale)
            arm = puppet.reach(side, spot, (0.7, -0.5, -0.8))
            score.to(pace if beat else 0.6, sink.with_arm(side, arm))
        if rng.random() < 0.6:
            _shoot(puppet, score, rng, base, side)
        score.to(0.6, base).hold(rng.uniform(0.05, 0.3))
    return score


def _shoot(puppet: Puppet, score: Score, rng: Rng, base: Pose, side: int) -> None:
    """Dip with the ball at the belly, raise it to the brow, stretch up on the toes."""
    dip = _crouch(puppet, base, rng.uniform(0.12, 0.3), 0.4)
    dip = puppet.reach_both(dip, np.array([0.1, -0.32, 0.3]), _DOWN)
    brow = _crouch(puppet, base, 0.1, 0.1)
    brow = puppet.put_hand(brow, side, (0.06, 0.22, 0.26), (0.5, -1.0, 0.5))
    guide = puppet.reach(1 - side, (0.1, 0.2, 0.24), (0.8, -1.0, 0.4))
    brow = brow.with_arm(1 - side, guide)
    out = base.leaning(drop=-0.2, spine=-0.08, head=-0.25)
    for foot in (LEFT, RIGHT):
        out = out.with_foot(foot, heel=rng.uniform(0.4, 0.7))
    out = puppet.put_hand(out, side, (0.12, 0.52, 0.4), (0.6, -0.6, 0.3))
    guide = puppet.reach(1 - side, (0.14, 0.42, 0.3), (0.9, -0.6, 0.3))
    out = out.with_arm(1 - side, guide)
    score.to(0.6, dip).to(0.45, brow).to(0.3, out).hold(rng.uniform(0.1, 0.4))


@dataclass(frozen=True, eq=False)
class _Seat:
    """How one person sits down on a chair."""

    way: Pose
    """Halfway down, leaning forward over the feet."""
    seated: Pose
    """On the chair, the hands on the thighs."""

    def sit(self, score: Score, rng: Rng) -> None:
        """Sit down."""
        score.to(rng.uniform(0.7, 1.0), self.way)
        score.to(rng.uniform(0.5, 0.8), self.seated)

    def stand(self, score: Score, rng: Rng, base: Pose) -> Score:
        """Stand up."""
        score.to(rng.uniform(0.5, 0.9), self.seated)
        score.to(rng.uniform(0.5, 0.8), self.way)
        return score.to(rng.uniform(0.6, 0.9), base).hold(0.2)


def _seat(puppet: Puppet, rng: Rng, base: Pose, knees: float) -> _Seat:
    seat = rng.uniform(0.49, 0.57) * puppet.scale  # of the root above the floor
    drop, back = base.root[1] - seat, rng.uniform(0.34, 0.43) * puppet.scale
    lean = rng.uniform(0.5, 0.9)
    base = base.with_foot(BOTH, knee_out=knees)
    seated = base.leaning(drop=float(drop), back=back)
    seated = seated.leaning(
        pelvis=rng.uniform(-0.25, 0.05), spine=rng.uniform(0.0, 0.25)
    )
    way = base.leaning(drop=0.5 * float(drop), back=0.65 * back)
    way = way.leaning(pelvis=0.55 * lean, spine=0.6 * lean, head=-0.3 * lean)
    for side in (LEFT, RIGHT):
        lap = (rng.uniform(0.1, 0.17), rng.uniform(-0.37, -0.32), 0.34)
        seated = puppet.put_hand(seated, side, lap, (0.8, -1.0, -0.2))
        arm = puppet.arm(rng.uniform(0.4, 1.0), 1.3, 0.3, 0.5)
        way = way.with_arm(side, arm)
    return _Seat(way, seated)


def _shifted(pose: Pose, rng: Rng, size: float = 1.0) -> Pose:
    """Vary trunk and head of someone who sits."""
    lean, side, turn = size * rng.normal(0.0, (0.12, 0.08, 0.12))
    return pose.leaning(
        pelvis=0.4 * lean,
        spine=(lean, side, turn),
        head=tuple(0.12 * size * rng.normal(size=3)),
    )


def _chair(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    """Sit down on a chair, talk with the hands, stretch a leg, stand up."""
    seat, score = (
        _seat(puppet, rng, base, rng.uniform(-0.05, 0.4)),
        Score(base).hold(0.2),
    )
    seat.sit(score, rng)
    while score.duration < length:
        pose, kind = _shifted(seat.seated, rng), rng.random()
        if kind < 0.5:
            for side in ([LEFT, RIGHT], [LEFT], [RIGHT])[rng.integers(3)]:
                spot = (rng.uniform(0.08, 0.3), rng.uniform(-0.26, 0.1), 0.36)
                pose = puppet.put_hand(pose, side, spot, (0.9, -1.0, -0.1))
        elif kind < 0.65:
            pose = puppet.reach_both(
                pose, np.array([-0.02, -0.15, 0.26]), np.array([1, -1, 0])
            )
        elif kind < 0.8:
            side = int(rng.integers(2))
            air = puppet.swing_leg(pose, side, rng.uniform(1.6, 1.9), 0.1, 0.7)
            score.to(0.7, air)
            out = pose.ankle[side] + np.array([0.0, 0.0, 0.25 * puppet.leg])
            score.to(0.6, pose.with_foot(side, ankle=out)).hold(rng.uniform(0.1, 0.6))
            score.to(0.6, air)
        else:
            elevation, plane = rng.uniform(0.8, 2.4), rng.uniform(-0.1, 0.9)
            pose = pose.with_arm(BOTH, puppet.arm(elevation, plane, -0.8, 0.5))
        score.to(rng.uniform(0.6, 1.1), pose).hold(rng.uniform(0.05, 0.4))
    return seat.stand(score, rng, base)


def _office(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    """Sit at a desk: type, use the mouse, reach for a thing, answer the phone."""
    seat, score = (
        _seat(puppet, rng, base, rng.uniform(-0.05, 0.15)),
        Score(base).hold(0.2),
    )
    seat.sit(score, rng)
    desk = rng.uniform(-0.28, -0.18)  # of the hands below the shoulders' joint, m
    keys = np.array([rng.uniform(0.04, 0.12), desk, rng.uniform(0.34, 0.44)])
    typing = puppet.reach_both(seat.seated, keys, _DOWN)
    while score.duration < length:
        pose, side = _shifted(typing, rng, 0.6), int(rng.integers(2))
        kind = rng.choice(["type", "mouse", "reach", "phone", "back"])
        score.to(rng.uniform(0.6, 1.0), pose)
        if kind == "type":
            for beat in range(rng.integers(4, 9)):
                spot = keys + rng.normal(0.0, (0.02, 0.008, 0.01))
                arm = puppet.reach(beat % 2, spot, _DOWN)
                pose = pose.with_arm(beat % 2, arm)
                score.to(rng.uniform(0.15, 0.25), pose)
            continue
        if kind == "back":
            pose = pose.leaning(pelvis=-0.2, spine=-0.15)
            spot, elbow = np.array([0.1, 0.2, -0.1]), (1.0, 0.3, 0.4)
        elif kind == "phone":
            turn = (1.0 - 2.0 * side) * 0.12
            pose = pose.leaning(head=(0.05, turn, 0.0))
            spot, elbow = np.array([0.13, 0.14, 0.07]), (0.6, -1.0, 0.6)
        else:
            out = rng.uniform(0.25, 0.4) if kind == "mouse" else rng.uniform(0.0, 0.55)
            way = (1.0 - 2.0 * side) * 0.25 * (kind == "reach")
            pose = pose.leaning(spine=(0.3 * (kind == "reach"), -way, way))
            spot = np.array([out, desk + rng.uniform(0, 0.2), rng.uniform(0.36, 0.55)])
            elbow = (0.8, -1.0, -0.2)
        arm = puppet.reach(side, spot, elbow)
        score.to(rng.uniform(0.5, 0.9), pose.with_arm(side, arm))
        score.hold(rng.uniform(0.2, 0.9))
    return seat.stand(score, rng, base)


PROP_MOTIONS: dict[str, Script] = {
    "basketball": _basketball,
    "chair": _chair,
    "flip_chart": _flip_chart,
    "lift_box": _lift_box,
    "office": _office,
}
"""Motions with a thing, by name."""
