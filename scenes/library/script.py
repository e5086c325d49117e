"""What a scripted motion is, and the pose that it begins in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from .poses import Pose, Score
from .puppet import LEFT, RIGHT, Puppet

Script = Callable[[Puppet, np.random.Generator, Pose, float], Score]
"""Writes a score for a puppet that stands in a pose, at least so many seconds long.

The last movement is played to its end and leads back to the pose.
"""


def stance(puppet: Puppet, rng: np.random.Generator, *, wide: float = 0.0) -> Pose:
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


def hanging_arm(rng: np.random.Generator) -> tuple[float, float, float, float]:
    """Return the angles [rad] of an arm that hangs, as ``Puppet.arm`` takes them."""
    return (
        rng.uniform(0.08, 0.25),
        rng.uniform(-0.1, 0.9),
        rng.uniform(0.0, 0.6),
        rng.uniform(0.1, 0.6),
    )
