"""Scripted gaits: walking, running, carrying, marching, turning on the spot.

Planted feet stay in place. Timing after Winter 1991, The Biomechanics and Motor Control
of Human Gait: stance is 62 % of a walking cycle and about 35 % of a running one.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from kinefilter.characters.anthropometry import GRAVITY
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import about_y, rotate

from .poses import LEFT, RIGHT, Pose, Rng, Score
from .puppet import Puppet
from .stances import Script, stance

_WIDEST_TURN = 0.55  # rad per step: longer steps on a loop would cross the legs
_WIDER = 0.4  # hip widths by which each foot is farther from the center line on a loop
_LONGEST_LOOP = 1.3  # largest ratio of a loop's axes: longer loops have sharp ends


class Area(NamedTuple):
    """A rectangle on the floor, world frame [m]."""

    left: tuple[float, float]  # smallest and largest x
    forward: tuple[float, float]  # smallest and largest z


class _Gait(NamedTuple):
    """One person's way of walking or running; lengths [m] on a body of 1.75 m."""

    stride: float  # distance covered by the root in one cycle of two steps [m]
    period: float  # duration of one cycle [s]
    stance: float  # share of the cycle in which a foot is planted
    lift: float  # height of the swinging ankle above its height when planted [m]
    heel: float  # heel rise when the foot leaves the floor [rad]
    crouch: float  # mean height of the root below standing, as a share of leg length
    bounce: float  # amplitude of the root's height [m]; positive: highest in mid-stance
    swing: float  # amplitude of the shoulder's flexion [rad]
    elbow: float  # mean flexion of the elbow [rad]
    lean: float  # flexion of the trunk [rad]
    flexion: float  # mean flexion of the shoulder [rad]


def _style(name: str, rng: Rng) -> _Gait:
    u, flexion = rng.uniform, 0.0
    if name == "run":
        stride, period, stance = u(1.5, 2.3), u(0.66, 0.8), u(0.34, 0.4)
        lift, heel, crouch = u(0.3, 0.45), 0.9, u(0.06, 0.09)
        bounce, swing = -u(0.03, 0.04), u(0.5, 0.9)
        elbow, lean = u(1.3, 1.8), u(0.1, 0.2)
    elif name == "march":
        stride, period, stance = u(0.0, 0.1), u(0.9, 1.4), 0.55
        lift, heel, crouch = u(0.15, 0.5), 0.25, 0.012
        bounce, swing, elbow, lean = 0.005, u(0.2, 0.7), u(0.3, 1.4), u(0.0, 0.05)
    else:
        speed = u(0.6, 1.3) if name == "carry" else u(0.7, 1.6)
        period = 1.3 - 0.2 * speed + u(-0.06, 0.06)
        stride, stance = speed * period, 0.62
        lift, heel, crouch = u(0.08, 0.13), u(0.6, 0.9), u(0.012, 0.03)
        bounce, swing, elbow, lean = 0.015, u(0.15, 0.5), u(0.1, 0.6), u(-0.12, 0.1)
        flexion = u(-0.25, 0.0)
    return _Gait(
        stride, period, stance, lift, heel, crouch, bounce, swing, elbow, lean, flexion
    )


