"""Standing poses, ways to hold the arms during leg work, and faults in exercises."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from kinefilter.characters.arrays import Array

from .poses import LEFT, RIGHT, Pose, Rng, Score
from .puppet import Puppet

Script = Callable[[Puppet, Rng, Pose, float], Score]
"""Function that writes a score of at least a given time [s] for a puppet, which ends,
after its last complete movement, in the standing pose it started from."""


def by_name(*scripts: Script) -> dict[str, Script]:
    """Return scripts by the names of their functions, without the underscore."""
    return {script.__name__.removeprefix("_"): script for script in scripts}


def stance(puppet: Puppet, rng: Rng, *, wide: float = 0.0) -> Pose:
    """Draw a relaxed standing pose, the feet ``wide`` hip widths farther apart."""
    half = (rng.uniform(0.9, 1.9) + wide) * puppet.hip_width / 2.0
    toe_out = rng.uniform(0.0, 0.25) + 0.1 * wide
    step = rng.normal(0.0, 0.03) * puppet.scale
    left, right = (puppet.arm(*hanging_arm(rng)) for _ in (LEFT, RIGHT))
    stoop = rng.uniform(-0.04, 0.14)
    drop = abs(rng.normal(0.0, 0.003)) * puppet.scale
    back = rng.normal(0.0, 0.015) * puppet.scale
    height = puppet.ankle_height + 0.997 * puppet.leg
    return Pose(
        root=np.array([0.0, height - drop, 0.01 - back]),
        pelvis=rng.normal(0.0, (0.06, 0.04, 0.03)),
        spine=np.array([stoop, *rng.normal(0.0, (0.03, 0.05))]),
        head=np.array([rng.normal(0.0, 0.1) - 0.5 * stoop, 0.0, rng.normal(0.0, 0.15)]),
        arm=np.stack([left[0], right[0]]),
        elbow=np.stack([left[1], right[1]]),
        hand=np.zeros((2, 2)),
        ankle=np.array([[s * half, puppet.ankle_height, s * step] for s in (1, -1)]),
        foot=np.array([[toe_out, 0.0], [-toe_out, 0.0]]),
        lifted=np.zeros(2),
        knee_out=np.zeros(2),
    )


def hanging_arm(rng: Rng) -> tuple[float, float, float, float]:
    """Draw the angles [rad] of a hanging arm, as ``Puppet.arm`` takes them."""
    u = rng.uniform
    return u(0.08, 0.25), u(-0.1, 0.9), u(0.0, 0.6), u(0.1, 0.6)


def alternating(score: Score, rng: Rng, length: float, chance: float) -> Iterator[int]:
    """Yield the side of each repetition until the score lasts ``length`` [s].

    The first side is drawn; each repetition changes sides with the given chance.
    """
    side = int(rng.integers(2))
    while score.duration < length:
        side = 1 - side if rng.random() < chance else side
        yield side


ON_HIPS = (0.19, -0.45, 0.05)  # hand on the hip, as Puppet.reach takes it
_FOLDED = (-0.02, -0.14, 0.26)  # hand in front of the chest, likewise


class ArmHold(NamedTuple):
    """A way to hold both arms."""

    name: str  # "hips" (hands on the hips), "folded", or a hold given by angles
    angles: tuple[float, float, float, float] | None = None  # as for Puppet.arm [rad]

    def put(self, puppet: Puppet, pose: Pose, fault: Fault) -> Pose:
        """Return the pose with both arms held this way, off by the fault."""
        for side in (LEFT, RIGHT):
            if self.angles is not None:
                elevation, plane, rotation, elbow = self.angles
                arm = puppet.arm(
                    np.clip(elevation - fault.droop[side], 0.12, 2.8),
                    plane + 0.5 * fault.sweep[side],
                    rotation + fault.sweep[side],
                    np.clip(elbow + fault.sweep[side] / 2.0, 0.05, 2.2),
                )
            elif self.name == "hips":
                arm = puppet.reach(side, ON_HIPS, (1.0, 0.1, -0.6))
            else:
                arm = puppet.reach(side, _FOLDED, (1.0, -0.6 + 0.2 * side, 0.1))
            pose = pose.with_arm(side, arm)
        return pose


# Ranges of elevation, plane, axial rotation and elbow flexion [rad]; 1 if the axial
# rotation is inward, -1 if it is outward.
_HOLDS = {
    "stick": ((1.2, 1.7), (-0.6, 0.2), (1.2, 2.0), (1.2, 1.8), -1.0),
    "low stick": ((0.8, 1.3), (-0.6, 0.2), (1.0, 2.0), (1.0, 1.9), -1.0),
    "overhead": ((1.7, 2.6), (-0.1, 0.6), (0.5, 1.7), (0.1, 1.0), -1.0),
    "forward": ((1.1, 1.7), (1.2, 1.55), (0.0, 0.4), (0.1, 0.4), 1.0),
    "wide": ((1.0, 1.7), (-0.2, 0.4), (0.0, 0.8), (0.1, 0.5), -1.0),
    "hanging": ((0.15, 0.35), (0.0, 1.2), (0.0, 0.6), (0.1, 0.6), 1.0),
}


def draw_hold(rng: Rng, *names: str) -> ArmHold:
    """Draw one of the named ways to hold the arms.

    ``stick`` holds a stick behind the shoulders with the elbows level (``low stick``:
    low), and ``overhead`` a long one over the head, as in the functional movement
    screen (Cook et al. 2014, Int. J. Sports Phys. Ther. 9(3)).
    """
    name = names[int(rng.integers(len(names)))]
    if name in ("hips", "folded"):
        return ArmHold(name)
    *ranges, inward = _HOLDS[name]
    elevation, plane, rotation, elbow = (rng.uniform(*limits) for limits in ranges)
    return ArmHold(name, (elevation, plane, inward * rotation, elbow))


@dataclass(frozen=True, eq=False)
class Fault:
    """Deviation of one repetition from the correct form, angles [rad]."""

    forward: float  # excess forward bend of the trunk
    side: float  # bend of the trunk to the left
    twist: float  # rotation of the trunk to the left
    shift: float  # offset of the root to the left, as a share of leg length
    short: float  # share of the full range of motion that is reached
    knees_out: float  # knees outward of the feet; negative: inward
    droop: Array  # how much too low the left and the right arm are, shape (2,)
    sweep: Array  # how far the left and the right forearm are turned away, shape (2,)

    def bend(self, puppet: Puppet, pose: Pose, share: float = 1.0) -> Pose:
        """Return the pose with a share of the fault's trunk deviation added."""
        forward, side, twist = share * np.array([self.forward, self.side, self.twist])
        pose = pose.leaning(side=share * self.shift * puppet.leg, back=0.06 * forward)
        return pose.leaning(
            pelvis=(0.3 * twist, 0.45 * forward, 0.3 * side),
            spine=(0.55 * forward, 0.7 * side, 0.7 * twist),
            head=(-0.3 * forward, -0.2 * side, 0.0),
        )


def draw_fault(rng: Rng) -> Fault:
    """Draw the fault of one repetition: small in half of the cases, else large."""
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
