"""Scripted gaits: walking, running, carrying, marching, turning on the spot.

Timing after Winter 1991, The Biomechanics and Motor Control of Human Gait: stance is
62 % of a walking cycle and about 35 % of a running one. A stance foot stays where it
was put while the root passes over it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from kinefilter.characters.anthropometry import GRAVITY
from kinefilter.characters.arrays import Array
from kinefilter.characters.rotations import about_y, rotate

from .poses import LEFT, RIGHT, Pose, Rng, Score
from .puppet import Puppet
from .stances import Script, stance

_WIDEST_TURN = 0.55  # rad per step: longer steps on a loop would cross the legs
_WIDER = 0.4  # hip widths by which each foot is farther from the middle on a loop
_LONGEST_LOOP = 1.3  # width of a loop over its depth: a longer one has sharp ends


class Area(NamedTuple):
    """A rectangle of the floor, world frame [m]."""

    left: tuple[float, float]
    """Least and greatest x."""
    forward: tuple[float, float]
    """Least and greatest z."""


@dataclass(frozen=True)
class _Gait:
    """One person's way to walk or run, lengths [m] on a body of 1.75 m."""

    stride: float
    """Way of the root within one cycle of two steps [m]."""
    period: float
    """Time of one cycle [s]."""
    stance: float
    """Share of the cycle that a foot stands."""
    lift: float
    """Height of the swinging ankle above its standing height [m]."""
    toe_off: float
    """Heel rise when the foot leaves the floor [rad]."""
    crouch: float
    """Mean height of the root below standing, as a share of leg length."""
    bounce: float
    """Amplitude of the root's rise and fall [m]; highest in mid-stance if positive."""
    arm_swing: float
    """Amplitude of the shoulder's flexion [rad]."""
    elbow: float
    """Mean flexion of the elbow [rad]."""
    lean: float
    """Flexion of the trunk [rad]."""
    half_width: tuple[float, float] = (0.4, 0.6)
    """Least and most distance of the feet from the middle, in hip widths."""
    mean_swing: float = 0.0
    """Mean flexion of the shoulder [rad]."""


def _style(name: str, rng: Rng) -> _Gait:
    u = rng.uniform
    if name == "run":
        return _Gait(
            u(1.5, 2.3),
            u(0.66, 0.8),
            u(0.34, 0.4),
            u(0.3, 0.45),
            0.9,
            u(0.06, 0.09),
            -u(0.03, 0.04),
            u(0.5, 0.9),
            u(1.3, 1.8),
            u(0.1, 0.2),
        )
    if name == "march":
        return _Gait(
            u(0.0, 0.1),
            u(0.9, 1.4),
            0.55,
            u(0.15, 0.5),
            0.25,
            0.012,
            0.005,
            u(0.2, 0.7),
            u(0.3, 1.4),
            u(0.0, 0.05),
        )
    speed = u(0.6, 1.3) if name == "carry" else u(0.7, 1.6)
    period = 1.3 - 0.2 * speed + u(-0.06, 0.06)
    return _Gait(
        speed * period,
        period,
        0.62,
        u(0.08, 0.13),
        u(0.6, 0.9),
        u(0.012, 0.03),
        0.015,
        u(0.15, 0.5),
        u(0.1, 0.6),
        u(-0.12, 0.1),
        (0.15, 0.5),
        u(-0.25, 0.0),
    )