def gait(
    name: str, puppet: Puppet, rng: Rng, time: Array, within: Area | None = None
) -> Pose:
    """Return a gait at times [s], (T,), straight ahead or around an ellipse."""
    style, size = _style(name, rng), puppet.scale
    loop = None if within is None else _Loop(within, int(rng.choice([-1, 1])))
    if loop is not None:
        longest = 2.0 * _WIDEST_TURN * loop.sharpest / size
        style = style._replace(stride=min(style.stride, longest))
    base = stance(puppet, rng)
    cycle = time / style.period + rng.uniform(0.0, 1.0)
    lead = style.stance / 2.0 - 0.03
    ankle, foot = np.zeros((len(time), 2, 3)), np.zeros((len(time), 2, 2))
    narrow, wide = (0.15, 0.5) if name in ("carry", "walk") else (0.4, 0.6)
    half = puppet.hip_width * rng.uniform(narrow, wide)
    if loop is not None:
        half += _WIDER * puppet.hip_width
    for side in (LEFT, RIGHT):
        number, phase = np.divmod(cycle + 0.5 * side, 1.0)
        swing = np.clip((phase - style.stance) / (1.0 - style.stance), 0.0, 1.0)
        strides = number - 0.5 * side + lead + _ease(swing)
        ankle[:, side, 2] = style.stride * size * strides
        ankle[:, side, 0] = (1.0 - 2.0 * side) * half
        arc = np.sin(np.pi * swing**0.8) ** 2  # highest before mid-swing
        ankle[:, side, 1] = puppet.ankle_height + style.lift * size * arc
        foot[:, side, 0] = base.foot[side, 0]
        foot[:, side, 1] = _heel(phase, style)
    turn = 2.0 * np.pi * cycle
    sway = np.sin(turn + 0.3)  # to the left while the left foot is planted
    mean_height = puppet.ankle_height + puppet.leg * (1.0 - style.crouch)
    height = mean_height - style.bounce * size * np.cos(2.0 * turn)
    forward = style.stride * size * cycle
    zero, lean = np.zeros_like(time), style.lean + 0.06 * _drift(rng, time)
    yaw = -0.12 * np.cos(turn) * min(style.stride, 1.5)
    twist = -1.8 * yaw
    pose = Pose(
        root=np.stack([0.02 * size * sway, height, forward], axis=-1),
        pelvis=np.stack([yaw, 0.6 * lean, -0.05 * sway], axis=-1),
        spine=np.stack([0.8 * lean, 0.05 * sway, twist], axis=-1),
        head=np.stack([-0.5 * lean, zero, -0.5 * (yaw + twist)], axis=-1),
        arm=np.broadcast_to(base.arm, (len(time), 2, 4)).copy(),
        elbow=np.broadcast_to(base.elbow, (len(time), 2)).copy(),
        hand=np.zeros((len(time), 2, 2)),
        ankle=ankle,
        foot=foot,
        lifted=np.zeros((len(time), 2)),
        knee_out=np.zeros((len(time), 2)),
    )
    if loop is not None:
        pose = loop.bent(pose, style.stride * size / style.period)
    if name == "carry":
        return _load(puppet, pose, rng)
    return _swing_arms(puppet, pose, style, turn, rng, time)


class _Loop:
    """An ellipse on the floor that starts where it leads forward (+z)."""

    def __init__(self, area: Area, sign: int) -> None:
        """Fit the ellipse into an area; sign is 1 for left turns and -1 for right."""
        wide, deep = (0.5 * (most - least) for least, most in area)
        wide = min(wide, _LONGEST_LOOP * deep)
        deep = min(deep, _LONGEST_LOOP * wide)
        self.sharpest = min(wide, deep) ** 2 / max(wide, deep)  # radius [m]
        angle = np.linspace(0.0, 2.0 * np.pi, 721)
        center = np.array([sum(side) / 2.0 for side in area])
        edge = np.stack([-sign * wide * np.cos(angle), deep * np.sin(angle)], axis=-1)
        steps = np.diff(edge, axis=0)
        self._points = center + edge
        self._distance = np.append(0.0, np.cumsum(np.linalg.norm(steps, axis=1)))
        tangent = sign * wide * np.sin(angle), deep * np.cos(angle)
        self._heading = np.unwrap(np.arctan2(*tangent))
        self._curvature = np.gradient(self._heading, self._distance)

    def _along(self, points: Array, start: float) -> tuple[Array, Array, Array]:
        """Return points [m] moved from a straight path to the loop, and its heading."""
        rounds, rest = np.divmod(points[..., 2] - start, self._distance[-1])
        x, z, heading, curvature = (
            np.interp(rest, self._distance, values)
            for values in (*self._points.T, self._heading, self._curvature)
        )
        heading = heading + rounds * self._heading[-1]
        moved = points.copy()
        moved[..., 0] = x + points[..., 0] * np.cos(heading)
        moved[..., 2] = z - points[..., 0] * np.sin(heading)
        return moved, heading, curvature

    def bent(self, pose: Pose, speed: float) -> Pose:
        """Return a straight motion at a speed [m/s] led around the loop, leaning."""
        start = pose.root[0, 2]
        root, heading, curvature = self._along(pose.root, start)
        ankle, toes, _ = self._along(pose.ankle, start)
        lean = np.arctan(curvature * speed**2 / GRAVITY)
        turn = np.stack([heading, np.zeros_like(heading), lean], axis=-1)
        foot = pose.foot + np.stack([toes, np.zeros_like(toes)], axis=-1)
        pelvis = pose.pelvis + turn
        return replace(pose, root=root, ankle=ankle, foot=foot, pelvis=pelvis)


def _drift(rng: Rng, time: Array) -> Array:
    """Return a slow variation over time, about within -1 and 1, shape (T,)."""
    rates, phases = rng.uniform(0.08, 0.3, 2), rng.uniform(0.0, 2.0 * np.pi, 2)
    waves = np.sin(2.0 * np.pi * np.multiply.outer(time, rates) + phases)
    return np.asarray(waves.mean(axis=1))


