"""How people stand, hold their arms while the legs work, and do an exercise wrong."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from kinefilter.characters import InputError
from kinefilter.characters.arrays import Array

from .poses import LEFT, RIGHT, Pose, Rng, Score
from .puppet import Puppet

Script = Callable[[Puppet, Rng, Pose, float], Score]
"""Writes a score for a puppet that stands in a pose, at least so many seconds long.

The last movement is played to its end and leads back to the pose.
"""


def stance(puppet: Puppet, rng: Rng, *, wide: float = 0.0) -> Pose:
    """Return a standing pose of one's own: stance, toes, lean, hanging arms."""
    width = rng.uniform(0.9, 1.9) + wide
    pose = puppet.stand(width=width, toe_out=rng.uniform(0.0, 0.25) + 0.1 * wide)
    step = rng.normal(0.0, 0.03) * puppet.scale
    ankle = pose.ankle + np.array([[0.0, 0.0, step], [0.0, 0.0, -step]])
    pose = replace(pose, ankle=ankle)
    for side in (LEFT, RIGHT):
        pose = pose.with_arm(side, puppet.arm(*hanging_arm(rng)))
    stoop = rng.uniform(-0.04, 0.14)
    return pose.leaning(
        drop=abs(rng.normal(0.0, 0.003)) * puppet.scale,
        back=rng.normal(0.0, 0.015) * puppet.scale,
        pelvis=(rng.normal(0.0, 0.06), rng.normal(0.0, 0.04), rng.normal(0.0, 0.03)),
        spine=(stoop, rng.normal(0.0, 0.03), rng.normal(0.0, 0.05)),
        head=(rng.normal(0.0, 0.1) - 0.5 * stoop, 0.0, rng.normal(0.0, 0.15)),
    )


def hanging_arm(rng: Rng) -> tuple[float, float, float, float]:
    """Return the angles [rad] of an arm that hangs, as ``Puppet.arm`` takes them."""
    return (
        rng.uniform(0.08, 0.25),
        rng.uniform(-0.1, 0.9),
        rng.uniform(0.0, 0.6),
        rng.uniform(0.1, 0.6),
    )


ON_HIPS = (0.19, -0.45, 0.05)
"""Hand on the hip, as ``Puppet.reach`` takes it."""
_FOLDED = (-0.02, -0.14, 0.26)


@dataclass(frozen=True)
class ArmHold:
    """One way to hold both arms, shoulder angles [rad] after Wu et al. 2005."""

    style: Literal["angles", "hips", "folded"]
    """Arms at the angles below, hands on the hips, or hands before the chest."""
    elevation: float = 0.0
    """Elevation of the upper arms."""
    plane: float = 0.0
    """Plane of elevation, 0 to the side, a quarter turn to the front."""
    rotation: float = 0.0
    """Axial rotation, positive inward."""
    elbow: float = 0.0
    """Elbow flexion."""

    def put(self, puppet: Puppet, pose: Pose, fault: Fault) -> Pose:
        """Return the pose with both arms so, each off by what the fault says."""
        for side in (LEFT, RIGHT):
            if self.style == "hips":
                arm = puppet.reach(side, ON_HIPS, (1.0, 0.1, -0.6))
            elif self.style == "folded":
                arm = puppet.reach(side, _FOLDED, (1.0, -0.6 + 0.2 * side, 0.1))
            else:
                droop = fault.droop[side]
                arm = puppet.arm(
                    np.clip(self.elevation - droop, 0.12, 2.8),
                    self.plane + 0.5 * fault.sweep[side],
                    self.rotation + fault.sweep[side],
                    np.clip(self.elbow + fault.sweep[side] / 2.0, 0.05, 2.2),
                )
            pose = pose.with_arm(side, arm)
        return pose


def draw_hold(rng: Rng, *names: str) -> ArmHold:
    """Return a way to hold the arms, drawn from the named ones.

    ``stick`` holds an imagined stick behind the shoulders, elbows level (or low), and
    ``overhead`` a long one over the head, as the tests of functional movement ask (Cook
    et al. 2014, Int. J. Sports Phys. Ther. 9(3)).

    Raises:
        InputError: There is no such way.
    """
    u, name = rng.uniform, names[int(rng.integers(len(names)))]
    match name:
        case "stick":
            return ArmHold(
                "angles", u(1.2, 1.7), u(-0.6, 0.2), -u(1.2, 2.0), u(1.2, 1.8)
            )
        case "low stick":
            return ArmHold("angles", u(0.8, 1.3), u(-0.6, 0.2), -u(1.0, 2.0), u(1, 1.9))
        case "overhead":
            return ArmHold("angles", u(1.7, 2.6), u(-0.1, 0.6), -u(0.5, 1.7), u(0.1, 1))
        case "forward":
            return ArmHold(
                "angles", u(1.1, 1.7), u(1.2, 1.55), u(0.0, 0.4), u(0.1, 0.4)
            )
        case "wide":
            return ArmHold(
                "angles", u(1.0, 1.7), u(-0.2, 0.4), -u(0.0, 0.8), u(0.1, 0.5)
            )
        case "hanging":
            return ArmHold("angles", u(0.15, 0.35), u(0.0, 1.2), u(0, 0.6), u(0.1, 0.6))
        case "hips":
            return ArmHold("hips")
        case "folded":
            return ArmHold("folded")
        case _:
            raise InputError(f"unknown way to hold the arms {name!r}")


@dataclass(frozen=True, eq=False)
class Fault:
    """How far one repetition is off, angles [rad]; small where it is done right."""

    forward: float
    """Trunk bent forward beyond need."""
    side: float
    """Trunk bent to the left."""
    twist: float
    """Trunk turned to the left."""
    shift: float
    """Root beside the middle, to the left, as a share of leg length."""
    short: float
    """Share of the full range that is done."""
    knees_out: float
    """Knees outward of the feet, negative: inward."""
    droop: Array
    """Left and right arm too low, shape (2,)."""
    sweep: Array
    """Left and right forearm turned away, shape (2,)."""

    def bend(self, puppet: Puppet, pose: Pose, share: float = 1.0) -> Pose:
        """Return the pose with a share of the trunk's part of the fault added."""
        forward, side, twist = (
            share * a for a in (self.forward, self.side, self.twist)
        )
        return pose.leaning(
            side=share * self.shift * puppet.leg,
            back=0.06 * forward,
            pelvis=(0.3 * twist, 0.45 * forward, 0.3 * side),
            spine=(0.55 * forward, 0.7 * side, 0.7 * twist),
            head=(-0.3 * forward, -0.2 * side, 0.0),
        )


def draw_fault(rng: Rng) -> Fault:
    """Return how one repetition is done: right, or in every second case wrong."""
    size = 0.25 if rng.random() < 0.5 else 1.0
    return Fault(
        forward=size * rng.uniform(-0.25, 0.8),
        side=size * rng.normal(0.0, 0.22),
        twist=size * rng.normal(0.0, 0.22),
        shift=size * rng.normal(0.0, 0.06),
        short=1.0 - size * rng.uniform(0.0, 0.6),
        knees_out=size * rng.uniform(-0.3, 0.4),
        droop=size * rng.normal(0.0, 0.25, 2),
        sweep=size * rng.normal(0.0, 0.3, 2),
    )
