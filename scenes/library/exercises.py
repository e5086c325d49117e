"""Scripted exercises of physiotherapy, done right and done wrong.

The ten movements of the University of Idaho's set (Vakanski et al. 2018, Data 3(1):2):
deep squat, hurdle step, inline lunge, side lunge, sit to stand, straight leg raise, and
the shoulder's abduction, extension, rotation and scaption. Wrong repetitions lean,
twist, shift, stop short, let the knees in or the arms sink.

The four for the flow of lymph of Chiang et al. 2017 (IEEE EMBC), parts of The Optimal
Lymph Flow program; how the arms go is told by their names and by the paper's figure 6.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from .poses import BOTH, LEFT, RIGHT, Pose, Rng, Score
from .puppet import Puppet
from .stances import ArmHold, Fault, Script, draw_fault, draw_hold

_STICKS = (*["stick"] * 4, *["low stick"] * 3, "overhead", "hips", "forward")


def _begin(puppet: Puppet, rng: Rng, base: Pose, hold: ArmHold) -> tuple[Score, Pose]:
    """Return a score that has taken up the arms, and the pose it has come to."""
    ready = hold.put(puppet, base, draw_fault(rng))
    return Score(base).hold(0.2).to(rng.uniform(0.6, 0.9), ready), ready


def _end(score: Score, rng: Rng, base: Pose) -> Score:
    return score.to(rng.uniform(0.6, 0.9), base).hold(0.2)


def _moved(
    puppet: Puppet, ready: Pose, hold: ArmHold, fault: Fault, share: float = 1.0
) -> Pose:
    """Return the pose with the fault in trunk and arms."""
    return hold.put(puppet, fault.bend(puppet, ready, share), fault)


def _repeat(score: Score, rng: Rng, peak: Pose, ready: Pose) -> None:
    """Go to the peak of a repetition and back."""
    score.to(rng.uniform(0.8, 1.6), peak).hold(rng.uniform(0.05, 0.4))
    score.to(rng.uniform(0.8, 1.5), ready).hold(rng.uniform(0.05, 0.3))


def _deep_squat(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    holds = [*["overhead"] * 5, "stick", "forward", "wide"]
    hold = draw_hold(rng, *holds)
    score, ready = _begin(puppet, rng, base, hold)
    while score.duration < length:
        hold, fault = draw_hold(rng, *holds), draw_fault(rng)
        ready = hold.put(puppet, base, fault)
        depth = rng.uniform(0.45, 0.62) * fault.short
        lean = rng.uniform(0.7, 2.0) * depth
        low = _moved(puppet, ready, hold, fault).leaning(
            drop=depth * puppet.leg, back=rng.uniform(0.3, 0.55) * depth * puppet.leg
        )
        low = low.leaning(pelvis=0.6 * lean, spine=0.4 * lean, head=-0.3 * lean)
        low = low.with_foot(BOTH, knee_out=fault.knees_out)
        _repeat(score, rng, low, ready)
    return _end(score, rng, base)


def _leg_by_leg(
    puppet: Puppet, rng: Rng, base: Pose, score: Score, length: float
) -> Iterator[tuple[int, ArmHold, Fault, Pose]]:
    """Yield which leg moves, how the arms are held, the fault, and the pose before."""
    side = int(rng.integers(2))
    while score.duration < length:
        side = 1 - side if rng.random() < 0.7 else side
        hold, fault = draw_hold(rng, *_STICKS), draw_fault(rng)
        yield side, hold, fault, hold.put(puppet, base, fault)


def _hurdle_step(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    score, _ = _begin(puppet, rng, base, draw_hold(rng, *_STICKS))
    for side, hold, fault, ready in _leg_by_leg(puppet, rng, base, score, length):
        lifting = rng.uniform(1.2, 1.9) * (0.4 + 0.6 * fault.short)
        tall = _moved(puppet, ready, hold, fault).over(1 - side, 0.8)
        looking_down = rng.uniform(0.0, 0.6)
        tall = tall.leaning(head=looking_down)
        up = puppet.swing_leg(
            tall,
            side,
            lifting,
            rng.uniform(-0.05, 0.25),
            float(np.clip(lifting * rng.uniform(0.7, 1.3), 0.3, 2.2)),
        )
        by = np.array([0.0, 0.0, rng.uniform(0.3, 0.5) * puppet.leg])
        touch = tall.with_foot(side, ankle=tall.ankle[side] + by)
        touch = touch.leaning(back=-0.1, drop=0.03 * puppet.leg)
        score.to(rng.uniform(0.7, 1.1), up)
        if rng.random() < 0.7:
            score.to(rng.uniform(0.5, 0.8), touch).hold(0.1)
            score.to(rng.uniform(0.5, 0.8), up)
        score.to(rng.uniform(0.7, 1.1), ready).hold(rng.uniform(0.1, 0.4))
    return _end(score, rng, base)


def _inline_lunge(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    """Step into a split stance, lower the knee behind, rise; then the other side."""
    score, ready = _begin(puppet, rng, base, draw_hold(rng, *_STICKS))
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
            low = _moved(puppet, split, hold, fault, 0.7).leaning(
                drop=depth * puppet.leg, back=-rng.normal(0.02, 0.05) * reach
            )
            low = low.with_foot(side, knee_out=0.6 * fault.knees_out)
            low = low.with_foot(1 - side, heel=rng.uniform(0.75, 1.0))
            _repeat(score, rng, low, hold.put(puppet, split, fault))
        score.to(0.5, air).to(0.5, ready)
        side = 1 - side
    return _end(score, rng, base)


def _split(puppet: Puppet, ready: Pose, side: int, reach: float, beside: float) -> Pose:
    """Return a stance with one foot ``reach`` before and ``beside`` the other [m]."""
    behind = ready.ankle[1 - side]
    spot = behind + np.array([(1.0 - 2.0 * side) * beside, 0.0, reach])
    drop = puppet.leg - np.sqrt(puppet.leg**2 - (reach / 2.0) ** 2)
    middle = (behind + spot) / 2.0 - ready.root
    pose = ready.with_foot(side, ankle=spot).with_foot(1 - side, heel=0.5)
    return pose.leaning(
        side=float(middle[0]), back=-float(middle[2]), drop=0.9 * float(drop)
    )


def _side_lunge(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    hold = draw_hold(rng, *_STICKS)
    score, ready = _begin(puppet, rng, base, hold)
    half, out = rng.uniform(0.36, 0.64) * puppet.leg, rng.uniform(0.0, 0.5)
    first = int(rng.integers(2))
    wide = ready
    for side in (first, 1 - first):
        way = 1.0 - 2.0 * side
        spot = np.array([way * half, puppet.ankle_height, wide.ankle[side, 2]])
        air = wide.over(1 - side, 0.5).leaning(drop=0.04 * puppet.leg)
        air = air.stepping(side, spot, 0.08 * puppet.scale)
        wide = wide.with_foot(side, ankle=spot, yaw=way * out)
        wide = wide.leaning(drop=0.05 * puppet.leg)
        score.to(0.4, air.with_foot(side, yaw=way * out, heel=0.2)).to(0.4, wide)
    side = int(rng.integers(2))
    while score.duration < length:
        side = 1 - side if rng.random() < 0.7 else side
        hold, fault, way = draw_hold(rng, *_STICKS), draw_fault(rng), 1.0 - 2.0 * side
        depth = rng.uniform(0.22, 0.44) * (0.35 + 0.65 * fault.short)
        lean = rng.uniform(0.4, 1.4) * depth
        low = _moved(puppet, wide, hold, fault).leaning(
            drop=depth * puppet.leg,
            side=way * rng.uniform(0.2, 0.7) * half * min(1.0, 2.5 * depth),
            back=0.35 * depth * puppet.leg,
        )
        low = low.leaning(pelvis=0.6 * lean, spine=0.5 * lean, head=-0.3 * lean)
        low = low.with_foot(side, knee_out=rng.uniform(0.1, 0.6) + fault.knees_out)
        _repeat(score, rng, low, wide)
    for side in (1 - first, first):
        air = wide.over(1 - side, 0.5)
        air = air.stepping(side, base.ankle[side], 0.08 * puppet.scale)
        yaw = float(base.foot[side, 0])
        wide = wide.with_foot(side, ankle=base.ankle[side], yaw=yaw)
        score.to(0.5, air.with_foot(side, yaw=yaw, heel=0.2)).to(0.4, wide)
    return _end(score, rng, base)


def _sit_to_stand(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    hold = draw_hold(rng, *_STICKS)
    score, ready = _begin(puppet, rng, base, hold)
    seat = rng.uniform(0.45, 0.58) * puppet.scale
    back = rng.uniform(0.3, 0.43) * puppet.scale
    while score.duration < length:
        hold = draw_hold(rng, *_STICKS)
        fault, lean = draw_fault(rng), rng.uniform(0.4, 0.9)
        ready = hold.put(puppet, base, fault)
        drop = (base.root[1] - seat) * (0.5 + 0.5 * fault.short)
        way = _moved(puppet, ready, hold, fault).leaning(
            drop=0.6 * drop, back=0.68 * back
        )
        way = way.leaning(pelvis=0.5 * lean, spine=0.5 * lean, head=-0.3 * lean)
        seated = _moved(puppet, ready, hold, fault, 0.5).leaning(
            drop=drop, back=back, pelvis=rng.uniform(-0.2, 0.3)
        )
        for side in (LEFT, RIGHT):
            way = way.with_foot(side, knee_out=fault.knees_out)
            seated = seated.with_foot(side, knee_out=0.5 * fault.knees_out)
        score.to(rng.uniform(0.6, 1.0), way).to(rng.uniform(0.4, 0.7), seated)
        score.hold(rng.uniform(0.1, 0.5)).to(rng.uniform(0.4, 0.7), way)
        score.to(rng.uniform(0.6, 0.9), ready).hold(rng.uniform(0.05, 0.3))
    return _end(score, rng, base)


def _leg_raise(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    score, _ = _begin(puppet, rng, base, draw_hold(rng, *_STICKS))
    for side, hold, fault, ready in _leg_by_leg(puppet, rng, base, score, length):
        top = rng.uniform(1.2, 1.75) * (0.35 + 0.65 * fault.short)
        slump = rng.uniform(-0.45, 0.1) * top / 1.5
        tall = _moved(puppet, ready, hold, fault).over(1 - side, 0.8)
        tall = tall.leaning(
            drop=rng.uniform(0.0, 0.04) * puppet.leg, pelvis=slump, spine=-0.6 * slump
        )
        knee = rng.uniform(0.03, 0.25) if rng.random() < 0.7 else rng.uniform(0.3, 1.0)
        up = puppet.swing_leg(tall, side, top, rng.uniform(-0.08, 0.12), knee)
        _repeat(score, rng, up, ready)
    return _end(score, rng, base)


def _sides(rng: Rng) -> list[int]:
    """Return the arms that work: mostly one."""
    return [LEFT, RIGHT] if rng.random() < 0.25 else [int(rng.integers(2))]


def _elevate(
    puppet: Puppet, rng: Rng, base: Pose, length: float, plane: float, most: float
) -> Score:
    """Raise straight arms in one plane of elevation to at most some angle [rad]."""
    score, sides = Score(base).hold(0.3), _sides(rng)
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
    """Turn the upper arm about itself, held to the side, the elbow bent."""
    score, sides = Score(base).hold(0.3), _sides(rng)
    raised = rng.uniform(1.2, 1.65) if rng.random() < 0.8 else 0.2
    plane = rng.uniform(-0.2, 0.35)
    out, inward = (-1.9, 0.8) if raised > 1.0 else (-1.0, 0.8)
    ends = (out, inward)
    while score.duration < length:
        fault = draw_fault(rng)
        for turn in ends:
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


EXERCISES: dict[str, Script] = {
    "deep_squat": _deep_squat,
    "hurdle_step": _hurdle_step,
    "inline_lunge": _inline_lunge,
    "leg_raise": _leg_raise,
    "shoulder_abduction": _shoulder_abduction,
    "shoulder_extension": _shoulder_extension,
    "shoulder_rotation": _shoulder_rotation,
    "shoulder_scaption": _shoulder_scaption,
    "side_lunge": _side_lunge,
    "sit_to_stand": _sit_to_stand,
}
"""Exercises of physiotherapy, by name."""


def _breathed(pose: Pose, rng: Rng, depth: float) -> Pose:
    """Return the pose with the chest raised or sunk, and a little of chance."""
    lean, turn = rng.normal(0.0, 0.04, 2)
    return pose.leaning(spine=(-0.12 * depth, lean, turn), head=-0.1 * depth)


def _deep_breathing(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    """Breathe in with opening arms, out with tight fists and folding arms."""
    score = Score(base).hold(0.2)
    low, flare = rng.uniform(-0.42, -0.2), rng.uniform(0.4, 1.0)
    while score.duration < length:
        tight = (rng.uniform(0.04, 0.12), low + rng.normal(0.0, 0.03), 0.24)
        closed = puppet.reach_both(
            _breathed(base, rng, -0.6), tight, (flare, -1.0, -0.2)
        )
        opened = _breathed(base, rng, 1.0)
        elevation, plane = rng.uniform(0.3, 1.4), rng.uniform(-0.2, 0.6)
        bend = rng.uniform(0.2, 2.0)
        opened = opened.with_arm(BOTH, puppet.arm(elevation, plane, -0.6, bend))
        score.to(rng.uniform(0.9, 1.5), closed).hold(rng.uniform(0.3, 0.8))
        score.to(rng.uniform(0.9, 1.5), opened).hold(rng.uniform(0.1, 0.4))
    return score.to(0.8, base)


def _clasp_and_spread(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    """Clasp the hands before the chest, at the neck or overhead; spread the arms."""
    score = Score(base).hold(0.2)
    while score.duration < length:
        kind = rng.choice(["chest", "chest", "head", "behind"])
        if kind == "chest":
            spot = (0.03, rng.uniform(-0.25, 0.02), rng.uniform(0.28, 0.5))
            closed = puppet.reach_both(base, spot, (1.0, -0.6, 0.0))
        elif kind == "head":
            closed = puppet.reach_both(
                base, (0.04, rng.uniform(0.42, 0.55), 0.1), (1, 0, 0.3)
            )
        else:
            spot = (0.12, rng.uniform(0.14, 0.22), -0.06)
            closed = puppet.reach_both(base, spot, (1.0, 0.3, rng.uniform(0.2, 0.9)))
        opened = _breathed(base, rng, 0.8)
        elevation, plane = rng.uniform(1.2, 1.8), rng.uniform(-0.35, 0.3)
        bend, turn = rng.uniform(0.1, 0.7), rng.uniform(-0.9, 0.0)
        opened = opened.with_arm(BOTH, puppet.arm(elevation, plane, turn, bend))
        score.to(rng.uniform(0.8, 1.4), closed).hold(rng.uniform(0.1, 0.5))
        score.to(rng.uniform(0.8, 1.4), opened).hold(rng.uniform(0.1, 0.5))
    return score.to(0.8, base)


def _overhead_pumping(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    """Pump with fists from the shoulders up over the head."""
    score, together = Score(base).hold(0.2), rng.random() < 0.6
    out, forward = rng.uniform(0.08, 0.3), rng.uniform(0.0, 0.25)
    while score.duration < length:
        high = rng.uniform(0.38, 0.62)
        low = rng.uniform(0.02, 0.2)
        down = (out + 0.06, low, forward + 0.12)
        up = (out, high, forward)
        flare = (1.0, -0.7, rng.uniform(-0.1, 0.5))
        for beat in range(2):
            pose = _breathed(base, rng, 0.5)
            for side in (LEFT, RIGHT):
                raised = (beat == 0) if together else (beat == side)
                pose = puppet.put_hand(pose, side, up if raised else down, flare)
            score.to(rng.uniform(0.5, 0.9), pose).hold(rng.uniform(0.0, 0.2))
    return score.to(0.9, base)


def _push_down_pumping(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    """Close the hands before the chest and push them down before the belly."""
    score = Score(base).hold(0.2)
    gap, flare = rng.uniform(0.03, 0.12), rng.uniform(0.6, 1.2)
    while score.duration < length:
        top = (gap, rng.uniform(-0.18, 0.0), rng.uniform(0.22, 0.28))
        raised = puppet.reach_both(_breathed(base, rng, 0.6), top, (flare, -0.5, 0.0))
        end = (
            gap + rng.uniform(0, 0.12),
            rng.uniform(-0.5, -0.4),
            rng.uniform(0.2, 0.3),
        )
        pushed = puppet.reach_both(_breathed(base, rng, -0.4), end, (1.0, -0.2, -0.4))
        score.to(rng.uniform(0.5, 1.0), raised).hold(rng.uniform(0.05, 0.3))
        score.to(rng.uniform(0.4, 0.9), pushed).hold(rng.uniform(0.05, 0.3))
    return score.to(0.8, base)


LYMPH_FLOW: dict[str, Script] = {
    "clasp_and_spread": _clasp_and_spread,
    "deep_breathing": _deep_breathing,
    "overhead_pumping": _overhead_pumping,
    "push_down_pumping": _push_down_pumping,
}
"""Exercises for the flow of lymph, by name."""