def _ease(s: Array) -> Array:
    """Minimum-jerk curve from 0 to 1 (Flash & Hogan 1985, J. Neurosci. 5(7))."""
    return s**3 * (10.0 - 15.0 * s + 6.0 * s**2)


def _heel(phase: Array, style: _Gait) -> Array:
    """Heel rise [rad] from mid-stance to mid-swing; toes up (negative) at landing."""
    start, off = 0.6 * style.stance, style.stance
    rise = _ease(np.clip((phase - start) / (off - start), 0.0, 1.0))
    fall = _ease(np.clip((phase - off) / (0.6 * (1.0 - off)), 0.0, 1.0))
    toes = _ease(np.clip((phase - 0.8) / 0.15, 0.0, 1.0)) * (phase > 0.5)
    toes = toes + (1.0 - _ease(np.clip(phase / 0.1, 0.0, 1.0))) * (phase < 0.5)
    return style.heel * rise * (1.0 - fall) - 0.2 * min(style.stride, 1.0) * toes


def _swing_arms(
    puppet: Puppet, pose: Pose, style: _Gait, turn: Array, rng: Rng, time: Array
) -> Pose:
    drifts = [_drift(rng, time) for _ in range(3)]
    spread, inward = rng.uniform(0.1, 0.25), rng.uniform(-0.1, 0.5)
    # In walking the shoulder swings from about 24 degrees of extension to 8 of flexion
    # (Murray et al. 1967, Am. J. Phys. Med. 46(1)).
    mean = style.flexion + 0.1 * drifts[0]
    wide = spread * (1.0 + 0.4 * drifts[1])
    bent = style.elbow * (1.0 + 0.4 * drifts[2])
    for side in (LEFT, RIGHT):
        swing = -style.swing * np.cos(turn + np.pi * side - 0.15)
        forward = np.sin(swing + mean + 0.05 * style.elbow)
        out = np.sin(wide)
        elevation = np.arcsin(np.minimum(np.hypot(forward, out), 0.999))
        elbow = bent * (1.0 + 0.35 * np.sin(swing)) + 0.15 + 0.1 * forward
        plane = np.arctan2(forward, out)
        pose = pose.with_arm(side, puppet.arm(elevation, plane, inward, elbow))
    return pose


def _load(puppet: Puppet, pose: Pose, rng: Rng) -> Pose:
    if rng.random() < 0.3:
        return pose.with_arm(int(rng.integers(2)), puppet.arm(0.2, 0.1, 0.2, 0.1))
    goal = (rng.uniform(0.12, 0.2), rng.uniform(-0.42, -0.12), rng.uniform(0.25, 0.36))
    pose = puppet.reach_both(pose, goal, (rng.uniform(0.1, 0.6), -1.0, -0.3))
    return replace(pose, spine=pose.spine * np.array([1.0, 1.0, 0.3]) - [0.05, 0, 0])


def _turn(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    score, pose = Score(base).hold(0.3), base
    center = base.ankle.mean(axis=0)
    home = np.array([center[0], base.root[1], center[2]])
    while score.duration < length:
        sign, steps = int(rng.choice([-1, 1])), int(rng.integers(2, 6))
        pace, angle = rng.uniform(0.28, 0.45), rng.uniform(0.35, 0.7)
        for step in range(2 * steps):
            side = (step + (sign < 0)) % 2  # the inner foot goes first
            if step % 2 == 0:
                heading = pose.pelvis[0] - base.pelvis[0] + sign * angle
            spot = center + rotate(about_y(heading), base.ankle[side] - center)
            middle = (pose.ankle[side] + spot) / 2.0 + [0.0, 0.06 * puppet.scale, 0.0]
            yaw = base.foot[side, 0] + heading
            turned = pose.pelvis + np.array([sign * angle / 4.0, 0.0, 0.0])
            over = home + 0.35 * (pose.ankle[1 - side] - center)
            air = pose.with_foot(side, ankle=middle, heel=0.25)
            score.to(pace, replace(air, root=over, pelvis=turned))
            pose = pose.with_foot(side, ankle=spot, yaw=yaw, heel=0.0)
            turned = turned + np.array([sign * angle / 4.0, 0.0, 0.0])
            pose = replace(pose, root=home, pelvis=turned)
            score.to(pace, pose)
        score.hold(rng.uniform(0.3, 0.8))
    return score


GAITS = ("carry", "march", "run", "walk")  # names of the gaits

TURNS: dict[str, Script] = {"turn": _turn}  # motions that turn on the spot, by name