def gait(
    name: str, puppet: Puppet, rng: Rng, time: Array, within: Area | None = None
) -> Pose:
    """Return the motion of a gait at the given times [s], shape (T,).

    The way leads straight ahead, or around an ellipse within an area.
    """
    style, size = _style(name, rng), puppet.scale
    loop = None if within is None else _Loop(within, int(rng.choice([-1, 1])))
    if loop is not None:
        longest = 2.0 * _WIDEST_TURN * loop.sharpest / size
        style = replace(style, stride=min(style.stride, longest))
    base = stance(puppet, rng)
    cycle = time / style.period + rng.uniform(0.0, 1.0)
    lead = style.stance / 2.0 - 0.03
    ankle, foot = np.zeros((len(time), 2, 3)), np.zeros((len(time), 2, 2))
    half = puppet.hip_width * rng.uniform(*style.half_width)
    if loop is not None:
        half += _WIDER * puppet.hip_width
    for side in (LEFT, RIGHT):
        number, phase = np.divmod(cycle + 0.5 * side, 1.0)
        swing = np.clip((phase - style.stance) / (1.0 - style.stance), 0.0, 1.0)
        way = number - 0.5 * side + lead + _ease(swing)
        ankle[:, side, 2] = style.stride * size * way
        ankle[:, side, 0] = (1.0 - 2.0 * side) * half
        ankle[:, side, 1] = puppet.ankle_height + style.lift * size * _arc(swing)
        foot[:, side, 0] = base.foot[side, 0]
        foot[:, side, 1] = _heel(phase, style)
    turn = 2.0 * np.pi * cycle
    sway = np.sin(turn + 0.3)  # to the left while the left foot stands
    root = np.stack(
        [
            0.02 * size * sway,
            puppet.ankle_height
            + puppet.leg * (1.0 - style.crouch)
            - style.bounce * size * np.cos(2.0 * turn),
            style.stride * size * cycle,
        ],
        axis=-1,
    )
    zero, lean = np.zeros_like(time), style.lean + 0.06 * _drift(rng, time)
    yaw = -0.12 * np.cos(turn) * min(style.stride, 1.5)
    twist = -1.8 * yaw
    pose = Pose(
        root=root,
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
    drifts = [_drift(rng, time) for _ in range(3)]
    return _swing_arms(puppet, pose, style, turn, rng, drifts)


class _Loop:
    """An ellipse on the floor, begun where it leads forward (+z)."""

    def __init__(self, area: Area, way: int) -> None:
        """Fit the ellipse into an area; way: 1 turns to the left, -1 to the right."""
        wide, deep = (0.5 * (most - least) for least, most in area)
        wide = min(wide, _LONGEST_LOOP * deep)
        deep = min(deep, _LONGEST_LOOP * wide)
        self.sharpest = min(wide, deep) ** 2 / max(wide, deep)
        """Least radius of curvature [m]."""
        angle = np.linspace(0.0, 2.0 * np.pi, 721)
        middle = np.array([sum(side) / 2.0 for side in area])
        edge = np.stack([-way * wide * np.cos(angle), deep * np.sin(angle)], axis=-1)
        steps = np.diff(edge, axis=0)
        self._place = middle + edge
        self._way = np.append(0.0, np.cumsum(np.linalg.norm(steps, axis=1)))
        tangent = way * wide * np.sin(angle), deep * np.cos(angle)
        self._heading = np.unwrap(np.arctan2(*tangent))

    def _at(self, way: Array) -> tuple[Array, Array, Array]:
        """Return place (..., 2), heading [rad] and curvature [1/m] after a way [m]."""
        rounds, rest = np.divmod(way, self._way[-1])
        place = np.stack(
            [np.interp(rest, self._way, values) for values in self._place.T], axis=-1
        )
        heading = np.interp(rest, self._way, self._heading)
        bends = np.gradient(self._heading, self._way)
        return (
            place,
            heading + rounds * self._heading[-1],
            np.interp(rest, self._way, bends),
        )

    def bent(self, pose: Pose, speed: float) -> Pose:
        """Return a straight way at a speed [m/s] led around the loop.

        What was straight ahead is along the loop, what was beside it is across. A foot
        that stands stays where it is, and the body leans inward.
        """
        start = pose.root[0, 2]

        def led(points: Array) -> tuple[Array, Array, Array]:
            place, heading, curvature = self._at(points[..., 2] - start)
            beside = points[..., 0]
            moved = points.copy()
            moved[..., 0] = place[..., 0] + beside * np.cos(heading)
            moved[..., 2] = place[..., 1] - beside * np.sin(heading)
            return moved, heading, curvature

        root, heading, curvature = led(pose.root)
        ankle, toes, _ = led(pose.ankle)
        lean = np.arctan(curvature * speed**2 / GRAVITY)
        turn = np.stack([heading, np.zeros_like(heading), lean], axis=-1)
        foot = pose.foot + np.stack([toes, np.zeros_like(toes)], axis=-1)
        return replace(
            pose, root=root, ankle=ankle, foot=foot, pelvis=pose.pelvis + turn
        )


def _drift(rng: Rng, time: Array) -> Array:
    """Return a slow change of habit over time, about within -1 and 1, shape (T,)."""
    rates, phases = rng.uniform(0.08, 0.3, 2), rng.uniform(0.0, 2.0 * np.pi, 2)
    return np.asarray(
        np.sin(2.0 * np.pi * np.multiply.outer(time, rates) + phases).mean(axis=1)
    )


def _ease(s: Array) -> Array:
    """Minimum-jerk way from 0 to 1 (Flash & Hogan 1985, J. Neurosci. 5(7))."""
    return s**3 * (10.0 - 15.0 * s + 6.0 * s**2)


def _arc(s: Array) -> Array:
    """Bump over (0, 1), highest before its middle, at rest at both ends."""
    return np.sin(np.pi * s**0.8) ** 2


def _heel(phase: Array, style: _Gait) -> Array:
    """Heel rise [rad] over a cycle: mid-stance to mid-swing; toes up at landing."""
    start, off = 0.6 * style.stance, style.stance
    rise = _ease(np.clip((phase - start) / (off - start), 0.0, 1.0))
    fall = _ease(np.clip((phase - off) / (0.6 * (1.0 - off)), 0.0, 1.0))
    toes = _ease(np.clip((phase - 0.8) / 0.15, 0.0, 1.0)) * (phase > 0.5)
    toes = toes + (1.0 - _ease(np.clip(phase / 0.1, 0.0, 1.0))) * (phase < 0.5)
    return style.toe_off * rise * (1.0 - fall) - 0.2 * min(style.stride, 1.0) * toes


def _swing_arms(
    puppet: Puppet, pose: Pose, style: _Gait, turn: Array, rng: Rng, drifts: list[Array]
) -> Pose:
    spread, inward = rng.uniform(0.1, 0.25), rng.uniform(-0.1, 0.5)
    # In walking the shoulder swings from about 24 degrees of extension to 8 of flexion
    # (Murray et al. 1967, Am. J. Phys. Med. 46(1)).
    mean = style.mean_swing + 0.1 * drifts[0]
    wide = spread * (1.0 + 0.4 * drifts[1])
    bent = style.elbow * (1.0 + 0.4 * drifts[2])
    for side in (LEFT, RIGHT):
        swing = -style.arm_swing * np.cos(turn + np.pi * side - 0.15)
        forward = np.sin(swing + mean + 0.05 * style.elbow)
        out = np.sin(wide)
        elevation = np.arcsin(np.minimum(np.hypot(forward, out), 0.999))
        elbow = bent * (1.0 + 0.35 * np.sin(swing)) + 0.15 + 0.1 * forward
        plane = np.arctan2(forward, out)
        pose = pose.with_arm(side, puppet.arm(elevation, plane, inward, elbow))
    return pose


def _load(puppet: Puppet, pose: Pose, rng: Rng) -> Pose:
    """Hold a box in front of the body, or a bag in one hand."""
    if rng.random() < 0.3:
        return pose.with_arm(int(rng.integers(2)), puppet.arm(0.2, 0.1, 0.2, 0.1))
    goal = (rng.uniform(0.12, 0.2), rng.uniform(-0.42, -0.12), rng.uniform(0.25, 0.36))
    flare = rng.uniform(0.1, 0.6)
    for side in (LEFT, RIGHT):
        pose = puppet.put_hand(pose, side, goal, (flare, -1.0, -0.3))
    return replace(pose, spine=pose.spine * np.array([1.0, 1.0, 0.3]) - [0.05, 0, 0])


def _turn(puppet: Puppet, rng: Rng, base: Pose, length: float) -> Score:
    """Turn on the spot by small steps, foot after foot."""
    score, pose = Score(base).hold(0.3), base
    center = base.ankle.mean(axis=0)
    home = np.array([center[0], base.root[1], center[2]])
    while score.duration < length:
        way, steps = int(rng.choice([-1, 1])), int(rng.integers(2, 6))
        pace, angle = rng.uniform(0.28, 0.45), rng.uniform(0.35, 0.7)
        for step in range(2 * steps):
            side = (step + (way < 0)) % 2  # the foot on the inside goes first
            if step % 2 == 0:
                heading = pose.pelvis[0] - base.pelvis[0] + way * angle
            spot = center + rotate(about_y(heading), base.ankle[side] - center)
            middle = (pose.ankle[side] + spot) / 2.0 + [0.0, 0.06 * puppet.scale, 0.0]
            yaw = base.foot[side, 0] + heading
            turned = pose.pelvis + np.array([way * angle / 4.0, 0.0, 0.0])
            shift = pose.ankle[1 - side] - center
            over = home + 0.35 * shift
            air = pose.with_foot(side, ankle=middle, heel=0.25)
            score.to(pace, replace(air, root=over, pelvis=turned))
            pose = pose.with_foot(side, ankle=spot, yaw=yaw, heel=0.0)
            turned = turned + np.array([way * angle / 4.0, 0.0, 0.0])
            pose = replace(pose, root=home, pelvis=turned)
            score.to(pace, pose)
        score.hold(rng.uniform(0.3, 0.8))
    return score


GAITS = ("carry", "march", "run", "walk")
"""Names of the gaits."""

TURNS: dict[str, Script] = {"turn": _turn}
"""Motions that turn on the spot, by name."""
