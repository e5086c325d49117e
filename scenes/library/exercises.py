"""Scripted exercises of physiotherapy, done right and done wrong.

The ten movements of the University of Idaho's set (Vakanski et al. 2018, Data 3(1):2),
in which people lean, twist, shift, stop short, let the knees go inward or the arms
sink; and the four for lymph flow of Chiang et al. 2017 (IEEE EMBC), after their names
and the paper's figure 6.
"""

from collections.abc import Iterator

import numpy as np

from .poses import BOTH, LEFT, RIGHT, Pose, Rng, Score
from .puppet import Puppet
from .stances import ArmHold, Fault, alternating, by_name, draw_fault, draw_hold

_STICKS = (*["stick"] * 4, *["low stick"] * 3, "overhead", "hips", "forward")
_OVERHEAD = (*["overhead"] * 5, "stick", "forward", "wide")


def _begin(
    puppet: Puppet, rng: Rng, base: Pose, holds: tuple[str, ...] = _STICKS
) -> tuple[Score, Pose]:
    ready = draw_hold(rng, *holds).put(puppet, base, draw_fault(rng))
    return Score(base).hold(0.2).to(rng.uniform(0.6, 0.9), ready), ready


def _end(score: Score, rng: Rng, base: Pose) -> Score:
    return score.to(rng.uniform(0.6, 0.9), base).hold(0.2)


def _faulty(
    puppet: Puppet, ready: Pose, hold: ArmHold, fault: Fault, share: float = 1.0
) -> Pose:
    return hold.put(puppet, fault.bend(puppet, ready, share), fault)


def _repeat(score: Score, rng: Rng, peak: Pose, ready: Pose) -> None:
    score.to(rng.uniform(0.8, 1.6), peak).hold(rng.uniform(0.05, 0.4))
    score.to(rng.uniform(0.8, 1.5), ready).hold(rng.uniform(0.05, 0.3))


def _deep_squat(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    score, _ = _begin(puppet, rng, base, _OVERHEAD)
    while score.duration < length:
        hold, fault = draw_hold(rng, *_OVERHEAD), draw_fault(rng)
        ready = hold.put(puppet, base, fault)
        depth = rng.uniform(0.45, 0.62) * fault.short
        lean = rng.uniform(0.7, 2.0) * depth
        back = rng.uniform(0.3, 0.55) * depth * puppet.leg
        low = _faulty(puppet, ready, hold, fault)
        low = low.leaning(drop=depth * puppet.leg, back=back)
        low = low.leaning(pelvis=0.6 * lean, spine=0.4 * lean, head=-0.3 * lean)
        _repeat(score, rng, low.with_foot(BOTH, knee_out=fault.knees_out), ready)
    return _end(score, rng, base)


def _leg_by_leg(
    puppet: Puppet, rng: Rng, base: Pose, score: Score, length: float
) -> Iterator[tuple[int, ArmHold, Fault, Pose]]:
    for side in alternating(score, rng, length, 0.7):
        hold, fault = draw_hold(rng, *_STICKS), draw_fault(rng)
        yield side, hold, fault, hold.put(puppet, base, fault)


def _hurdle_step(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    u = rng.uniform
    score, _ = _begin(puppet, rng, base)
    for side, hold, fault, ready in _leg_by_leg(puppet, rng, base, score, length):
        flexion = u(1.2, 1.9) * (0.4 + 0.6 * fault.short)
        tall = _faulty(puppet, ready, hold, fault).over(1 - side, 0.8)
        tall = tall.leaning(head=u(0.0, 0.6))
        abduction = u(-0.05, 0.25)
        knee = float(np.clip(flexion * u(0.7, 1.3), 0.3, 2.2))
        up = puppet.swing_leg(tall, side, flexion, abduction, knee)
        by = np.array([0.0, 0.0, u(0.3, 0.5) * puppet.leg])
        touch = tall.with_foot(side, ankle=tall.ankle[side] + by)
        touch = touch.leaning(back=-0.1, drop=0.03 * puppet.leg)
        score.to(u(0.7, 1.1), up)
        if rng.random() < 0.7:
            score.to(u(0.5, 0.8), touch).hold(0.1).to(u(0.5, 0.8), up)
        score.to(u(0.7, 1.1), ready).hold(u(0.1, 0.4))
    return _end(score, rng, base)


def _inline_lunge(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    """Step into a split stance, lower the rear knee, rise; then the other side."""
    score, ready = _begin(puppet, rng, base)
    side = int(rng.integers(2))
    while score.duration < length:
        reach = rng.uniform(0.6, 1.0) * puppet.leg
        split = _split(puppet, ready, side, reach, rng.uniform(-0.04, 0.18))
        air = ready.over(1 - side, 0.6).leaning(back=-0.2 * reach)
        air = air.stepping(side, split.ankle[side], 0.08 * puppet.scale)
        score.to(0.5, air).to(0.5, split)
        for _ in range(2):
            hold, fault = draw_hold(rng, *_STICKS), draw_fault(rng)
            depth = rng.uniform(0.33, 0.42) * (0.35 + 0.65 * fault.short)
            low = _faulty(puppet, split, hold, fault, 0.7).leaning(
                drop=depth * puppet.leg, back=-rng.normal(0.02, 0.05) * reach
            )
            low = low.with_foot(side, knee_out=0.6 * fault.knees_out)
            low = low.with_foot(1 - side, heel=rng.uniform(0.75, 1.0))
            _repeat(score, rng, low, hold.put(puppet, split, fault))
        score.to(0.5, air).to(0.5, ready)
        side = 1 - side
    return _end(score, rng, base)


def _split(puppet: Puppet, ready: Pose, side: int, reach: float, beside: float) -> Pose:
    """Return a stance with one foot ``reach`` ahead of and ``beside`` the other [m]."""
    behind = ready.ankle[1 - side]
    spot = behind + np.array([(1.0 - 2.0 * side) * beside, 0.0, reach])
    drop = 0.9 * float(puppet.leg - np.sqrt(puppet.leg**2 - (reach / 2.0) ** 2))
    middle = (behind + spot) / 2.0 - ready.root
    pose = ready.with_foot(side, ankle=spot).with_foot(1 - side, heel=0.5)
    return pose.leaning(side=float(middle[0]), back=-float(middle[2]), drop=drop)


def _side_lunge(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    score, wide = _begin(puppet, rng, base)
    half, out = rng.uniform(0.36, 0.64) * puppet.leg, rng.uniform(0.0, 0.5)
    first = int(rng.integers(2))
    for side in (first, 1 - first):
        sign = 1.0 - 2.0 * side
        spot = np.array([sign * half, puppet.ankle_height, wide.ankle[side, 2]])
        air = wide.over(1 - side, 0.5).leaning(drop=0.04 * puppet.leg)
        air = air.stepping(side, spot, 0.08 * puppet.scale)
        wide = wide.with_foot(side, ankle=spot, yaw=sign * out)
        wide = wide.leaning(drop=0.05 * puppet.leg)
        score.to(0.4, air.with_foot(side, yaw=sign * out)).to(0.4, wide)
    for side in alternating(score, rng, length, 0.7):
        hold, fault, sign = draw_hold(rng, *_STICKS), draw_fault(rng), 1.0 - 2.0 * side
        depth = rng.uniform(0.22, 0.44) * (0.35 + 0.65 * fault.short)
        lean = rng.uniform(0.4, 1.4) * depth
        shift = sign * rng.uniform(0.2, 0.7) * half * min(1.0, 2.5 * depth)
        low = _faulty(puppet, wide, hold, fault).leaning(side=shift)
        low = low.leaning(drop=depth * puppet.leg, back=0.35 * depth * puppet.leg)
        low = low.leaning(pelvis=0.6 * lean, spine=0.5 * lean, head=-0.3 * lean)
        low = low.with_foot(side, knee_out=rng.uniform(0.1, 0.6) + fault.knees_out)
        _repeat(score, rng, low, wide)
    for side in (1 - first, first):
        air, home = wide.over(1 - side, 0.5), base.ankle[side]
        air = air.stepping(side, home, 0.08 * puppet.scale)
        yaw = float(base.foot[side, 0])
        wide = wide.with_foot(side, ankle=home, yaw=yaw)
        score.to(0.5, air.with_foot(side, yaw=yaw)).to(0.4, wide)
    return _end(score, rng, base)


def _sit_to_stand(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    u = rng.uniform
    score, _ = _begin(puppet, rng, base)
    seat, back = u(0.45, 0.58) * puppet.scale, u(0.3, 0.43) * puppet.scale
    while score.duration < length:
        hold, fault, lean = draw_hold(rng, *_STICKS), draw_fault(rng), u(0.4, 0.9)
        ready = hold.put(puppet, base, fault)
        drop = (base.root[1] - seat) * (0.5 + 0.5 * fault.short)
        midway = _faulty(puppet, ready, hold, fault)
        midway = midway.leaning(drop=0.6 * drop, back=0.68 * back)
        midway = midway.leaning(pelvis=0.5 * lean, spine=0.5 * lean, head=-0.3 * lean)
        midway = midway.with_foot(BOTH, knee_out=fault.knees_out)
        seated = _faulty(puppet, ready, hold, fault, 0.5)
        seated = seated.leaning(drop=drop, back=back, pelvis=u(-0.2, 0.3))
        seated = seated.with_foot(BOTH, knee_out=0.5 * fault.knees_out)
        score.to(u(0.6, 1.0), midway).to(u(0.4, 0.7), seated).hold(u(0.1, 0.5))
        score.to(u(0.4, 0.7), midway).to(u(0.6, 0.9), ready).hold(u(0.05, 0.3))
    return _end(score, rng, base)


def _leg_raise(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    u = rng.uniform
    score, _ = _begin(puppet, rng, base)
    for side, hold, fault, ready in _leg_by_leg(puppet, rng, base, score, length):
        top = u(1.2, 1.75) * (0.35 + 0.65 * fault.short)
        slump = u(-0.45, 0.1) * top / 1.5
        tall = _faulty(puppet, ready, hold, fault).over(1 - side, 0.8)
        tall = tall.leaning(drop=u(0.0, 0.04) * puppet.leg)
        tall = tall.leaning(pelvis=slump, spine=-0.6 * slump)
        knee = u(0.03, 0.25) if rng.random() < 0.7 else u(0.3, 1.0)
        up = puppet.swing_leg(tall, side, top, u(-0.08, 0.12), knee)
        _repeat(score, rng, up, ready)
    return _end(score, rng, base)


def _working_arms(rng: Rng) -> list[int]:
    return [LEFT, RIGHT] if rng.random() < 0.25 else [int(rng.integers(2))]


def _elevate(
    puppet: Puppet, rng: Rng, base: Pose, length: float, plane: float, most: float
) -> Score:
    """Raise straight arms in one plane of elevation, to at most an angle [rad]."""
    score, sides = Score(base).hold(0.3), _working_arms(rng)
    plane = plane + rng.normal(0.0, 0.12)
    turn = rng.uniform(-0.7, 0.2)
    while score.duration < length:
        fault = draw_fault(rng)
        top = most * rng.uniform(0.8, 1.0) * (0.4 + 0.6 * fault.short)
        pose, low = fault.bend(puppet, base, 0.7), base
        for side in sides:
            away = (2.0 * side - 1.0) * abs(fault.side) * (len(sides) == 1)
            pose = pose.leaning(spine=(0.0, 0.5 * away, 0.0))
            at = plane + 0.6 * fault.sweep[side]
            bend = rng.uniform(0.05, 0.3) + abs(fault.sweep[side])
            pose = pose.with_arm(side, puppet.arm(top, at, turn * top / 1.5, bend))
            low = low.with_arm(side, puppet.arm(0.15, 0.4, 0.2, 0.3))
        _repeat(score, rng, pose, low)
    return _end(score, rng, base)


def _shoulder_abduction(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    return _elevate(puppet, rng, base, length, 0.0, 2.75)


def _shoulder_scaption(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    return _elevate(puppet, rng, base, length, rng.uniform(0.5, 1.2), 2.7)


def _shoulder_extension(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    return _elevate(puppet, rng, base, length, -1.45, rng.uniform(0.7, 1.0))


def _shoulder_rotation(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    """Rotate the upper arm about its axis, held to the side with the elbow bent."""
    score, sides = Score(base).hold(0.3), _working_arms(rng)
    raised = rng.uniform(1.2, 1.65) if rng.random() < 0.8 else 0.2
    plane = rng.uniform(-0.2, 0.35)
    outward, inward = (-1.9 if raised > 1.0 else -1.0), 0.8
    while score.duration < length:
        fault = draw_fault(rng)
        for turn in (outward, inward):
            pose = fault.bend(puppet, base, 0.6)
            for side in sides:
                arm = puppet.arm(
                    max(raised - fault.droop[side], 0.2),
                    plane + 0.5 * fault.sweep[side],
                    turn * rng.uniform(0.7, 1.0) * (0.5 + 0.5 * fault.short),
                    rng.uniform(1.3, 1.75) + 0.5 * fault.sweep[side],
                )
                pose = pose.with_arm(side, arm)
            score.to(rng.uniform(0.8, 1.4), pose).hold(rng.uniform(0.05, 0.3))
    return _end(score, rng, base)


def _breathed(pose: Pose, rng: Rng, depth: float) -> Pose:
    lean, turn = rng.normal(0.0, 0.04, 2)
    return pose.leaning(spine=(-0.12 * depth, lean, turn), head=-0.1 * depth)


def _deep_breathing(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    """Breathe in while opening the arms, out while folding them with tight fists."""
    score, u = Score(base).hold(0.2), rng.uniform
    low, flare = u(-0.42, -0.2), u(0.4, 1.0)
    while score.duration < length:
        tight = (u(0.04, 0.12), low + rng.normal(0.0, 0.03), 0.24)
        closed = _breathed(base, rng, -0.6)
        closed = puppet.reach_both(closed, tight, (flare, -1.0, -0.2))
        opened = _breathed(base, rng, 1.0)
        arms = puppet.arm(u(0.3, 1.4), u(-0.2, 0.6), -0.6, u(0.2, 2.0))
        score.to(u(0.9, 1.5), closed).hold(u(0.3, 0.8))
        score.to(u(0.9, 1.5), opened.with_arm(BOTH, arms)).hold(u(0.1, 0.4))
    return score.to(0.8, base)


def _clasp_and_spread(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    """Clasp the hands at the chest, at the neck or overhead, and spread the arms."""
    score, u = Score(base).hold(0.2), rng.uniform
    while score.duration < length:
        kind = rng.choice(["chest", "chest", "head", "behind"])
        if kind == "chest":
            spot, elbow_to = (0.03, u(-0.25, 0.02), u(0.28, 0.5)), (1.0, -0.6, 0.0)
        elif kind == "head":
            spot, elbow_to = (0.04, u(0.42, 0.55), 0.1), (1.0, 0.0, 0.3)
        else:
            spot, elbow_to = (0.12, u(0.14, 0.22), -0.06), (1.0, 0.3, u(0.2, 0.9))
        closed = puppet.reach_both(base, spot, elbow_to)
        opened = _breathed(base, rng, 0.8)
        elevation, plane = u(1.2, 1.8), u(-0.35, 0.3)
        bend, turn = u(0.1, 0.7), u(-0.9, 0.0)
        opened = opened.with_arm(BOTH, puppet.arm(elevation, plane, turn, bend))
        score.to(u(0.8, 1.4), closed).hold(u(0.1, 0.5))
        score.to(u(0.8, 1.4), opened).hold(u(0.1, 0.5))
    return score.to(0.8, base)


def _overhead_pumping(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    """Pump with fists from the shoulders up over the head."""
    score, u = Score(base).hold(0.2), rng.uniform
    together, out, forward = rng.random() < 0.6, u(0.08, 0.3), u(0.0, 0.25)
    while score.duration < length:
        up = (out, u(0.38, 0.62), forward)
        down = (out + 0.06, u(0.02, 0.2), forward + 0.12)
        flare = (1.0, -0.7, u(-0.1, 0.5))
        for beat in range(2):
            pose = _breathed(base, rng, 0.5)
            for side in (LEFT, RIGHT):
                raised = (beat == 0) if together else (beat == side)
                pose = puppet.put_hand(pose, side, up if raised else down, flare)
            score.to(u(0.5, 0.9), pose).hold(u(0.0, 0.2))
    return score.to(0.9, base)


def _push_down_pumping(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    """Bring the hands together at the chest and push them down to the belly."""
    score, u = Score(base).hold(0.2), rng.uniform
    gap, flare = u(0.03, 0.12), u(0.6, 1.2)
    while score.duration < length:
        top = (gap, u(-0.18, 0.0), u(0.22, 0.28))
        raised = puppet.reach_both(_breathed(base, rng, 0.6), top, (flare, -0.5, 0.0))
        end = (gap + u(0, 0.12), u(-0.5, -0.4), u(0.2, 0.3))
        pushed = puppet.reach_both(_breathed(base, rng, -0.4), end, (1.0, -0.2, -0.4))
        score.to(u(0.5, 1.0), raised).hold(u(0.05, 0.3))
        score.to(u(0.4, 0.9), pushed).hold(u(0.05, 0.3))
    return score.to(0.8, base)


EXERCISES = by_name(
    *(_clasp_and_spread, _deep_breathing, _deep_squat, _hurdle_step, _inline_lunge),
    *(_leg_raise, _overhead_pumping, _push_down_pumping, _shoulder_abduction),
    *(_shoulder_extension, _shoulder_rotation, _shoulder_scaption),
    *(_side_lunge, _sit_to_stand),
)
"""Exercises of physiotherapy and for lymph flow, by name."""
